import shutil
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace
import numpy as np
import pytest
from hickory_stream.box_scene import PERIOD_NS, START_NS
from hickory_stream.errors import InputError, MapFolderError
from hickory_stream.journal.format import ARRAYS, JOURNAL
from hickory_stream.journal.reader import Journal, JournalChunks
from hickory_stream.journal.record_codec import encode
from hickory_stream.journal.snapshot_records import object_without_points
from hickory_stream.journal.writer import JournalWriter
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.map_folder.history.core_replay import Replay
from hickory_stream.map_folder.history.recorded_config import known_config
from hickory_stream.map_folder.history.time_travel import as_known_at, changes, own_clock_s, stamp_of
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.mapping.entities.cloud import is_packed
from hickory_stream.records import ObjectKind
from hickory_stream.sinks.disk_sink import DiskSink
from hickory_stream.testing import RememberingSink
from tests.engine.run_fixtures import NUM_FRAMES, map_scene
from tests.engine.snapshot_fixtures import make_snapshot


def watch(path, *overrides, loops=1):
    sink = RememberingSink()
    sinks = {"sinks": lambda folder: [(DiskSink(folder), True), (sink, True)]}
    run = map_scene(path, "journal.checkpoint_keyframes=3", *overrides, loops=loops, **sinks)
    return SimpleNamespace(run=run, reports=sink.reports, saved=open_map(run.folder.path))


@pytest.fixture(scope="module")
def watched(tmp_path_factory):
    return watch(tmp_path_factory.mktemp("watched"))


