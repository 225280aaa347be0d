import asyncio
import json
import threading
from dataclasses import replace
from itertools import islice
import numpy as np
import pytest
from hickory_stream.box_scene import START_NS, SceneSource
from hickory_stream.cli import main
from hickory_stream.config import MapperConfig
from hickory_stream.engine.mapper import Mapper
from hickory_stream.engine.publisher import ReportPublisher
from hickory_stream.engine.shape_jobs.queue import ShapeQueue
from hickory_stream.engine.warm_up import rehearse
from hickory_stream.errors import OutputError, RecordingError
from hickory_stream.events import PoseJumped
from hickory_stream.geometry.rigid import from_rotation_translation, yaw_rotation
from hickory_stream.journal.format import JOURNAL
from hickory_stream.journal.reader import Journal
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.map_folder.history.replay import replay
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.perception.choose import make_extractor, make_segmenter
from hickory_stream.testing import InstanceSegmenter, RememberingSink
from tests.engine.run_fixtures import NO_SHAPES, NUM_FRAMES, map_scene, scene_config

# The first frame is mapped, the last 32 wait.
FIRST_TAKEN = 5 * NUM_FRAMES - 32
JUMPS = {i: from_rotation_translation(yaw_rotation(0.1 * i), np.array([i, 0.0, 0.0])) for i in (2, 5, FIRST_TAKEN)}


class HeldSegmenter(InstanceSegmenter):
    """Holds its first frame until it is let go."""

    def __init__(self):
        super().__init__(SceneSource(5 * NUM_FRAMES).instances)
        self.go_on = threading.Event()

    def segment(self, frame, prior=None, prepared=None):
        assert self.go_on.wait(60)
        return super().segment(frame, prior, prepared)


class TellingSource(SceneSource):
    """Lets a segmenter go on when it has been read to its end."""

    def __init__(self, segmenter, rounds, num_frames=NUM_FRAMES):
        super().__init__(num_frames)
        self._segmenter = segmenter
        self._rounds = rounds

    def frames(self):
        yield from super().frames()
        self._rounds -= 1
        if self._rounds == 0:
            self._segmenter.go_on.set()


class JumpingSource(TellingSource):
    """Frames at some places of the log tell that the odometry jumped."""

    def frames(self):
        for i, raw in enumerate(super().frames()):
            yield replace(raw, after_from_before=JUMPS.get(i))


def fates(path):
    return dict(open_map(path).ledger["frames"])


def test_a_live_run_that_keeps_up_maps_all_and_replays_the_same(tmp_path):
    run = map_scene(tmp_path, mode="live", rate=3.0)
    manifest = open_map(run.folder.path).manifest
    assert manifest.finished_cleanly
    assert not manifest.is_reproducible
    assert manifest.run["mode"] == "live"
    frames = fates(run.folder.path)
    assert frames["read"] == NUM_FRAMES == frames["keyframes"] + frames.get("keyframes_dropped", 0)
    assert all(tracked.shape is not None for tracked in run.snapshots[-1].objects)
    assert map_digest(replay(run.folder.path)) == run.digest


def test_frames_during_a_busy_map_are_dropped_and_counted(tmp_path):
    segmenter = HeldSegmenter()
    source = TellingSource(segmenter, rounds=6)
    map_scene(tmp_path, *NO_SHAPES, source=source, segmenter=segmenter, mode="live", loops=6)
    frames = fates(tmp_path / "map")
    assert frames["read"] == 6 * NUM_FRAMES
    # One was held, the newest of those that waited was mapped, the oldest had no room.
    assert frames["keyframes"] == 2
    assert frames["frames_dropped"] == 6 * NUM_FRAMES - 1 - 32
    assert frames["keyframes_dropped"] == 32 - 1
    lost = frames["frames_dropped"] + frames["keyframes_dropped"] + frames.get("between_keyframes", 0)
    assert frames["read"] == frames["keyframes"] + lost
    with Journal(tmp_path / "map") as journal:
        assert journal.step(1).frames[-1].index == 6 * NUM_FRAMES - 1


