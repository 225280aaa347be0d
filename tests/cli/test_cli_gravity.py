"""What `play`, `inspect` and `doctor` say of a log whose gravity is off: a folder in the layout of TUM."""

import json
import re
import cv2
import numpy as np
from scipy.spatial.transform import Rotation
from hickory_stream.box_scene import SCENE_BOXES, SCENE_CAMERA, cast_scene
from hickory_stream.geometry.rigid import from_rotation_translation
from tests.cli.test_cli import look
from tests.mapping.test_bad_gravity import AROUND_THE_TABLE, CIRCLE, LEG, ON_TABLE, OVER_THE_TABLE, TABLE


def log_of(folder, tilt_deg, boxes=SCENE_BOXES, poses_of=CIRCLE):
    """Write a folder in the layout of TUM whose poses are tilted by so much about x."""
    angle = np.radians(tilt_deg)
    rotation = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    tilt = from_rotation_translation(rotation, np.zeros(3))
    images = {"rgb": [], "depth": []}
    poses = []
    for name in images:
        (folder / name).mkdir(parents=True)
    np.savetxt(folder / "camera-intrinsics.txt", SCENE_CAMERA.K)
    for i, pose in enumerate(poses_of):
        stem = f"{1000 + 0.5 * i:.6f}"
        rgb, depth_m, _ = cast_scene(boxes, SCENE_CAMERA, pose)
        units = np.nan_to_num(np.where(depth_m < 5.0, depth_m, 0.0) * 5000.0).round().astype(np.uint16)
        for name, image in (("rgb", rgb[..., ::-1]), ("depth", units)):
            cv2.imwrite(str(folder / name / f"{stem}.png"), image)
            images[name].append(f"{stem} {name}/{stem}.png")
        world_from_camera = tilt @ pose
        x, y, z, w = Rotation.from_matrix(world_from_camera[:3, :3]).as_quat()
        numbers = (*world_from_camera[:3, 3], x, y, z, w)
        poses.append(f"{stem} {' '.join(f'{number:.9f}' for number in numbers)}")
    for name, lines in (*images.items(), ("groundtruth", poses)):
        (folder / f"{name}.txt").write_text("\n".join(lines) + "\n")
    return folder


def test_gravity_off_is_mapped_and_three_commands_say_so(coarse_config, tmp_path):
    folder, out = log_of(tmp_path / "log", 2.0), tmp_path / "map"
    ended = look("play", folder, "--out", out, "--config", coarse_config, "--viewer", "none")
    assert ended.status == 0, ended.stderr
    assert "the floor is tilted by 2.0 degrees against gravity" in ended.stderr
    assert ended.stdout.startswith(f"{out}: 3 objects")
    assert json.loads(look("inspect", out, "--json").stdout)["notes"][0].startswith(
        "the floor is tilted by 2.0 degrees"
    )
    examined = json.loads(look("doctor", folder, "--json").stdout)
    assert any("the floor is tilted by 2.0 degrees" in note for note in examined["notes"])


def test_explain_says_that_what_was_the_floor_is_a_table(coarse_config, tmp_path):
    boxes, poses = (TABLE, LEG, *ON_TABLE), [*OVER_THE_TABLE[::3], *AROUND_THE_TABLE[:2]]
    folder, out = log_of(tmp_path / "log", 0.0, boxes, poses), tmp_path / "map"
    ended = look("play", folder, "--out", out, "--config", coarse_config, "--viewer", "none")
    assert ended.status == 0, ended.stderr
    told = look("explain", out, "--point=0.6,0.6,0.72").stdout
    assert re.search(r"frame \d+: a floor is seen at -?0\.0. m: what was taken for it, at 0\.72 m, is a table", told)


def test_doctor_says_of_an_upside_down_log_that_no_floor_shows(tmp_path):
    told = look("doctor", log_of(tmp_path / "log", 180.0)).stdout
    assert "shows a floor below the camera" in told
    assert "see whether the poses have z upwards" in told
