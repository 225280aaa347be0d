import asyncio
import json
import time
import numpy as np
from hickory_stream.cli import main
from hickory_stream.geometry.voxels import keys_of_points
from hickory_stream.map_folder.history.live_map import is_live, live_map
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.navigation.free_space import obstacles_of
from tests.engine.run_fixtures import NO_SHAPES, map_scene


def plan(folder, snapshot):
    """Ask for a way to where a side of an object was seen, as JSON, once the journal, which is behind, has that."""
    while (found := live_map(folder)) is None or found[0].revision < snapshot.revision:
        time.sleep(0.02)
    points = snapshot.objects[0].points_world
    # At the height of the robot's body.
    x, y = points[np.abs(points[:, 2] - 0.12).argmin(), :2]
    goal = f"--goal={x:.3f},{y:.3f}"
    return main(["plan", str(folder), "--start=0,-1", goal, "--robot", "point", "--unknown", "free", "--json"])


def test_a_plan_in_a_growing_map_avoids_what_was_hardly_seen(tmp_path, capsys):
    answers = []
    sure = []

    async def asked(mapper, snapshot):
        if not answers and len(snapshot.objects):
            sure.append(len(obstacles_of(snapshot)))
            answers.append(await asyncio.to_thread(plan, mapper.folder.path, snapshot))

    map_scene(tmp_path, *(*NO_SHAPES, "journal.flush_s=0"), mode="live", rate=0.5, on_snapshot=asked)
    printed = capsys.readouterr()
    assert sure == [0]
    assert answers == [3]
    assert "is being written" in printed.err
    found = json.loads(printed.out)
    assert found["reason"] == "goal-in-collision"
    assert found["objects_by_box"] == []
    assert {blocker["object"] for blocker in found["blockers"]} <= {*found["objects_observed_only"], -1}
    # The finished map is one like any other.
    assert not is_live(open_map(tmp_path / "map"))


def test_seen_surface_is_that_of_the_keyframes_until_then(tmp_path):
    run = map_scene(tmp_path, *NO_SHAPES, mode="live", rate=3.0)
    first = run.snapshots[0]
    snapshot, seen = live_map(run.folder.path, first.stamp_ns)
    assert snapshot.revision == first.revision
    (submap,) = snapshot.submaps
    points = np.concatenate([tracked.points_world for tracked in snapshot.objects])
    # Faces of the scene lie on the border of two cells: a point of layer 1, which is rounded, may be in either.
    either = np.concatenate([points + np.float32(away_m) for away_m in (-1e-3, 1e-3)])
    assert np.isin(seen.keys(), keys_of_points(either, submap.observed_space.voxel_m)).mean() > 0.9
    assert live_map(run.folder.path, first.stamp_ns - 1) is None