def test_jumps_of_dropped_frames_are_told_by_the_next_one(tmp_path):
    segmenter = HeldSegmenter()
    source = JumpingSource(segmenter, rounds=1, num_frames=5 * NUM_FRAMES)
    map_scene(tmp_path, *NO_SHAPES, source=source, segmenter=segmenter, mode="live")
    frames = fates(tmp_path / "map")
    assert frames["frames_dropped"] == FIRST_TAKEN - 1
    with Journal(tmp_path / "map") as journal:
        events = [event for i in range(len(journal)) for event in journal.entry(i).events]
    jump = next(event.after_from_before for event in events if isinstance(event, PoseJumped))
    np.testing.assert_allclose(jump, JUMPS[FIRST_TAKEN] @ JUMPS[5] @ JUMPS[2], atol=1e-12)


def test_the_map_is_shown_before_shapes_are_asked_for(tmp_path, monkeypatch):
    happened = []
    show = ReportPublisher.show

    async def shown(announcer, report, **options):
        happened.append(f"shown {report.keyframe_index}")
        await show(announcer, report, **options)

    async def asked(queue, request):
        del queue
        # A request is due half a second after its keyframe; they are half a second apart.
        happened.append(f"asked {round((request.due_ns - START_NS) / 5e8) - 1}")

    monkeypatch.setattr(ReportPublisher, "show", shown)
    monkeypatch.setattr(ShapeQueue, "request", asked)
    map_scene(tmp_path, mode="live", rate=3.0)
    requests = [entry for entry in happened if entry.startswith("asked")]
    assert requests
    for entry in requests:
        assert happened.index(entry.replace("asked", "shown")) < happened.index(entry), happened


@pytest.mark.parametrize(("mode", "is_rehearsed"), [("live", True), ("playback", False)])
def test_a_live_run_tries_its_models_before_the_first_frame(mode, is_rehearsed, tmp_path, monkeypatch):
    happened = []

    class NotingSource(SceneSource):
        def frames(self):
            happened.append("read")
            return super().frames()

    def noted(*_):
        happened.append("rehearsed")

    monkeypatch.setattr("hickory_stream.engine.mapper.rehearse", noted)

    async def run():
        async with Mapper(scene_config(tmp_path, *NO_SHAPES), out=tmp_path / "map") as mapper:
            async for _ in mapper.run(NotingSource(1), mode=mode):
                pass
            mapper.rehearse()

    asyncio.run(run())
    # Once.
    assert happened == (["rehearsed", "read"] if is_rehearsed else ["read", "rehearsed"])


def test_a_rehearsal_leaves_nothing_behind():
    config = MapperConfig()
    segmenter, extractor = make_segmenter(config.perception), make_extractor(config.perception)
    frame = next(SceneSource(1).frames()).decode()
    before = segmenter.segment(frame)
    rehearse(segmenter, extractor, config, num_frames=2)
    after = segmenter.segment(frame)
    np.testing.assert_array_equal(before.instances, after.instances)


class HangingSink(RememberingSink):
    def __init__(self):
        super().__init__()
        self.go_on = threading.Event()

    def show(self, report):
        assert self.go_on.wait(60)
        super().show(report)


def test_a_viewer_that_hangs_holds_nothing_up(tmp_path):
    hanging = HangingSink()

    def sinks(folder):
        from hickory_stream.sinks.disk_sink import DiskSink

        # It goes on when the map is there: had it been waited for, that would never be.
        return [(DiskSink(folder), True), (hanging, False), (Releasing(hanging), False)]

    map_scene(tmp_path, *NO_SHAPES, mode="live", loops=4, rate=20.0, sinks=sinks)
    frames = fates(tmp_path / "map")
    assert frames["read"] == 4 * NUM_FRAMES
    assert frames["reports_not_shown"] > 0


class Releasing(RememberingSink):
    """Lets a hanging sink go when it is closed itself."""

    def __init__(self, hanging):
        super().__init__()
        self._hanging = hanging

    def close(self):
        self._hanging.go_on.set()


