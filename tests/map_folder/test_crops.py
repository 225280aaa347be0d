import json
import zlib
from dataclasses import replace
import cv2
import numpy as np
import pytest
from hickory_stream.base.json_text import dumps
from hickory_stream.config import RunConfig
from hickory_stream.errors import MapFolderError
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.depth_sensor import DepthSensor
from hickory_stream.map_folder.views import crop_files, read_crop, read_mask, write_crop
from hickory_stream.ports import Crop
from tests.engine.snapshot_fixtures import make_crop


def test_a_crop_round_trips_with_depth_to_the_millimetre(tmp_path):
    crop = replace(make_crop(), sensor=DepthSensor(noise_per_m=0.0019, noise_m=0.0012))
    write_crop(tmp_path, "000001-10-20-26-32", crop)
    back = read_crop(tmp_path, "000001-10-20-26-32")
    assert np.array_equal(back.rgb, crop.rgb)
    assert np.array_equal(back.mask, crop.mask)
    assert np.array_equal(back.world_from_camera, crop.world_from_camera)
    assert (back.camera, back.sensor) == (crop.camera, crop.sensor)
    assert np.array_equal(np.isnan(back.depth_m), np.isnan(crop.depth_m))
    assert np.nanmax(np.abs(back.depth_m - crop.depth_m)) <= 0.0005 + 1e-6


def row_crop(depth_m):
    """A view of one row."""
    camera = Camera(width=depth_m.size, height=1, fx=1.0, fy=1.0, cx=0.0, cy=0.0)
    rgb, mask = np.zeros((*depth_m.shape, 3), dtype=np.uint8), np.ones(depth_m.shape, dtype=bool)
    return Crop(rgb=rgb, depth_m=depth_m, mask=mask, camera=camera, world_from_camera=np.eye(4))


def test_depth_beyond_16_bits_is_none_and_beyond_webp_exact(tmp_path):
    depth = np.array([[0.0, -1.0, np.inf, 65.535, 65.6, 0.0004, np.nan, 1.0]], dtype=np.float32)
    write_crop(tmp_path, "v", row_crop(depth))
    expected = np.array([[np.nan, np.nan, np.nan, 65.535, np.nan, np.nan, np.nan, 1.0]], dtype=np.float32)
    assert np.array_equal(read_crop(tmp_path, "v").depth_m, expected, equal_nan=True)
    width = 1 << 14
    crop = row_crop(np.ones((1, width), dtype=np.float32))
    write_crop(tmp_path, "v", crop, lossy("webp"))
    assert crop_files(tmp_path, "v")[0].name == "v.color.png"
    assert np.array_equal(read_crop(tmp_path, "v").rgb, crop.rgb)


def lossy(colors):
    return RunConfig(view_colors=colors, view_quality=95)


def shaded_crop():
    """As cameras see: colours that change slowly."""
    ramp = np.linspace(40, 200, 16, dtype=np.uint8)
    return replace(make_crop(), rgb=np.stack([np.tile(ramp, (12, 1))] * 3, axis=2))


@pytest.mark.parametrize(("colors", "suffix"), [("jpeg", ".jpg"), ("webp", ".webp")])
def test_lossy_colours_keep_mask_and_depth_exact(tmp_path, colors, suffix):
    crop = shaded_crop()
    write_crop(tmp_path, "exact", crop)
    write_crop(tmp_path, "v", crop, lossy(colors))
    endings = [file.name.removeprefix("v.") for file in crop_files(tmp_path, "v")]
    assert endings == [f"color{suffix}", "depth.png", "mask.png", "json"]
    assert sorted(file.name for file in tmp_path.glob("v.*")) == sorted(f"v.{ending}" for ending in endings)
    exact, back = read_crop(tmp_path, "exact"), read_crop(tmp_path, "v")
    assert np.array_equal(back.mask, exact.mask)
    for name in ("exact", "v"):
        assert np.array_equal(read_mask(tmp_path, name), exact.mask)
    assert np.array_equal(back.depth_m, exact.depth_m, equal_nan=True)
    assert np.array_equal(back.world_from_camera, exact.world_from_camera)
    assert (back.camera, back.sensor) == (exact.camera, exact.sensor)
    assert 0 < np.abs(back.rgb.astype(int) - crop.rgb).max() <= 8
    red = replace(crop, rgb=np.full((12, 16, 3), (200, 60, 30), np.uint8))
    write_crop(tmp_path, "red", red, lossy(colors))
    assert np.abs(read_crop(tmp_path, "red").rgb.astype(int) - red.rgb).max() <= 6


