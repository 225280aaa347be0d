from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.box_scene import SCENE_CAMERA, SceneBox, SceneSource
from hickory_stream.geometry.rigid import compose, from_rotation_translation, yaw_rotation
from hickory_stream.graph.gtsam_solver import Factors
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.map_folder.history.replay import replay
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.records import Loop
from hickory_stream.testing import InstanceSegmenter
from tests.engine.run_fixtures import NO_SHAPES, map_scene, resume_scene

NUM_FRAMES = 33  # once around the boxes, and a quarter, in steps of 14 degrees
CAMERA = SCENE_CAMERA.scaled(2 / 3)


def step_of(index):
    """The step on the camera's circle of a frame."""
    return 2 * index


# Keyframes are left where the odometry has them: what is tested is what loops make of that.
SHORT = ("mapping.submaps.travel_m=3.0", "mapping.submaps.loop_latency_s=0.6", "registration.enabled=false")


def drift(index):
    """What the odometry makes of the world: it turns and shifts, ever more."""
    share = index / NUM_FRAMES
    return from_rotation_translation(yaw_rotation(0.06 * share), np.array([0.25, -0.15, 0.0]) * share)


class DriftingSource(SceneSource):
    """The scene, its poses those of an odometry that drifts."""

    def frames(self):
        for raw in super().frames():
            pose = compose(drift(raw.index), raw.world_from_camera)

            def decode(raw=raw, pose=pose):
                return replace(raw.decode(), world_from_camera=pose)

            yield replace(raw, world_from_camera=pose, decode=decode)


def run(path, *overrides, name="map"):
    source = DriftingSource(NUM_FRAMES, camera=CAMERA, step_of=step_of)
    segmenter = InstanceSegmenter(source.instances)
    return map_scene(path, *NO_SHAPES, *SHORT, *overrides, name=name, source=source, segmenter=segmenter)


@pytest.fixture(scope="module")
def closed(tmp_path_factory):
    return run(tmp_path_factory.mktemp("closed"))


def worst_place_m(found):
    """How far the last submap is from where it is in truth, against the first one."""
    there = compose(found.snapshots[-1].submaps[-1].world_from_submap, drift(NUM_FRAMES - 1))
    return float(np.linalg.norm(there[:3, 3]))


def test_the_loop_is_found_and_the_last_submap_is_in_place(closed):
    graph = closed.snapshots[-1].graph
    accepted = [(edge.earlier, edge.later) for edge in graph.loops if edge.status == "accepted"]
    assert accepted
    assert all(earlier + 2 <= later for earlier, later in accepted)
    # What drifts within the last submap itself stays.
    assert worst_place_m(closed) < 0.6 * float(np.linalg.norm([0.25, -0.15]))
    ledger = open_map(closed.folder.path).ledger["frames"]
    assert ledger["loops"] == len([loop for loop in graph.loops if not loop.reason])
    assert ledger["loop_corrections"] >= 1


def test_the_map_is_reproducible_and_its_journal_replays_it(closed):
    saved = open_map(closed.folder.path)
    assert saved.manifest.is_reproducible
    assert map_digest(saved.snapshot) == closed.digest
    assert map_digest(replay(closed.folder.path)) == closed.digest


def test_a_run_stopped_during_a_loop_search_gives_the_same_map(closed, tmp_path):
    async def stop(mapper, snapshot):
        if len(snapshot.submaps) == 4:  # the third has ended, and is searched
            mapper.stop()

    source = DriftingSource(NUM_FRAMES, camera=CAMERA, step_of=step_of)
    segmenter = InstanceSegmenter(source.instances)
    map_scene(tmp_path, *NO_SHAPES, *SHORT, source=source, segmenter=segmenter, on_snapshot=stop, rate=20.0)

    assert resume_scene(tmp_path / "map", DriftingSource(NUM_FRAMES, camera=CAMERA, step_of=step_of)) == closed.digest


def test_without_loops_the_map_keeps_drift_and_duplicates(tmp_path, closed):
    plain = run(tmp_path, "mapping.submaps.searches_loops=false")
    assert plain.snapshots[-1].graph is None
    assert all(np.array_equal(s.world_from_submap, np.eye(4)) for s in plain.snapshots[-1].submaps)
    assert worst_place_m(plain) > 0.25
    assert len(plain.snapshots[-1].objects) > len(closed.snapshots[-1].objects)


@pytest.mark.parametrize(("num_solved", "says"), [(0, "are not searched"), (1, "loops are left out")])
def test_a_graph_that_leaves_a_place_open_costs_its_loops_not_the_run(num_solved, says, tmp_path, monkeypatch, caplog):
    solved, marginals = [], Factors.marginals

    def left_open(factors, poses):
        if len(solved) == num_solved:
            raise RuntimeError("Indeterminant linear system")
        solved.append(poses)
        return marginals(factors, poses)

    monkeypatch.setattr(Factors, "marginals", left_open)
    found = run(tmp_path)
    assert found.snapshots[-1].graph is None
    assert open_map(found.folder.path).manifest.finished_cleanly
    assert says in caplog.text


