from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from hickory_stream.engine.crops import crop_files, read_crop, write_crop
from hickory_stream.errors import MapFolderError
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.depth_sensor import DepthSensor
from hickory_stream.json_text import dumps
from hickory_stream.ports import Crop
from tests.engine.snapshot_fixtures import make_crop

if TYPE_CHECKING:
    from pathlib import Path


def test_a_crop_comes_back_as_it_was_with_depth_to_the_millimetre(tmp_path: Path) -> None:
    crop = replace(make_crop(), sensor=DepthSensor(noise_per_m=0.0019, noise_m=0.0012))
    write_crop(tmp_path, "000001-10-20-26-32", crop)
    back = read_crop(tmp_path, "000001-10-20-26-32")
    assert np.array_equal(back.rgb, crop.rgb)
    assert np.array_equal(back.mask, crop.mask)
    assert np.array_equal(back.world_from_camera, crop.world_from_camera)
    assert (back.camera, back.sensor) == (crop.camera, crop.sensor)
    assert np.array_equal(np.isnan(back.depth_m), np.isnan(crop.depth_m))
    assert np.nanmax(np.abs(back.depth_m - crop.depth_m)) <= 0.0005 + 1e-6


def test_a_view_from_before_there_were_sensors_has_that_of_an_unknown_camera(tmp_path: Path) -> None:
    write_crop(tmp_path, "v", make_crop())
    description = crop_files(tmp_path, "v")[2]
    written = json.loads(description.read_text(encoding="utf-8"))
    del written["sensor"]
    description.write_text(dumps(written), encoding="utf-8")
    assert read_crop(tmp_path, "v").sensor == DepthSensor()


def test_depth_that_has_no_place_in_16_bits_becomes_no_return(tmp_path: Path) -> None:
    depth = np.array([[0.0, -1.0, np.inf, 65.535, 65.6, 0.0004, np.nan, 1.0]], dtype=np.float32)
    crop = Crop(
        rgb=np.zeros((1, 8, 3), dtype=np.uint8),
        depth_m=depth,
        mask=np.ones((1, 8), dtype=bool),
        camera=Camera(width=8, height=1, fx=1.0, fy=1.0, cx=0.0, cy=0.0),
        world_from_camera=np.eye(4),
    )
    write_crop(tmp_path, "v", crop)
    expected = np.array([[np.nan, np.nan, np.nan, 65.535, np.nan, np.nan, np.nan, 1.0]], dtype=np.float32)
    assert np.array_equal(read_crop(tmp_path, "v").depth_m, expected, equal_nan=True)


@pytest.mark.parametrize("part", [0, 1, 2])
@pytest.mark.parametrize("damage", ["missing", "cut", "empty"])
def test_a_missing_or_cut_file_of_a_view_is_an_error(tmp_path: Path, part: int, damage: str) -> None:
    write_crop(tmp_path, "v", make_crop())
    path = crop_files(tmp_path, "v")[part]
    data = path.read_bytes()
    path.unlink()
    if damage != "missing":
        path.write_bytes(data[: len(data) // 2] if damage == "cut" else b"")
    with pytest.raises(MapFolderError, match="play the log again"):
        read_crop(tmp_path, "v")


def test_a_view_cannot_be_written_where_there_is_no_folder(tmp_path: Path) -> None:
    with pytest.raises(MapFolderError, match="cannot write"):
        write_crop(tmp_path / "absent", "v", make_crop())
