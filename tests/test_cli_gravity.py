"""What `play`, `inspect` and `doctor` say of a log whose gravity is off: a folder in the layout of TUM."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.testing import SCENE_BOXES, SCENE_CAMERA, cast_scene, scene_pose
from tests.test_cli import run

if TYPE_CHECKING:
    from pathlib import Path

_FRAMES = 14


def log_of(folder: Path, tilt_deg: float) -> Path:
    """Write a folder in the layout of TUM whose poses are tilted by so much about x."""
    angle = np.radians(tilt_deg)
    rotation = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    tilt = from_rotation_translation(rotation, np.zeros(3))
    images: dict[str, list[str]] = {"rgb": [], "depth": []}
    poses = []
    for name in images:
        (folder / name).mkdir(parents=True)
    np.savetxt(folder / "camera-intrinsics.txt", SCENE_CAMERA.K)
    for i in range(_FRAMES):
        stem, pose = f"{1000 + 0.5 * i:.6f}", scene_pose(i)
        rgb, depth_m, _ = cast_scene(SCENE_BOXES, SCENE_CAMERA, pose)
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


def test_a_log_whose_gravity_is_off_is_mapped_and_play_inspect_and_doctor_say_so(
    coarse_config: Path, tmp_path: Path
) -> None:
    folder, out = log_of(tmp_path / "log", 2.0), tmp_path / "map"
    ended = run("play", folder, "--out", out, "--config", coarse_config, "--viewer", "none")
    assert ended.status == 0, ended.stderr
    assert "the floor is tilted by 2.0 degrees against gravity" in ended.stderr
    assert ended.stdout.startswith(f"{out}: 3 objects")
    assert "the floor is tilted by 2.0 degrees" in run("inspect", out).stdout
    assert json.loads(run("inspect", out, "--json").stdout)["notes"][0].startswith("the floor is tilted by 2.0 degrees")
    examined = json.loads(run("doctor", folder, "--json").stdout)
    assert any("the floor is tilted by 2.0 degrees" in note for note in examined["notes"])


def test_a_log_that_stands_on_its_head_is_mapped_and_told_to_have_no_floor(coarse_config: Path, tmp_path: Path) -> None:
    folder, out = log_of(tmp_path / "log", 180.0), tmp_path / "map"
    ended = run("play", folder, "--out", out, "--config", coarse_config, "--viewer", "none", "--json")
    assert ended.status == 0, ended.stderr
    (note,) = json.loads(ended.stdout.splitlines()[-1])["notes"]
    assert "no floor was seen" in note
    assert "see whether the poses have z upwards" in run("doctor", folder).stdout
