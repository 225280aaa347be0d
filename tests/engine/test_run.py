import json
import pytest
from hickory_stream.box_scene import SCENE_BOXES, SceneSource
from hickory_stream.errors import MapFolderError, RecordingError
from hickory_stream.map_folder.saved_map import open_map
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


def test_jobs_that_time_out_leave_objects_without_shape(tmp_path):
    run = map_scene(
        tmp_path, "run.job_timeout_s=1e-9", "mapping.requests.max_failures=1", boxes=SCENE_BOXES[:1], child_workers=True
    )
    assert [tracked.shape for tracked in run.snapshots[-1].objects] == [None]
    ledger = json.loads((run.folder.path / "ledger.json").read_text())
    assert ledger["shapes"] == {"requested": 1, "failed": 1, "limits": 1}
    assert not run.folder.manifest.is_reproducible
    assert shape_workers() == []


def test_further_rounds_of_a_log_add_no_object_and_no_size(tmp_path):
    sink = RememberingSink()
    map_scene(tmp_path, *NO_SHAPES, loops=4, sinks=saved_with((sink, False)))
    once, thrice, four_times = (sink.reports[rounds * NUM_FRAMES - 1].snapshot for rounds in (1, 3, 4))
    assert [t.id for t in once.objects] == [t.id for t in thrice.objects] == [t.id for t in four_times.objects]
    for a, b in zip(thrice.objects, four_times.objects, strict=True):
        assert b.sightings > a.sightings
        assert len(b.points_world) <= 1.05 * len(a.points_world)
        assert len(b.views) <= len(a.views)
    space_a, space_b = thrice.submaps[0].observed_space, four_times.submaps[0].observed_space
    assert len(space_b.free) <= 1.05 * len(space_a.free)
    assert len(space_b.structure) <= 1.05 * len(space_a.structure)


def test_a_second_round_is_a_time_jump_and_frame_numbers_go_on(tmp_path):
    sink = RememberingSink()
    run = map_scene(tmp_path, *NO_SHAPES, loops=2, sinks=saved_with((sink, False)))
    assert [report.index for report in sink.reports] == list(range(2 * NUM_FRAMES + 1))
    frames = json.loads((run.folder.path / "ledger.json").read_text())["frames"]
    assert frames == {"read": 2 * NUM_FRAMES, "keyframes": 2 * NUM_FRAMES, "time_jumps": 1}


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
