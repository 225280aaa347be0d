from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.box_scene import scene_pose
from hickory_stream.engine.keyframe_places import RegistrationFilter
from hickory_stream.geometry.rigid import compose, invert, no_directions
from hickory_stream.journal.reader import Journal
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.map_folder.history.registration_history import registration_summary
from hickory_stream.map_folder.history.replay import replay
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.poses.registration_config import RegistrationConfig
from hickory_stream.testing import InstanceSegmenter
from tests.engine.registration_sources import NUM_FRAMES, Unaware, drifting, room
from tests.engine.run_fixtures import NO_SHAPES, map_scene, resume_scene, stop_at

CONFIG = (*NO_SHAPES, "sensor.noise_per_m=0.0005")


class Kept:
    """A sink that keeps the poses that it was told of, and saves the map."""

    def __init__(self):
        self.poses = {}
        self.decisions = []
        self.folder = None
        self._newest = None

    def show(self, report):
        self.poses.setdefault(report.index, report.world_from_camera)
        self.decisions += report.decisions
        self._newest = report.snapshot or self._newest

    def close(self):
        if self.folder is not None and self._newest is not None:
            self.folder.save(self._newest)

    def of(self, folder):
        self.folder = folder
        return [(self, True)]


def mapped(tmp_path, source, *overrides, sink=None, on_progress=lambda _, __: None, num_frames=NUM_FRAMES, step_of=int):
    return map_scene(
        tmp_path, *CONFIG, *overrides, source=source, segmenter=InstanceSegmenter(room(num_frames, step_of).instances),
        sinks=None if sink is None else sink.of, on_progress=on_progress,
    )  # fmt: skip


def events_of(run_path, kind):
    with Journal(run_path) as journal:
        return [event for index in range(len(journal)) for event in journal.events(index, kind)]


@pytest.fixture(scope="module")
def drifted(tmp_path_factory):
    sink = Kept()
    return mapped(tmp_path_factory.mktemp("drifted"), drifting(room()), sink=sink), sink


def test_a_frame_says_along_what_its_odometry_was_a_guess():
    frames = [raw.decode() for raw in room(2, lambda index: 4 * index).frames()]
    sigmas_m = []
    for degenerate in (no_directions(), np.eye(6)[3:4]):
        places = RegistrationFilter(RegistrationConfig())
        places.place(frames[0])
        placed = places.place(replace(frames[1], degenerate=degenerate, depth_m=np.zeros_like(frames[1].depth_m)))
        sigmas_m.append(np.sqrt(placed.event.covariance[3:, 3:].trace()))
    assert sigmas_m[1] > 2 * sigmas_m[0]


def test_with_exact_poses_nothing_changes(tmp_path):
    on = mapped(tmp_path / "on", room())
    off = mapped(tmp_path / "off", room(), "registration.enabled=false")
    assert on.digest == off.digest
    assert "keyframes_corrected" not in open_map(on.folder.path).ledger["frames"]
    assert len(events_of(on.folder.path, "KeyframeRegistered")) == NUM_FRAMES
    assert events_of(off.folder.path, "KeyframeRegistered") == []


def test_keyframes_of_a_drifting_odometry_are_mapped_truly(drifted):
    run, sink = drifted
    registered = events_of(run.folder.path, "KeyframeRegistered")
    observed = events_of(run.folder.path, "FrameObserved")
    assert len(registered) == len(observed) == NUM_FRAMES
    for event, seen in zip(registered, observed, strict=True):
        assert np.array_equal(event.map_from_camera, seen.world_from_camera)
        assert np.array_equal(sink.poses[seen.frame_index], seen.world_from_camera)
    # It takes some keyframes to see that the odometry errs; what it erred by until then stays.
    first, last = registered[4], registered[-1]
    true_way = compose(invert(scene_pose(4)), scene_pose(NUM_FRAMES - 1))
    raw_way = compose(invert(first.odometry_from_camera), last.odometry_from_camera)
    way = compose(invert(first.map_from_camera), last.map_from_camera)
    assert np.linalg.norm(raw_way[:3, 3] - true_way[:3, 3]) > 0.06
    assert np.linalg.norm(way[:3, 3] - true_way[:3, 3]) < 0.015
    saved = open_map(run.folder.path)
    told, ledger = registration_summary(run.folder.path, saved.ledger), saved.ledger["frames"]
    assert told.moved_m > 0.05
    assert told.text().startswith(
        f"odometry: of {NUM_FRAMES} keyframes {told.corrected} were moved to fit the map, "
        f"{NUM_FRAMES - told.corrected} stayed at their odometry's pose, 0 did not fit and were left out; "
    )
    assert ledger["keyframes_corrected"] == told.corrected >= NUM_FRAMES - 4
    assert ledger["keyframes"] == ledger["read"] == NUM_FRAMES


