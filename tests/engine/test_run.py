import asyncio
import json
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits
from hickory_stream.box_scene import SceneSource
from hickory_stream.engine.mapper import Mapper
from hickory_stream.errors import MapFolderError, RecordingError, ViewerError
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.ports import SourceAround
from hickory_stream.sinks.disk_sink import DiskSink, DiskSinkConfig
from hickory_stream.testing import BreakingSource, FailingSink, RememberingSink, SlowSink
from tests.engine.run_fixtures import NO_SHAPES, NUM_FRAMES, map_scene, shape_workers, stop_at


@pytest.fixture
def calm_digest(undisturbed_run):
    """The digest of the map that one worker makes undisturbed."""
    assert undisturbed_run.folder.manifest.config["run"]["workers"] == 1
    return undisturbed_run.digest


def saved_with(*others):
    """Return a maker of sinks: the disk after every keyframe, and others."""
    return lambda folder: [(DiskSink(folder, DiskSinkConfig(every_keyframes=1)), True), *others]


def test_the_map_is_the_scene_with_all_four_layers(undisturbed_run):
    run = undisturbed_run
    saved = open_map(run.folder.path)
    assert saved.manifest.finished_cleanly
    assert len(saved.snapshot.objects) == 3
    for tracked in saved.snapshot.objects:
        assert len(saved.mesh(tracked.shape).faces) > 0
        assert 1 <= len(tracked.shape.fitted) <= len(tracked.shape.inflated)
    assert saved.ledger["frames"] == {"read": NUM_FRAMES, "keyframes": NUM_FRAMES}
    assert saved.ledger["source"] == {"frames": NUM_FRAMES}
    shapes = saved.ledger["shapes"]
    assert shapes["requested"] == shapes["ready"] >= 3
    assert not run.folder.jobs.exists()
    assert min(saved.timings.values()) >= 0.0


def test_a_killed_worker_is_replaced_and_the_map_is_the_same(tmp_path, calm_digest):
    killed = []

    def kill_once(_, progress):
        if progress.open_shapes and not killed:
            for child in shape_workers()[:1]:
                killed.append(child.pid)
                child.kill()

    assert map_scene(tmp_path, on_progress=kill_once, child_workers=True).digest == calm_digest
    assert len(killed) == 1


def test_further_rounds_of_a_log_add_no_object_and_no_size(tmp_path):
    sink = RememberingSink()
    run = map_scene(tmp_path, *NO_SHAPES, loops=4, sinks=saved_with((sink, False)))
    assert [report.index for report in sink.reports] == list(range(4 * NUM_FRAMES + 1))
    frames = json.loads((run.folder.path / "ledger.json").read_text())["frames"]
    assert frames == {"read": 4 * NUM_FRAMES, "keyframes": 4 * NUM_FRAMES, "time_jumps": 3}
    once, thrice, four_times = (sink.reports[rounds * NUM_FRAMES - 1].snapshot for rounds in (1, 3, 4))
    assert [t.id for t in once.objects] == [t.id for t in thrice.objects] == [t.id for t in four_times.objects]
    for a, b in zip(thrice.objects, four_times.objects, strict=True):
        assert b.sightings > a.sightings
        assert len(b.points_world) <= 1.05 * len(a.points_world)
        assert len(b.views) <= len(a.views)
    space_a, space_b = thrice.submaps[0].observed_space, four_times.submaps[0].observed_space
    assert len(space_b.free) <= 1.05 * len(space_a.free)
    assert len(space_b.structure) <= 1.05 * len(space_a.structure)


def test_a_slow_sink_gets_every_frame_and_the_finished_map(tmp_path):
    sink = RememberingSink()
    run = map_scene(tmp_path, *NO_SHAPES, sinks=saved_with((SlowSink(sink, 0.03), False)))
    assert [report.index for report in sink.reports] == list(range(NUM_FRAMES + 1))
    assert [report.keyframe_index for report in sink.reports] == list(range(NUM_FRAMES + 1))
    assert sink.reports[-1].snapshot is run.snapshots[-1]
    assert sink.is_closed


def test_a_failing_optional_sink_changes_neither_run_nor_map(tmp_path, calm_digest):
    run = map_scene(tmp_path, sinks=saved_with((FailingSink(2, RuntimeError("no viewer")), False)))
    assert run.digest == calm_digest
    assert open_map(run.folder.path).manifest.finished_cleanly


def test_a_failing_essential_sink_stops_the_run_with_its_error(tmp_path):
    sink = FailingSink(3, MapFolderError("cannot write m: the disk is full"))
    with pytest.raises(MapFolderError, match="the disk is full"):
        map_scene(tmp_path, *NO_SHAPES, sinks=saved_with((sink, True)))
    saved = open_map(tmp_path / "map")
    assert not saved.manifest.finished_cleanly
    assert len(saved.snapshot.objects) == 3
    assert saved.ledger["frames"]["read"] < NUM_FRAMES * 3


def test_a_breaking_source_ends_the_run_and_keeps_the_map(tmp_path):
    source = BreakingSource(SceneSource(NUM_FRAMES), 6, RecordingError("desk.mcap is torn at 60 %"))
    with pytest.raises(RecordingError, match="torn at 60 %"):
        map_scene(tmp_path, source=source, sinks=saved_with(), child_workers=True)
    saved = open_map(tmp_path / "map")
    assert not saved.manifest.finished_cleanly
    assert len(saved.snapshot.objects) == 3
    assert saved.ledger["source"] == {"frames": 7}
    assert shape_workers() == []