SEARCH = "hickory_stream.loops.search.search_loops"
NUM_FRAMES_OF_TWO, APART_M = 20, 0.6
# No face lies on the border of two cells, where the rounding of points would choose between them.
LEFT, RIGHT = (
    SceneBox(low=(x, -0.347, 0.0), high=(x + 0.3, -0.047, 0.404), rgb=(190, 80, 60)) for x in (-0.497, APART_M - 0.497)
)
BOXES = (LEFT, RIGHT, SceneBox(low=(-0.15, 0.25, 0.0), high=(0.2, 0.5, 0.55), rgb=(120, 170, 80)))
# Odometry that may err by half a metre in a submap allows that the right one of two like boxes is the left one.
CONFIG = (
    "mapping.submaps.travel_m=1.4", "mapping.submaps.loop_latency_s=0.6", "registration.enabled=false",
    "graph.path_noise=0.3",
)  # fmt: skip


def loop(earlier, later, shift_m):
    """A sure loop that has the later submap off by a shift along x."""
    return Loop(
        earlier=earlier, later=later,
        earlier_from_later=from_rotation_translation(np.eye(3), np.array([shift_m, 0.0, 0.0])),
        covariance=np.diag([1e-4] * 3 + [4e-4] * 3), method="surface", score=0.9,
    )  # fmt: skip


def found(query, *_):
    """What the search answers: a wrong loop for submap 2, true ones for those after the next one."""
    if query.later_id == 2:
        return (loop(0, 2, -APART_M),)
    return tuple(loop(earlier, query.later_id, 0.0) for earlier in (0, 2)) if query.later_id > 3 else ()


def source():
    return SceneSource(NUM_FRAMES_OF_TWO, BOXES, camera=SCENE_CAMERA.scaled(1 / 2), step_of=lambda index: 2 * index)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder, scene = tmp_path_factory.mktemp("whole"), source()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SEARCH, found)
        return map_scene(folder, *NO_SHAPES, *CONFIG, source=scene, segmenter=InstanceSegmenter(scene.instances))


def centers(snapshot):
    return np.array([item.box.center[:2] for item in snapshot.objects])


def test_a_wrong_loop_is_withdrawn_with_all_that_it_merged(whole):
    statuses = [
        {(edge.earlier, edge.later): edge.status for edge in snapshot.graph.loops}
        for snapshot in whole.snapshots
        if snapshot.graph is not None
    ]
    assert [each[0, 2] for each in statuses] == sorted(each[0, 2] for each in statuses)
    assert {each[0, 2] for each in statuses} == {"accepted", "withdrawn"}
    assert {status for pair, status in statuses[-1].items() if pair != (0, 2)} == {"accepted"}
    # While it was believed, the left box was taken for the right one, and the left one seen beside it for a new one.
    wrong = [s for s in whole.snapshots if s.graph is not None and len(s.graph.loops) == 1][-1]
    assert len(wrong.objects) == 5
    assert abs(centers(wrong)[:, 0].min() - (LEFT.low[0] - APART_M)) < 0.3
    last = whole.snapshots[-1]
    assert [item.id for item in last.objects] == [1, 2, 3]
    true = np.array([[0.5 * (box.low[i] + box.high[i]) for i in (0, 1)] for box in BOXES])
    assert np.abs(centers(last) - true).max() < 0.05
    # What was seen meanwhile is with the one that was seen.
    assert min(item.sightings for item in last.objects) >= NUM_FRAMES_OF_TWO // 2
    assert max(item.last_seen_ns for item in last.objects) == last.stamp_ns
    assert all(np.allclose(submap.world_from_submap, np.eye(4), atol=1e-4) for submap in last.submaps)


def test_its_journal_replays_the_map_and_the_believed_past(whole):
    saved = open_map(whole.folder.path)
    assert map_digest(saved.snapshot) == whole.digest
    assert map_digest(replay(whole.folder.path)) == whole.digest
    wrong = [s for s in whole.snapshots if s.graph is not None and len(s.graph.loops) == 1][-1]
    assert len(saved.as_known_at(wrong.stamp_ns).objects) == 5


def test_a_run_stopped_while_believing_it_gives_the_same_map(whole, tmp_path, monkeypatch):
    monkeypatch.setattr(SEARCH, found)

    async def stop(mapper, snapshot):
        if len(snapshot.objects) == 5:
            mapper.stop()

    scene = source()
    map_scene(
        tmp_path, *NO_SHAPES, *CONFIG, source=scene, segmenter=InstanceSegmenter(scene.instances), on_snapshot=stop,
        rate=20.0,
    )  # fmt: skip

    assert resume_scene(tmp_path / "map", source()) == whole.digest