def test_the_odometry_is_kept_beside_the_corrected_poses(drifted):
    run, _ = drifted
    with Journal(run.folder.path) as journal:
        raw = [frame for index in range(len(journal)) for frame in journal.step(index).frames]
    given = [frame.world_from_camera for frame in drifting(room()).frames()]
    assert [frame.world_from_camera.tobytes() for frame in raw] == [pose.tobytes() for pose in given]


def test_the_journal_of_a_corrected_run_gives_the_same_map(drifted):
    run, sink = drifted
    again = Kept()
    assert map_digest(replay(run.folder.path, [again])) == run.digest
    assert again.poses.keys() == sink.poses.keys()
    assert set(again.decisions) >= set(sink.decisions)
    for index, pose in sink.poses.items():
        assert np.allclose(again.poses[index], pose, atol=1e-12)


@pytest.mark.parametrize("keyframes", [2, 9])
def test_a_stopped_corrected_run_resumes_to_the_same_map(drifted, tmp_path, keyframes):
    mapped(tmp_path, drifting(room()), on_progress=stop_at(keyframes))

    assert resume_scene(tmp_path / "map", drifting(room()), room().instances) == drifted[0].digest


def test_keyframes_that_do_not_fit_are_kept_out_counted_and_told(tmp_path):
    # For three frames the odometry says that the camera went on, and it shows another side of the room.
    def step_of(i):
        return i + 20 if 8 <= i < 11 else i

    run = mapped(tmp_path, Unaware(room(NUM_FRAMES, step_of), scene_pose), step_of=step_of)
    frames = open_map(run.folder.path).ledger["frames"]
    assert frames["keyframes_kept_out"] == 3
    assert frames["keyframes"] == NUM_FRAMES - 3
    assert frames["read"] == NUM_FRAMES
    out = events_of(run.folder.path, "KeyframeKeptOut")
    assert [event.frame_index for event in out] == [8, 9, 10]
    with Journal(run.folder.path) as journal:
        told = [entry.told for entry in journal.entries() if entry.told is not None]
    decisions = [decision.text for each in told for decision in each.decisions if decision.kind == "keep_out"]
    assert len(decisions) == 3
    assert decisions[0].startswith("frame 8 is kept out: ")


def test_a_carried_robot_continues_in_a_new_submap(tmp_path):
    num_frames, carried_at = 26, 10

    def step_of(i):
        return i + 18 if i >= carried_at else i

    away = compose(scene_pose(carried_at), invert(scene_pose(carried_at + 18)))

    def told(i):
        return compose(away, scene_pose(step_of(i))) if i >= carried_at else scene_pose(i)

    run = mapped(tmp_path, Unaware(room(num_frames, step_of), told), num_frames=num_frames, step_of=step_of)
    frames = open_map(run.folder.path).ledger["frames"]
    assert frames["carried_away"] == 1
    assert frames["keyframes_kept_out"] == 7
    assert len(open_map(run.folder.path).snapshot.submaps) == 2
    told = registration_summary(run.folder.path, open_map(run.folder.path).ledger)
    assert (told.kept_out, told.carried_away) == (7, 1)
    assert told.text().startswith(f"odometry: of {frames['keyframes'] + 7} keyframes {told.corrected} were moved")
    assert ", 7 did not fit and were left out; " in told.text()
    assert "; once the robot was suddenly elsewhere than its odometry says" in told.text()
    assert len(events_of(run.folder.path, "PoseJumped")) == 1