def test_a_source_with_its_own_error_leaves_no_child(tmp_path):
    source = BreakingSource(SceneSource(NUM_FRAMES), 6, ZeroDivisionError("in somebody's source"))
    with pytest.raises(ZeroDivisionError):
        map_scene(tmp_path, source=source, child_workers=True)
    assert shape_workers() == []


def test_a_stop_ends_after_the_frames_that_are_read_and_saves(tmp_path):
    saved = open_map(map_scene(tmp_path, "run.grace_s=0.0", on_progress=stop_at(2), child_workers=True).folder.path)
    assert not saved.manifest.finished_cleanly
    assert 2 <= saved.ledger["frames"]["keyframes"] < NUM_FRAMES
    assert len(saved.snapshot.objects) == 3
    assert shape_workers() == []


def test_a_stop_does_not_wait_for_all_last_shapes(tmp_path):
    def stop(mapper, progress):
        if progress.phase == "shapes":
            mapper.stop()

    patience = ("mapping.requests.first_sightings=99", "run.grace_s=0.0")
    saved = open_map(map_scene(tmp_path, *patience, on_progress=stop, child_workers=True).folder.path)
    assert not saved.manifest.finished_cleanly
    assert 1 <= sum(tracked.shape is not None for tracked in saved.snapshot.objects) < 3
    assert shape_workers() == []


def test_a_job_that_runs_at_a_stop_gets_the_grace_period(tmp_path):
    run = map_scene(tmp_path, "run.grace_s=60.0", on_progress=stop_at(5))
    ledger = json.loads((run.folder.path / "ledger.json").read_text())["shapes"]
    assert ledger["requested"] == ledger["ready"] >= 1


def test_snapshots_come_in_order_and_the_last_is_the_saved_map(tmp_path):
    run = map_scene(tmp_path, *NO_SHAPES)
    revisions = [snapshot.revision for snapshot in run.snapshots]
    assert revisions == sorted(revisions)
    saved = open_map(run.folder.path).snapshot
    assert saved.revision == revisions[-1]
    assert [tracked.id for tracked in saved.objects] == [tracked.id for tracked in run.snapshots[-1].objects]


def test_a_slow_consumer_sees_the_newest_map_and_always_the_last(tmp_path):
    async def linger(mapper, snapshot):
        if snapshot.revision == 1:
            while not mapper.folder.manifest.finished_cleanly:  # noqa: ASYNC110 -- the end of a run is no event
                await asyncio.sleep(0.01)

    run = map_scene(tmp_path, *NO_SHAPES, on_snapshot=linger)
    assert len(run.snapshots) == 2
    assert run.snapshots[-1].revision == NUM_FRAMES


def test_a_temporary_map_folder_exists_while_mapping_only():
    async def run():
        async with Mapper() as mapper:
            async for _ in mapper.run(SceneSource(2)):
                pass
            assert open_map(mapper.folder.path).manifest.finished_cleanly
            return mapper.folder.path

    assert not asyncio.run(run()).exists()


@pytest.mark.parametrize("is_broken", [False, True])
@pytest.mark.parametrize("is_temporary", [False, True])
def test_leaving_the_loop_early_ends_the_run_and_saves_the_map(tmp_path, is_temporary, is_broken):
    complaints, left = [], []

    async def run():
        asyncio.get_running_loop().set_exception_handler(lambda _, context: complaints.append(context))
        async with Mapper(out=None if is_temporary else tmp_path / "map") as mapper:
            left.append(mapper)
            async for _ in mapper.run(SceneSource(8)):
                if is_broken:
                    raise KeyError("what the consumer looked for")
                break

    with pytest.raises(KeyError, match="consumer") if is_broken else nullcontext():
        asyncio.run(run())
    assert complaints == []
    if is_temporary:
        assert not left[0].folder.path.exists()
    else:
        assert left[0].was_stopped
        saved = open_map(tmp_path / "map")
        assert not saved.manifest.finished_cleanly
        assert saved.ledger["frames"]["read"] >= 1


def test_linear_algebra_has_one_thread_while_mapping_only():
    def threads():
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    async def run():
        async with Mapper():
            return threads()

    with threadpool_limits(limits=2, user_api="blas"):
        assert set(asyncio.run(run())) == {1}
        assert set(threads()) == {2}


def test_a_consumer_that_leaves_early_leaves_a_map_and_no_child(tmp_path):
    async def leave(mapper, snapshot):
        if snapshot.revision >= 4:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        map_scene(tmp_path, on_snapshot=leave, child_workers=True)
    assert not open_map(tmp_path / "map").manifest.finished_cleanly
    assert shape_workers() == []


class BlindSource(SourceAround):
    def frames(self):
        for raw in self._source.frames():
            frame = raw.decode()
            yield replace(raw, decode=partial(replace, frame, depth_m=np.full_like(frame.depth_m, np.nan)))


@pytest.mark.parametrize(("source", "told"), [
    (SceneSource(0), r"memory:scene gave no usable frame \(frames 0\)"),
    (BlindSource(SceneSource(NUM_FRAMES)), rf"memory:scene has no depth in any of {NUM_FRAMES} keyframes"),
])  # fmt: skip
def test_a_source_without_frames_or_depth_leaves_no_map(tmp_path, source, told):
    with pytest.raises(RecordingError, match=told):
        map_scene(tmp_path, source=source)
    assert not (tmp_path / "map").exists()


def test_a_sink_that_cannot_be_made_leaves_no_map(tmp_path):
    def fail(folder):
        raise ViewerError("there is no screen")

    with pytest.raises(ViewerError, match="no screen"):
        map_scene(tmp_path, sinks=fail)
    assert not (tmp_path / "map").exists()