@pytest.mark.parametrize("colors", ["png", "jpeg", "webp"])
@pytest.mark.parametrize("damage", ["missing", "cut", "empty", "changed"])
def test_a_damaged_file_of_a_view_is_an_error(tmp_path, capfd, colors, damage):
    if (colors, damage) == ("png", "changed"):
        pytest.skip("only lossy colours and their masks have a checksum")
    for part in range(3 if colors == "png" else 4):
        write_crop(tmp_path, "v", shaded_crop(), RunConfig(view_colors=colors))
        path = crop_files(tmp_path, "v")[part]
        data = bytearray(path.read_bytes())
        path.unlink()
        if damage == "changed":
            # In the middle, where a JPEG or a WebP has pixels, and the description its numbers.
            data[len(data) // 2] ^= 0x81
        if damage != "missing":
            path.write_bytes({"cut": data[: len(data) // 2], "empty": b"", "changed": data}[damage])
        with pytest.raises(MapFolderError, match="play the log again") as refused:
            read_crop(tmp_path, "v")
        assert "\n" not in str(refused.value)
        assert capfd.readouterr() == ("", ""), "no decoder told of it"
        path.unlink(missing_ok=True)
    with pytest.raises(MapFolderError, match="cannot write"):
        write_crop(tmp_path / "absent", "v", make_crop())


def put_color(folder, data):
    """Exchange the colours of the view, with their checksum."""
    color, *_, description = crop_files(folder, "v")
    color.write_bytes(data)
    told = json.loads(description.read_text(encoding="utf-8"))
    description.write_text(dumps(told | {"color_crc32": zlib.crc32(data)}), encoding="utf-8")


@pytest.mark.parametrize(("colors", "at"), [("jpeg", "SOF"), ("webp", "VP8")])
def test_a_claim_of_too_many_pixels_is_refused_before_decoding(tmp_path, monkeypatch, colors, at):
    write_crop(tmp_path, "v", make_crop(), lossy(colors))
    data = bytearray(crop_files(tmp_path, "v")[0].read_bytes())
    if at == "SOF":
        frame = data.index(b"\xff\xc0")
        data[frame + 5 : frame + 9] = b"\xff\xff\xff\xff"
    else:
        data[26:30] = b"\xff\x3f\xff\x3f"
    put_color(tmp_path, data)
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("it was decoded"))
    with pytest.raises(MapFolderError, match=r"pixels, which no view has; play the log again"):
        read_crop(tmp_path, "v")


@pytest.mark.parametrize("data", [
    b"\xff\xd8\xff\xc2\x00\x11\x08\x00\x0c\x00\x10\x03" + bytes(20),
    b"\xff\xd8\xff\xe0\x00\x00" + bytes(40),
    b"\xff\xd8\xff\xe0\xff\xff" + bytes(40),
    b"\x89PNG\r\n\x1a\n" + bytes(40),
], ids=["progressive", "a segment of no length", "a segment beyond the end", "PNG"])  # fmt: skip
def test_another_kind_of_image_in_the_place_of_a_jpeg_is_refused(tmp_path, data):
    write_crop(tmp_path, "v", make_crop(), lossy("jpeg"))
    put_color(tmp_path, data)
    with pytest.raises(MapFolderError, match="it is no baseline JPEG; play the log again"):
        read_crop(tmp_path, "v")