def test_a_killed_live_run_is_saved_up_to_its_last_step(tmp_path, capsys):
    folder = map_scene(tmp_path, *NO_SHAPES, mode="live", rate=3.0).folder.path
    with Journal(folder) as journal:
        end = journal._places[4].end
    (folder / JOURNAL).write_bytes((folder / JOURNAL).read_bytes()[: end + 60])
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps({**manifest, "finished_cleanly": False}))
    assert main(["resume", str(folder), "--json"]) == 0
    saved = json.loads(capsys.readouterr().out)
    assert saved["event"] == "saved"
    assert saved["digest"] == map_digest(open_map(folder).snapshot) == map_digest(replay(folder))
    assert not open_map(folder).manifest.finished_cleanly
    assert main(["inspect", str(folder)]) == 0
    assert "nothing is left to save" in capsys.readouterr().err


class Restamped(SceneSource):
    """The scene with stamps of one's own, in seconds from the start."""

    def __init__(self, seconds):
        super().__init__(len(seconds))
        self._seconds = seconds

    def frames(self):
        for raw, second in zip(super().frames(), self._seconds, strict=True):
            stamp_ns = START_NS + int(second * 1e9)
            yield replace(raw, stamp_ns=stamp_ns, decode=lambda raw=raw, s=stamp_ns: replace(raw.decode(), stamp_ns=s))


class AnyStamp(InstanceSegmenter):
    """Finds nothing: what is tested here is time."""

    def __init__(self):
        super().__init__({})

    def segment(self, frame, prior=None, prepared=None):
        none = np.zeros(frame.depth_m.shape, dtype=np.int32)
        return InstanceSegmenter({frame.stamp_ns: none}).segment(frame)


def jumps(path, seconds, loops=1):
    map_scene(path, *NO_SHAPES, source=Restamped(seconds), segmenter=AnyStamp(), loops=loops)
    with Journal(path / "map") as journal:
        kinds = [str(e.kind) for i in range(len(journal)) for e in journal.events(i, "TimeJumped")]
    return kinds, fates(path / "map")


@pytest.mark.parametrize(("seconds", "loops", "kinds"), [
    ((0.0, 0.3, 0.6), 1, []), ((0.0, 0.3, 30.0), 1, []), ((0.0, 0.3, 300.0), 1, ["seek"]),
    ((0.0, 5.0, 10.0, 3.0), 1, ["seek"]), ((0.0, 5.0, -1000.0), 1, ["restart"]), ((0.0, 0.3), 3, ["loop", "loop"]),
])  # fmt: skip
def test_a_seek_a_restart_and_a_loop_are_told_apart(tmp_path, seconds, loops, kinds):
    found, frames = jumps(tmp_path, seconds, loops)
    assert found == kinds
    assert frames["read"] == loops * len(seconds)


def test_a_frame_that_is_merely_late_is_left_out_and_no_jump(tmp_path):
    kinds, frames = jumps(tmp_path, (0.0, 0.3, 0.6, 0.4, 0.9))
    assert kinds == []
    assert frames.pop("keyframes_without_depth", 0) == 0
    assert frames == {"read": 5, "keyframes": 4, "frames_late": 1}


def test_a_live_frame_that_is_torn_is_counted(tmp_path):
    class Torn(SceneSource):
        def frames(self):
            for raw in super().frames():
                yield replace(raw, decode=_torn) if raw.index == 3 else raw

    map_scene(tmp_path, *NO_SHAPES, source=Torn(NUM_FRAMES), mode="live", rate=3.0)
    frames = fates(tmp_path / "map")
    assert frames.get("frames_undecodable", 0) + frames.get("keyframes_dropped", 0) >= 1
    assert frames["read"] == NUM_FRAMES == sum(frames.values()) - frames["read"]


def _torn():
    raise RecordingError("a torn image")


class SilentSource(SceneSource):
    """Gives some frames, and then none until it is interrupted, as a robot that is gone."""

    def __init__(self):
        super().__init__(NUM_FRAMES)
        self.interrupted = threading.Event()

    def frames(self):
        yield from islice(super().frames(), 3)
        assert self.interrupted.wait(60)

    def interrupt(self):
        self.interrupted.set()


class FailingSink(RememberingSink):
    """Cannot show anything: the disk is full."""

    def show(self, report):
        raise OutputError("no space is left")


def test_a_failing_run_ends_although_its_source_is_silent(tmp_path):
    source = SilentSource()
    with pytest.raises(OutputError, match="no space is left"):
        map_scene(tmp_path, *NO_SHAPES, mode="live", source=source, sinks=lambda _: [(FailingSink(), True)])
    assert source.interrupted.is_set()
