import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.stream_reader import get_chunk_data_stream
from hickory_stream.box_scene import SCENE_CAMERA
from hickory_stream.errors import MapFolderError
from hickory_stream.events import ShapeFailed, SourceEnded, TimeJumped
from hickory_stream.journal.format import ARRAYS, CHECKPOINT, JOURNAL
from hickory_stream.journal.reader import Journal
from hickory_stream.journal.step import Checkpoint, FramePose, JournalEntry, OpenJob, Step, StepKind
from hickory_stream.journal.writer import JournalWriter

NUM_STEPS = 6


def stored(array):
    array.flags.writeable = False
    return array


BIG = stored(np.random.default_rng(0).normal(size=(400, 3)).astype(np.float32))


def entry(i, kind=StepKind.KEYFRAME):
    pose = np.eye(4)
    pose[0, 3] = i
    step = Step(
        kind=kind, stamp_ns=1000 + i, camera=SCENE_CAMERA,
        frames=(FramePose(index=i, stamp_ns=1000 + i, world_from_camera=pose),), round_index=0, first_index=0,
        first_ns=1000, num_frames=i + 1, num_keyframes=i + 1, counts={"time_jumps": i}, shape_counts={},
        metrics=(("time/perceive", 0.25),),
    )  # fmt: skip
    events = (TimeJumped(from_ns=i, to_ns=i + 1, kind="loop"), SourceEnded(stamp_ns=i))
    return JournalEntry(step=step, events=events)


def checkpoint(i):
    job = OpenJob(ticket=i, object_id=1, due_ns=5)
    return Checkpoint(core={"_a": BIG, "_b": (i, None, {2: "x"}), "_c": {"b", "a"}}, open_jobs=(job,))


def write(folder, *, closes=True, last=StepKind.KEYFRAME):
    writer = JournalWriter(folder, flush_s=0.0)
    for i in range(NUM_STEPS):
        writer.append(entry(i, last if i == NUM_STEPS - 1 else StepKind.KEYFRAME), color=b"jpeg" if i == 1 else None)
        if i % 2:
            writer.checkpoint(checkpoint(i), 1000 + i)
    (writer.close if closes else writer.abandon)()
    return (folder / JOURNAL).read_bytes()


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return write(tmp_path_factory.mktemp("journal"))


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("cut")


def read_numbers(folder):
    with Journal(folder) as journal:
        return [e.step.num_frames for e in journal.entries()]


@pytest.mark.parametrize("closes", [True, False])
def test_what_was_written_is_read_with_or_without_closing(tmp_path, closes):
    write(tmp_path, closes=closes)
    with Journal(tmp_path) as journal:
        assert len(journal) == NUM_STEPS
        assert journal.stamps_ns.tolist() == [1000 + i for i in range(NUM_STEPS)]
        for i, read in enumerate(journal.entries()):
            wanted = entry(i)
            assert read.events == wanted.events
            assert (read.step.counts, read.step.metrics) == (wanted.step.counts, wanted.step.metrics)
            np.testing.assert_array_equal(read.step.frames[0].world_from_camera[0, 3], i)
        assert [journal.color(i) for i in range(3)] == [None, b"jpeg", None]


def test_a_checkpoint_comes_back_and_writes_no_array_twice(tmp_path):
    write(tmp_path)
    with Journal(tmp_path) as journal:
        found = [journal.checkpoint_before(i) for i in range(NUM_STEPS)]
        assert [None if f is None else f[0] for f in found] == [None, 1, 1, 3, 3, 5]
        last = found[-1]
        np.testing.assert_array_equal(last[1].core["_a"], BIG)
        assert last[1].core["_b"] == (5, None, {2: "x"})
        assert last[1].core["_c"] == {"a", "b"}
        assert last[1].open_jobs == checkpoint(5).open_jobs
    assert (tmp_path / JOURNAL).stat().st_size < 2 * BIG.nbytes + 8000


def test_arrays_of_equal_content_are_stored_once_while_in_use(tmp_path):
    def same(step=0):
        return stored(BIG + np.float32(step))

    writer = JournalWriter(tmp_path, flush_s=100.0)
    writer.append(entry(0))
    wanted = [(same(), same()), (same(), same(1)), (same(1),), (same(), same().reshape(2, -1))]
    for own in wanted:
        writer.checkpoint(Checkpoint(core={"_a": own}, open_jobs=()), 1000)
    writer.close()
    with Journal(tmp_path) as journal:
        counts = []
        for chunk, place in enumerate(journal._chunks.places):
            if place.channel == ARRAYS:
                counts.append(len(journal._chunks.messages(chunk)) - 1)
            if place.channel == CHECKPOINT:
                found = journal._checkpoint(chunk, reads_later=False).core["_a"]
                for a, b in zip(found, wanted[len(counts) - 1], strict=True):
                    np.testing.assert_array_equal(a, b)
    # That of another shape is another one, and what no checkpoint had in between is forgotten.
    assert counts == [1, 1, 0, 2]


