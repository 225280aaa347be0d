from dataclasses import replace
from itertools import combinations
from pathlib import Path
import numpy as np
import pytest
from hickory_stream.errors import ConfigError
from hickory_stream.evaluation.truth import instances_of, load_truth, mesh_of, structure_meshes
from hickory_stream.fleet.robots import read_fleet
from hickory_stream.geometry.camera import backproject
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.worlds.recording import make_recording
from players import open_source
from tools.worlds.fleet import make_fleet
from tools.worlds.recording_config import RecordingConfig, drawn_frame

SHORT = RecordingConfig(seed=3, seconds=1.5, rate_hz=2.0, width=96, height=64)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("fleet")
    make_fleet(SHORT, made, "set", 3, caster=None)
    return made


@pytest.fixture(scope="module")
def truths(folder):
    return [load_truth(folder / f"set-{i}.truth") for i in (1, 2, 3)]


def test_the_fleet_has_a_log_for_each_robot_with_clocks_apart(folder, truths):
    robots, _ = read_fleet(folder / "set.toml")
    assert [robot.name for robot in robots] == ["robot-1", "robot-2", "robot-3"]
    assert all(Path(uri).is_file() for robot in robots for uri in robot.uris)
    spans = [(truth.frames[0].stamp_ns, truth.frames[-1].stamp_ns) for truth in truths]
    for (start, end), (other_start, other_end) in combinations(spans, 2):
        assert end < other_start or other_end < start


def test_every_log_has_its_own_frame_one_turn_and_shift_apart(folder, truths):
    for i, truth in enumerate(truths, start=1):
        source = open_source(folder / f"set-{i}.mcap")
        poses = [frame.world_from_camera for frame in source.frames()]
        source.close()
        assert len(poses) == len(truth.frames) == 3
        for pose, true in zip(poses, truth.frames, strict=True):
            assert np.allclose(pose, true.world_from_camera, atol=1e-6)
    for one, other in combinations(truths, 2):
        found = np.array(
            [a.world_from_object @ invert(b.world_from_object) for a, b in zip(one.objects, other.objects, strict=True)]
        )
        assert np.allclose(found, found[0], atol=1e-9)
        assert np.allclose(found[0][2, :3], [0, 0, 1])
        assert np.linalg.norm(found[0][:3, 3]) > 0.1


def test_what_a_frame_shows_lies_on_the_true_surfaces(folder):
    truth = load_truth(folder / "set-2.truth")
    source = open_source(folder / "set-2.mcap")
    frame = next(iter(source.frames())).decode()
    source.close()
    ids = instances_of(truth, truth.frames[0])
    points = apply(frame.world_from_camera, backproject(frame.depth_m, frame.camera).reshape(-1, 3))
    known = {item.id: item for item in truth.objects}
    for item_id in np.unique(ids[ids > 0]):
        mine = points[(ids.reshape(-1) == item_id) & np.isfinite(points).all(axis=1)]
        surface = apply(known[item_id].world_from_object, mesh_of(truth, known[item_id]).vertices)
        low, high = surface.min(axis=0), surface.max(axis=0)
        if len(mine) > 20:
            assert ((np.median(mine, axis=0) > low - 0.1) & (np.median(mine, axis=0) < high + 0.1)).all()
    floor = min(mesh.vertices[:, 2].max() for mesh in structure_meshes(truth))
    assert abs(np.nanpercentile(points[:, 2], 1) - floor) < 0.1


def test_the_truth_of_all_has_what_any_robot_has_seen(folder, truths):
    whole = load_truth(folder / "set.truth")
    poses, expected = ([item.world_from_object.tolist() for item in one.objects] for one in (whole, truths[0]))
    assert poses == expected
    seen = np.array([[item.seen_fraction for item in truth.objects] for truth in truths])
    union = np.array([item.seen_fraction for item in whole.objects])
    assert (union >= seen.max(axis=0)).all()
    assert (union <= seen.sum(axis=0) + 1e-3).all()
    assert (union > seen.max(axis=0) + 0.01).any()
    assert all(len(mesh_of(whole, item).vertices) for item in whole.objects)


def test_a_robots_truth_is_the_same_walk_in_another_frame(tmp_path, truths):
    alone = make_recording(SHORT, tmp_path, "alone", caster=None)
    robot_from_world = drawn_frame(replace(SHORT, robots=3))
    for item, same in zip(alone.objects, truths[0].objects, strict=True):
        assert np.allclose(robot_from_world @ item.world_from_object, same.world_from_object)
        assert item.seen_fraction == same.seen_fraction
    for frame, other in zip(alone.frames, truths[0].frames, strict=True):
        assert np.allclose(robot_from_world @ frame.world_from_camera, other.world_from_camera)


@pytest.mark.parametrize(("config", "count", "said"), [
    (SHORT, 1, "found 1 robots, expected 2 to 16"),
    (SHORT, 17, "found 17 robots"),
    (replace(SHORT, scene="clutter"), 2, "robot 0 of 2 in the scene clutter"),
])  # fmt: skip
def test_a_fleet_that_cannot_be_made_is_refused(tmp_path, config, count, said):
    with pytest.raises(ConfigError, match=said):
        make_fleet(config, tmp_path, "no", count, caster=None)
