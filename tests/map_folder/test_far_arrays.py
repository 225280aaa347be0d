import errno
import logging
import subprocess
import sys
import tempfile
import numpy as np
from hickory_stream.events import SourceEnded
from hickory_stream.journal.reader import Journal
from hickory_stream.journal.step import Checkpoint
from hickory_stream.journal.writer import JournalWriter
from hickory_stream.map_folder import array_spill
from hickory_stream.map_folder.array_spill import FarArrays
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.mapping import derived
from hickory_stream.mapping.core import MapperCore
from hickory_stream.mapping.entities.cloud import is_packed
from tests.journal.test_journal import entry
from tests.mapping.mapping_fixtures import SECOND_NS, drive
from tests.mapping.test_concerned_tracks import CONFIG, keyframes

# There and back again, so that what was put away comes back.
LOOKS = [(place, 7, what, 1) for place in (0, 1, 2, 3, 2, 1, 0, 3, 0) for what in ("wall", "both")]
HALF = len(LOOKS) // 2


def some_bytes(seed):
    rng = np.random.default_rng(seed)
    return rng.bytes(int(rng.integers(1, 40_000)))


def mapped(folder, keep):
    """Return a core that went there and back, its far arrays in a file, and its journal of checkpoints."""
    folder.mkdir()
    core, writer = MapperCore(CONFIG), JournalWriter(folder, flush_s=60.0)
    if keep is not None:
        core.keep_far_arrays(keep)
    for i, event in enumerate(keyframes(LOOKS)):
        drive(core, [event])
        writer.append(entry(i), known=core.snapshot())
        if i % 3 == 2:
            writer.checkpoint(Checkpoint(core=core.state(), open_jobs=()), event.stamp_ns)
    writer.close()
    return core, (folder / "journal.mcap").read_bytes()


def ended(core):
    core.handle(SourceEnded(stamp_ns=1_000 * SECOND_NS))
    return map_digest(core.snapshot())


def test_far_arrays_change_no_byte_of_journal_and_map(tmp_path, monkeypatch):
    monkeypatch.setattr(derived, "_KEEP_KEYFRAMES", 1)
    monkeypatch.setattr(array_spill, "_LEAST_BYTES", 1)
    far = FarArrays(tmp_path)
    alone, expected = mapped(tmp_path / "memory", None)
    core, journal = mapped(tmp_path / "far", far.keep)
    assert far.num_bytes > 0
    assert any(is_packed(track.cloud) for track in core.state()["tracks"].values())
    assert journal == expected
    assert len(core.snapshot().objects) > 3
    assert len(core.submaps) > 2
    digest = ended(alone)
    assert ended(core) == digest
    core.validate()
    # A run that was killed half way, and goes on from its journal.
    with Journal(tmp_path / "far") as read:
        found = read.checkpoint_before(HALF)
    again = MapperCore.from_state(CONFIG, found[1].core)
    again.keep_far_arrays(FarArrays(tmp_path).keep)
    drive(again, keyframes(LOOKS)[found[0] + 1 :])
    assert ended(again) == digest


def test_a_resumed_run_reads_only_arrays_in_use(tmp_path):
    before, _ = mapped(tmp_path / "map", None)
    with Journal(tmp_path / "map") as read:
        last = len(read) - 1
        core = MapperCore.from_state(CONFIG, read.checkpoint_before(last, reads_later=True)[1].core)
        writer = JournalWriter(tmp_path / "map", flush_s=60.0, continued=read)
    size = (tmp_path / "map" / "journal.mcap").stat().st_size
    writer.append(entry(last + 1))
    writer.checkpoint(Checkpoint(core=core.state(), open_jobs=()), 1_000)
    tracks = core.state()["tracks"]
    far = [track for track in tracks.values() if len(track.cloud) > 100]
    assert far
    assert all(is_packed(track.cloud) for track in far)
    # It goes on: arrays that are read now are those of the copy.
    drive(core, [keyframes(LOOKS)[-1]])
    writer.checkpoint(Checkpoint(core=core.state(), open_jobs=()), 1_001)
    writer.close()
    with Journal(tmp_path / "map") as read:
        chunks = read._chunks.places[-4:]
        # The arrays of the first checkpoint, none, are a small part of the document, and this of the whole.
        assert chunks[0].end - chunks[0].start < 200
        assert chunks[1].end - chunks[1].start < size / 50
        again = read.checkpoint_before(len(read))
    drive(before, [keyframes(LOOKS)[-1]])
    assert ended(MapperCore.from_state(CONFIG, again[1].core)) == ended(core) == ended(before)


def test_far_arrays_read_back_reuse_room_and_show_no_file(tmp_path):
    far = FarArrays(tmp_path)
    kept = {seed: far.keep(some_bytes(seed)) for seed in range(60)}
    assert all(read() == some_bytes(seed) for seed, read in kept.items())
    most = far.num_bytes
    for seed in range(60, 600):
        kept[seed % 60] = far.keep(some_bytes(seed % 60))
    assert all(read() == some_bytes(seed) for seed, read in kept.items())
    # One room is let go only after the next one was taken.
    assert far.num_bytes <= 2 * most
    assert list(tmp_path.iterdir()) == []


class _FullDisk:
    """A file that takes so many bytes."""

    def __init__(self, file, left):
        self._file, self._left = file, left

    def write(self, data):
        if self._left == 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        written = self._file.write(data[: self._left])
        self._left -= written
        return written

    def __getattr__(self, name):
        return getattr(self._file, name)


def test_a_disk_that_fills_up_is_told_once_and_loses_nothing(tmp_path, monkeypatch, caplog):
    make = tempfile.TemporaryFile
    monkeypatch.setattr(tempfile, "TemporaryFile", lambda **options: _FullDisk(make(**options), 300_000))
    far = FarArrays(tmp_path)
    with caplog.at_level(logging.WARNING):
        kept = [far.keep(some_bytes(seed)) for seed in range(60)]
    assert 0 < far.num_bytes <= 300_000
    assert [read() for read in kept] == [some_bytes(seed) for seed in range(60)]
    (told,) = caplog.messages
    assert "stays in memory from now on" in told and "No space left on device" in told


def test_a_folder_that_takes_no_file_is_told_and_memory_has_it(tmp_path, caplog):
    with caplog.at_level(logging.WARNING):
        read = FarArrays(tmp_path / "none").keep(bytes(5000))
    assert read() == bytes(5000)
    assert "No such file or directory" in caplog.text


def test_a_process_that_is_killed_leaves_nothing(tmp_path):
    program = (
        "import os, signal, sys; from pathlib import Path; "
        "from hickory_stream.map_folder.array_spill import FarArrays; "
        "far = FarArrays(Path(sys.argv[1])); read = far.keep(bytes(range(256)) * 40); "
        "assert read() == bytes(range(256)) * 40; os.kill(os.getpid(), signal.SIGKILL)"
    )
    assert subprocess.run([sys.executable, "-c", program, str(tmp_path)], check=False).returncode == -9
    assert list(tmp_path.iterdir()) == []