def test_a_checkpoint_over_many_chunks_unpacks_each_once(tmp_path, monkeypatch):
    arrays = [stored(BIG + np.float32(i)) for i in range(80)]
    writer = JournalWriter(tmp_path, flush_s=100.0)
    writer.append(entry(0))
    for i in range(len(arrays)):
        writer.checkpoint(Checkpoint(core={"_a": tuple(arrays[: i + 1])}, open_jobs=()), 1000)
    writer.close()
    unpacked = []

    def unpack(chunk, validate_crc):
        unpacked.append(chunk)
        return get_chunk_data_stream(chunk, validate_crc)

    monkeypatch.setattr("hickory_stream.journal.reader.get_chunk_data_stream", unpack)
    with Journal(tmp_path) as journal:
        found = journal.checkpoint_before(0)
    np.testing.assert_array_equal(found[1].core["_a"], arrays)
    # Those of its arrays, and that of its document.
    assert len(unpacked) == len(arrays) + 1


def test_of_large_chunks_few_are_kept_at_hand(tmp_path, monkeypatch):
    monkeypatch.setattr("hickory_stream.journal.reader._CACHED_BYTES", 3000)
    writer = JournalWriter(tmp_path, flush_s=100.0)
    for i in range(6):
        writer.append(entry(i), color=bytes([i]) * 1000)
    writer.close()
    with Journal(tmp_path) as journal:
        for _ in range(2):
            assert [journal.color(i) for i in range(6)] == [bytes([i]) * 1000 for i in range(6)]
        kept = journal._chunks._cache._chunks
        assert 0 < len(kept) < 3
        # The last one is, however large.
        monkeypatch.setattr("hickory_stream.journal.reader._CACHED_BYTES", 1)
        assert journal.color(0) == bytes(1000)
        assert len(kept) == 1


@given(share=st.floats(0.0, 1.0))
def test_a_file_cut_at_any_byte_holds_the_steps_before(whole, place, share):
    cut = whole[: round(share * len(whole))]
    (place / JOURNAL).write_bytes(cut)
    numbers = read_numbers(place)
    assert numbers == list(range(1, len(numbers) + 1))
    with Journal(place) as journal:
        journal.cut_to_resumable()
        assert len(journal) == len(numbers)
        JournalWriter(place, flush_s=0.0, continued=journal).close()
    assert read_numbers(place) == numbers


@given(at=st.integers(0, 10**6), flipped=st.integers(1, 255))
def test_a_changed_byte_is_found_and_never_misread(whole, place, at, flipped):
    at %= len(whole)
    (place / JOURNAL).write_bytes(whole[:at] + bytes([whole[at] ^ flipped]) + whole[at + 1 :])
    try:
        with Journal(place) as journal:
            journal.cut_to_resumable()
            read = [e.step.num_frames for e in journal.entries()]
    except MapFolderError as error:
        assert "play the log again" in str(error)
    else:
        assert read == list(range(1, len(read) + 1))


def test_a_continued_journal_is_whole_but_for_early_commits(tmp_path):
    write(tmp_path, closes=False)
    with Journal(tmp_path) as journal:
        journal.cut_to_resumable()
        writer = JournalWriter(tmp_path, flush_s=0.0, continued=journal)
    writer.append(entry(NUM_STEPS))
    writer.checkpoint(checkpoint(9), 1000 + NUM_STEPS)
    writer.close()
    assert read_numbers(tmp_path) == list(range(1, NUM_STEPS + 2))
    with Journal(tmp_path) as journal:
        for i in (1, NUM_STEPS):
            found = journal.checkpoint_before(i)
            np.testing.assert_array_equal(found[1].core["_a"], BIG)
    write(tmp_path, last=StepKind.CLOSING)
    assert read_numbers(tmp_path) == list(range(1, NUM_STEPS + 1))
    with Journal(tmp_path) as journal:
        journal.cut_to_resumable()
        assert len(journal) == NUM_STEPS - 1


def test_what_is_no_journal_and_a_disk_that_refuses_are_told(tmp_path):
    with pytest.raises(MapFolderError, match="cannot write"):
        JournalWriter(tmp_path / "nowhere", flush_s=0.0)
    with pytest.raises(MapFolderError, match="holds no journal"):
        Journal(tmp_path)
    (tmp_path / JOURNAL).write_bytes(b"something else entirely")
    with pytest.raises(MapFolderError, match="no MCAP file"):
        Journal(tmp_path)
    (tmp_path / JOURNAL).write_bytes(b"")
    with Journal(tmp_path) as journal:
        assert len(journal) == 0


def test_an_event_that_failed_keeps_its_reason(tmp_path):
    writer = JournalWriter(tmp_path, flush_s=10.0)
    failed = ShapeFailed(ticket=3, object_id=7, stamp_ns=9, reason="no surface: 3 < 10")
    writer.append(JournalEntry(step=entry(0).step, events=(failed,)))
    writer.close()
    with Journal(tmp_path) as journal:
        assert journal.events(0, "ShapeFailed") == [failed]
        assert journal.events(0, "ShapeReady") == []
