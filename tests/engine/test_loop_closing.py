from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.box_scene import SCENE_CAMERA, SceneSource
from hickory_stream.geometry.rigid import compose, from_rotation_translation, yaw_rotation
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.map_folder.history.replay import replay
from hickory_stream.map_folder.saved_map import open_map
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
