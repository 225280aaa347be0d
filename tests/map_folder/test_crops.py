import zlib
from dataclasses import asdict, replace
import cv2
import numpy as np
import pytest
from hickory_stream.base.json_text import dumps
from hickory_stream.config import RunConfig
from hickory_stream.errors import MapFolderError
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.depth_sensor import DepthSensor
from hickory_stream.map_folder.array_files import packed, unpacked
from hickory_stream.map_folder.views import crop_files, read_crop, write_crop
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
    assert np.array_equal(read_crop(tmp_path, "v").rgb, crop.rgb)


def lossy(colors):
    return RunConfig(view_colors=colors, view_quality=95)


def shaded_crop():
    """As cameras see: colours that change slowly."""
    ramp = np.linspace(40, 200, 16, dtype=np.uint8)
    return replace(make_crop(), rgb=np.stack([np.tile(ramp, (12, 1))] * 3, axis=2))


def is_same(one, other, most=0):
    """Whether two crops have the same mask, depth and camera, and colours that differ by at most so much."""
    same = [np.array_equal(getattr(one, name), getattr(other, name)) for name in ("mask", "world_from_camera")]
    same += [np.array_equal(one.depth_m, other.depth_m, equal_nan=True), one.camera == other.camera]
    return all(same) and one.sensor == other.sensor and np.abs(one.rgb.astype(int) - other.rgb).max() <= most


@pytest.mark.parametrize("colors", ["jpeg", "webp"])
def test_lossy_colours_keep_mask_and_depth_exact(tmp_path, colors):
    crop = shaded_crop()
    write_crop(tmp_path, "exact", crop)
    write_crop(tmp_path, "v", crop, lossy(colors))
    exact, back = read_crop(tmp_path, "exact"), read_crop(tmp_path, "v")
    assert is_same(back, exact, most=8) and not is_same(back, exact)
    red = replace(crop, rgb=np.full((12, 16, 3), (200, 60, 30), np.uint8))
    write_crop(tmp_path, "red", red, lossy(colors))
    assert np.abs(read_crop(tmp_path, "red").rgb.astype(int) - red.rgb).max() <= 6


def write_as_before(folder, crop, suffix):
    """Write a view as maps of format 3 have it."""
    bgr, mask = crop.rgb[..., ::-1], crop.mask.astype(np.uint8) * np.uint8(255)
    depth_mm = np.rint(np.nan_to_num(crop.depth_m) * 1000).astype(np.uint16)
    told = {name: asdict(getattr(crop, name)) for name in ("camera", "sensor")}
    told["world_from_camera"] = crop.world_from_camera.tolist()
    files = {"depth.png": depth_mm, "color.png": np.dstack([bgr, mask])}
    if suffix != ".png":
        files = {"depth.png": depth_mm, "mask.png": mask, f"color{suffix}": np.ascontiguousarray(bgr)}
    for ending, image in files.items():
        cv2.imwrite(str(folder / f"v.{ending}"), image, [cv2.IMWRITE_WEBP_QUALITY, 95])
    told["color_crc32"] = zlib.crc32((folder / f"v.color{suffix}").read_bytes())
    (folder / "v.json").write_text(dumps(told), encoding="utf-8")
    return ["json", *files]


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".webp"])
def test_views_of_format_3_are_read(tmp_path, suffix):
    crop = shaded_crop()
    endings = write_as_before(tmp_path, crop, suffix)
    write_crop(tmp_path, "exact", crop)
    assert is_same(read_crop(tmp_path, "v"), read_crop(tmp_path, "exact"), most=0 if suffix == ".png" else 8)
    assert set(crop_files(tmp_path, "v")) == {tmp_path / f"v.{ending}" for ending in endings}
    for ending in endings:
        (tmp_path / f"v.{ending}").write_bytes((tmp_path / f"v.{ending}").read_bytes()[:-9])
        with pytest.raises(MapFolderError, match="play the log again"):
            read_crop(tmp_path, "v")
        write_as_before(tmp_path, crop, suffix)


@pytest.mark.parametrize("colors", ["png", "jpeg", "webp"])
@pytest.mark.parametrize("damage", ["missing", "cut", "empty", "changed"])
def test_a_damaged_view_is_an_error(tmp_path, capfd, colors, damage):
    write_crop(tmp_path, "v", shaded_crop(), RunConfig(view_colors=colors))
    (path,) = crop_files(tmp_path, "v")
    data = bytearray(path.read_bytes())
    path.unlink()
    if damage == "changed":
        data[len(data) // 2] ^= 0x81
    if damage != "missing":
        path.write_bytes({"cut": data[: len(data) // 2], "empty": b"", "changed": data}[damage])
    with pytest.raises(MapFolderError, match="play the log again") as refused:
        read_crop(tmp_path, "v")
    assert "\n" not in str(refused.value)
    assert capfd.readouterr() == ("", ""), "no decoder told of it"
    with pytest.raises(MapFolderError, match="cannot write"):
        write_crop(tmp_path / "absent", "v", make_crop())


def change_view(folder, **changed):
    """Exchange parts of the view; its checksum is made right."""
    (path,) = crop_files(folder, "v")
    path.write_bytes(packed({**unpacked(path.read_bytes()), **changed}))


@pytest.mark.parametrize(("colors", "at"), [("jpeg", "SOF"), ("webp", "VP8")])
def test_a_claim_of_too_many_pixels_is_refused_before_decoding(tmp_path, monkeypatch, colors, at):
    write_crop(tmp_path, "v", make_crop(), lossy(colors))
    suffix = {"jpeg": ".jpg", "webp": ".webp"}[colors]
    data = bytearray(unpacked((tmp_path / "v.view").read_bytes())[suffix])
    if at == "SOF":
        frame = data.index(b"\xff\xc0")
        data[frame + 5 : frame + 9] = b"\xff\xff\xff\xff"
    else:
        data[26:30] = b"\xff\x3f\xff\x3f"
    change_view(tmp_path, **{suffix: bytes(data)})
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("it was decoded"))
    with pytest.raises(MapFolderError, match=r"pixels, which no view has; play the log again"):
        read_crop(tmp_path, "v")


@pytest.mark.parametrize("changed", [
    {"camera": None}, {"mask": 7}, {"depth_mm": np.ones((3, 3), np.uint16)}, {"rgb": np.zeros((7, 3), np.uint8)},
    {"world_from_camera": np.ones(3)}, {"sensor": {"noise": 1.0}}, {".jpg": "no bytes"},
])  # fmt: skip
def test_a_view_of_other_parts_is_refused(tmp_path, changed):
    write_crop(tmp_path, "v", make_crop())
    change_view(tmp_path, **changed)
    with pytest.raises(MapFolderError, match="play the log again"):
        read_crop(tmp_path, "v")


@pytest.mark.parametrize("data", [
    b"\xff\xd8\xff\xc2\x00\x11\x08\x00\x0c\x00\x10\x03" + bytes(20),
    b"\xff\xd8\xff\xe0\x00\x00" + bytes(40),
    b"\xff\xd8\xff\xe0\xff\xff" + bytes(40),
    b"\x89PNG\r\n\x1a\n" + bytes(40),
], ids=["progressive", "a segment of no length", "a segment beyond the end", "PNG"])  # fmt: skip
def test_another_kind_of_image_in_the_place_of_a_jpeg_is_refused(tmp_path, data):
    write_crop(tmp_path, "v", make_crop(), lossy("jpeg"))
    change_view(tmp_path, **{".jpg": data})
    with pytest.raises(MapFolderError, match="it is no baseline JPEG; play the log again"):
        read_crop(tmp_path, "v")