def test_the_map_at_every_keyframe_is_the_published_one(watched):
    # The last keyframe has the stamp of the finished map.
    for report in watched.reports[:-2]:
        for stamp_ns in (report.stamp_ns, report.stamp_ns + PERIOD_NS // 2):
            assert map_digest(watched.saved.as_known_at(stamp_ns)) == map_digest(report.snapshot)
    assert map_digest(watched.saved.as_known_at(START_NS + 10**12)) == watched.run.digest
    assert watched.saved.as_known_at(START_NS - 1).objects == ()
    # Every mesh that the map ever had is still there.
    for report in watched.reports:
        for tracked in report.snapshot.objects if report.snapshot else ():
            if tracked.shape is not None:
                watched.saved.mesh(tracked.shape)


def test_to_look_back_takes_neither_perception_nor_shapes(watched):
    code = (
        "import sys; from pathlib import Path; from hickory_stream.map_folder.saved_map import open_map; "
        f"known = open_map(Path(sys.argv[1])).as_known_at({watched.reports[4].stamp_ns}); "
        "print(len([one.box for one in known.objects]), *(name for name in sys.modules if name in sys.argv[2:]))"
    )
    heavy = [f"hickory_stream.{name}" for name in ("perception.perceive", "shapes.build", "config")]
    folder = str(watched.run.folder.path)
    done = subprocess.run([sys.executable, "-c", code, folder, *heavy], capture_output=True, text=True, check=True)
    expected = watched.reports[4].snapshot
    assert done.stdout.split() == [str(len(expected.objects))]


def test_checkpoints_hold_changes_and_lazy_arrays_the_same_bytes(watched):
    with Journal(watched.run.folder.path) as journal:
        at_once = journal.checkpoint_before(len(journal) - 1)
        later = journal.checkpoint_before(len(journal) - 1, reads_later=True)
    unread = [track.cloud for track in later[1].core["tracks"].values()]
    assert any(is_packed(cloud) for cloud in unread)
    # The journal is closed: what is read now is read from a file that stays open for it.
    assert encode(later[1].core) == encode(at_once[1].core)
    assert not any(is_packed(cloud) for cloud in unread)
    with Journal(watched.run.folder.path) as journal:
        assert journal.checkpoint_before(len(journal) - 1)[0] == 5
        assert journal.checkpoint_before(1) is None
        assert journal.checkpoint_before(2)[0] == 2


def test_damage_to_an_array_is_reported_when_it_is_read(watched, tmp_path):
    chunks = JournalChunks(watched.run.folder.path)
    # Before there are shapes and sketches, all arrays may be read later.
    place = next(place for place in chunks.places if place.channel == ARRAYS)
    data = bytearray(chunks.path.read_bytes())
    data[(place.start + place.end) // 2] ^= 0xFF
    (tmp_path / JOURNAL).write_bytes(data)
    with Journal(tmp_path) as journal:
        with pytest.raises(MapFolderError, match="is damaged"):
            journal.checkpoint_before(2)
        later = journal.checkpoint_before(2, reads_later=True)
        with pytest.raises(MapFolderError, match="is damaged"):
            encode(later[1].core)


def test_final_knowledge_is_restricted_to_what_had_been_seen(watched):
    saved = watched.saved
    early = saved.at(START_NS + PERIOD_NS)
    assert {o.id for o in early.objects} == {o.id for o in saved.snapshot.objects if o.first_seen_ns <= early.stamp_ns}
    assert all(view.stamp_ns <= START_NS + PERIOD_NS for o in early.objects for view in o.views)
    assert [o.shape is not None for o in early.objects] == [True] * 3
    assert map_digest(saved.at(START_NS + 10**12)) == watched.run.digest
    assert saved.at(START_NS - 1).objects == ()


def test_a_difference_names_what_appeared_and_what_changed(watched):
    def told(since, until):
        return {(change.object_id, change.kind) for change in watched.saved.diff(since, until)}

    end = START_NS + 10**12
    assert told(START_NS - 1, end) == {(i, "appeared") for i in (1, 2, 3)}
    assert told(START_NS, end) >= {(i, "shape changed") for i in (1, 2, 3)}
    assert told(end, end) == set()


def test_differences_know_merged_moved_and_dropped_objects():
    before = make_snapshot()
    first, second, *_ = before.objects
    rest, shift = before.objects[1:], np.eye(4)
    shift[:3, 3] = (0.3, 0.0, 0.0)
    moved = replace(first, box=replace(first.box, world_from_box=shift @ first.box.world_from_box))
    attached = replace(first, kind=ObjectKind.FIXTURE, fixture_probability=0.75)
    for objects, kind, object_id, text in (
        ((replace(first, merged_ids=(second.id,)), *rest[1:]), "merged", second.id, f"is now a part of #{first.id}"),
        (rest, "dropped", first.id, ""),
        ((moved, *rest), "moved", first.id, "by 0.30 m"),
        ((attached, *rest), "kind changed", first.id, "object 1.00 -> fixture 0.75"),
    ):
        (change,) = changes(before, replace(before, objects=objects))
        assert (change.kind, change.object_id) == (kind, object_id)
        assert text in change.text


def test_only_points_and_space_need_the_events(watched, monkeypatch):
    stamp_ns = watched.reports[4].stamp_ns
    with monkeypatch.context() as context:
        context.setattr(Replay, "seek", _refuse)
        known = watched.saved.as_known_at(stamp_ns)
        light = [encode(object_without_points(tracked)) for tracked in known.objects]
        assert [tracked.best_view in tracked.views for tracked in known.objects].count(True) > 0
        with pytest.raises(AssertionError, match="nobody looked"):
            _ = known.objects[0].points_world
        with pytest.raises(AssertionError, match="nobody looked"):
            _ = known.submaps[0].observed_space.free
    folder = watched.run.folder.path
    with Journal(folder) as journal:
        replay = Replay(journal, known_config(folder).mapping)
        replay.seek(int(np.searchsorted(journal.stamps_ns, stamp_ns)))
    replayed = replay.snapshot()
    assert light == [encode(object_without_points(tracked)) for tracked in replayed.objects]
    assert encode(known.objects) == encode(replayed.objects)
    assert encode(known.submaps) == encode(replayed.submaps)
    assert (known.revision, known.stamp_ns) == (replayed.revision, replayed.stamp_ns)


def _refuse(*_):
    raise AssertionError("nobody looked at points")


def test_a_record_that_contradicts_the_events_is_reported_on_use(watched, tmp_path):
    shutil.copy(watched.run.folder.path / "manifest.json", tmp_path)
    with Journal(watched.run.folder.path) as journal:
        entries = list(journal.entries())[:5]
    writer = JournalWriter(tmp_path, flush_s=60.0)
    for entry, report in zip(entries, watched.reports, strict=False):
        objects = tuple(replace(tracked, sightings=99) for tracked in report.snapshot.objects)
        writer.append(entry, known=replace(report.snapshot, objects=objects))
    writer.close()
    known = as_known_at(tmp_path, entries[-1].step.stamp_ns)
    assert known.objects[0].sightings == 99
    with pytest.raises(MapFolderError, match="record of object 1 is not what its events make"):
        _ = known.objects[0].points_world


def test_times_are_seconds_of_an_own_clock_or_stamps(watched):
    folder = watched.run.folder.path
    for text, after_ns in (("0", 0), ("0.3", PERIOD_NS), ("0.5", PERIOD_NS), (f"{START_NS + 5}ns", 5)):
        assert stamp_of(folder, text) == START_NS + after_ns
    for wrong in ("-1", "99", "noon", f"{START_NS - 1}ns", "5ns", "nan"):
        with pytest.raises(InputError, match=r"expected seconds from 0 to 2\.1"):
            stamp_of(folder, wrong)
    stamps = np.array([10, 11, 12, 10, 11, 500, 501], dtype=np.int64) * 10**9
    assert own_clock_s(stamps, 60.0).tolist() == [0, 1, 2, 2, 3, 3, 4]


def test_of_a_looped_log_the_last_round_counts(tmp_path):
    looped = watch(tmp_path, "mapping.requests.max_failures=0", loops=2)
    second_round = looped.reports[NUM_FRAMES + 2]
    assert map_digest(looped.saved.as_known_at(second_round.stamp_ns)) == map_digest(second_round.snapshot)


def test_a_map_without_a_journal_says_so(watched, tmp_path):
    shutil.copytree(watched.run.folder.path, tmp_path / "map")
    (tmp_path / "map/journal.mcap").unlink()
    with pytest.raises(MapFolderError, match="holds no journal"):
        open_map(tmp_path / "map").as_known_at(START_NS)
