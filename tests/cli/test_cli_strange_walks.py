import json
import cv2
import numpy as np
from scipy.spatial.transform import Rotation
from hickory_stream.box_scene import SCENE_BOXES, cast_scene, scene_pose
from hickory_stream.geometry.rigid import compose, from_rotation_translation, invert
from hickory_stream.map_folder.saved_map import open_map
from tests.cli.test_cli import look
from tests.engine.registration_sources import CAMERA, ROOM

LAYER_ONE = ("--viewer", "none", "--set", "mapper.mapping.requests.max_failures=0")


def log_of(folder, seen_from, told, boxes, *, camera=CAMERA, most_m=np.inf, num_depth=None):
    """Write a folder in the layout of TUM: frames seen from poses, of which the odometry tells others."""
    lines = {"rgb": [], "depth": [], "groundtruth": []}
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True)
    np.savetxt(folder / "camera-intrinsics.txt", camera.K)
    for i, (pose, claimed) in enumerate(zip(seen_from, told, strict=True)):
        stem = f"{1000 + 0.3 * i:.6f}"
        rgb, depth_m, _ = cast_scene(boxes, camera, pose)
        units = np.nan_to_num(np.where(depth_m < most_m, depth_m, 0.0) * 5000.0).round().astype(np.uint16)
        for name, image in (("rgb", rgb[..., ::-1]), ("depth", units)):
            if name == "rgb" or num_depth is None or i < num_depth:
                cv2.imwrite(str(folder / name / f"{stem}.png"), image)
                lines[name].append(f"{stem} {name}/{stem}.png")
        numbers = (*claimed[:3, 3], *Rotation.from_matrix(claimed[:3, :3]).as_quat())
        lines["groundtruth"].append(f"{stem} {' '.join(f'{number:.9f}' for number in numbers)}")
    for name, each in lines.items():
        (folder / f"{name}.txt").write_text("\n".join(each) + "\n")
    return folder


def play(log, out, *options):
    return look("play", log, "--out", out, *LAYER_ONE, *options)


def test_a_carried_robot_is_reported_and_starts_a_new_submap(tmp_path, caplog):
    carried_at = 8
    seen = [scene_pose(i + 18 if i >= carried_at else i) for i in range(20)]
    away = compose(scene_pose(carried_at), invert(scene_pose(carried_at + 18)))
    told = [compose(away, pose) if i >= carried_at else pose for i, pose in enumerate(seen)]
    ended = play(log_of(tmp_path / "log", seen, told, ROOM), tmp_path / "map")
    assert ended.status == 0, ended.stderr
    assert f"frame {carried_at} and following ones are kept out of the map" in caplog.text
    assert "the robot is not where its odometry says, and a new submap begins" in caplog.text
    assert "once the robot was suddenly elsewhere than its odometry says" in ended.stdout
    assert len(open_map(tmp_path / "map").snapshot.submaps) == 2


def test_a_lift_is_another_storey_and_stopped_depth_is_counted(tmp_path):
    circle = [scene_pose(i) for i in range(7)]
    up = [from_rotation_translation(np.eye(3), np.array([0.0, 0.0, z])) for z in (0.5, 1.0, 1.5, 2.0, 2.5)]
    lifted = from_rotation_translation(np.eye(3), np.array([0.0, 0.0, 3.0]))
    seen = [*circle, *([circle[-1]] * len(up)), *circle]
    told = [*circle, *(step @ circle[-1] for step in up), *(lifted @ pose for pose in circle)]
    log = log_of(tmp_path / "log", seen, told, SCENE_BOXES, num_depth=len(seen) - 2)
    # Two seconds on each storey.
    ended = play(log, tmp_path / "map", "--set", "mapper.mapping.lifecycle.confirm_s=0.5")
    assert ended.status == 0, ended.stderr
    assert "2 color without depth" in ended.stdout
    inspected = json.loads(look("inspect", tmp_path / "map", "--json").stdout)
    assert any("levels, at z = 0.0" in note and ", 3.0" in note for note in inspected["notes"]), inspected["notes"]
    assert "2 color without depth" in look("doctor", log).stdout
