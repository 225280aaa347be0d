"""A wrong loop that a run believes, and that later ones contradict: what it joined is parted, in the whole log's map.

The search is stood in for by one that gives a wrong loop between two places that look alike, and true ones later.
"""

import numpy as np
import pytest
from hickory_stream.box_scene import SCENE_CAMERA, SceneBox, SceneSource
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.map_folder.history.replay import replay
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.records import Loop
from hickory_stream.testing import InstanceSegmenter
from tests.engine.run_fixtures import NO_SHAPES, map_scene, resume_scene

NUM_FRAMES, APART_M = 20, 0.6
# No face lies on the border of two cells, where the rounding of points would choose between them.
LEFT, RIGHT = (
    SceneBox(low=(x, -0.347, 0.0), high=(x + 0.3, -0.047, 0.404), rgb=(190, 80, 60)) for x in (-0.497, APART_M - 0.497)
)
BOXES = (LEFT, RIGHT, SceneBox(low=(-0.15, 0.25, 0.0), high=(0.2, 0.5, 0.55), rgb=(120, 170, 80)))
# Odometry that may err by half a metre in a submap allows that the right one of two like boxes is the left one.
CONFIG = (
    "mapping.submaps.travel_m=1.4",
    "mapping.submaps.loop_latency_s=0.6",
    "registration.enabled=false",
    "graph.path_noise=0.3",
)


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


@pytest.fixture(scope="module", autouse=True)
def search():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hickory_stream.loops.search.search_loops", found)
        yield


def source():
    return SceneSource(NUM_FRAMES, BOXES, camera=SCENE_CAMERA.scaled(1 / 2), step_of=lambda index: 2 * index)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder, scene = tmp_path_factory.mktemp("whole"), source()
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
    assert min(item.sightings for item in last.objects) >= NUM_FRAMES // 2
    assert max(item.last_seen_ns for item in last.objects) == last.stamp_ns
    assert all(np.allclose(submap.world_from_submap, np.eye(4), atol=1e-4) for submap in last.submaps)


def test_its_journal_replays_the_map_and_the_believed_past(whole):
    saved = open_map(whole.folder.path)
    assert map_digest(saved.snapshot) == whole.digest
    assert map_digest(replay(whole.folder.path)) == whole.digest
    wrong = [s for s in whole.snapshots if s.graph is not None and len(s.graph.loops) == 1][-1]
    assert len(saved.as_known_at(wrong.stamp_ns).objects) == 5


def test_a_run_stopped_while_believing_it_gives_the_same_map(whole, tmp_path):
    async def stop(mapper, snapshot):
        if len(snapshot.objects) == 5:
            mapper.stop()

    scene = source()
    map_scene(
        tmp_path, *NO_SHAPES, *CONFIG, source=scene, segmenter=InstanceSegmenter(scene.instances), on_snapshot=stop,
        rate=20.0,
    )  # fmt: skip

    assert resume_scene(tmp_path / "map", source()) == whole.digest
