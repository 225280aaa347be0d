"""Labelled single-view clouds: organised PCD files with an instance label per point, as frames with their truth."""
# The files hold no pose. A frame's world is z up, as a mapper expects it: up is the normal of the plane that most of
# the cloud lies on or above, found without the labels.

from dataclasses import dataclass
from pathlib import Path

import numba
import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import RecordingError
from hickory_stream.geometry.camera import Camera
from hickory_stream.perception.choose import make_segmenter
from hickory_stream.perception.perceive import PerceptionConfig
from hickory_stream.records import Frame
from tools.evaluation.masks.scores import UNKNOWN, MaskScore, min_pixels, score_masks

FOCAL_PX = 525.0
"""Of the first Kinect at 640 pixels; other widths in proportion."""

_TYPES = {("F", 4): "<f4", ("F", 8): "<f8", ("U", 1): "u1", ("U", 2): "<u2", ("U", 4): "<u4", ("I", 4): "<i4"}
_FIELDS = ("label", "x", "y", "z", "rgba")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LabelledFrame:
    """A frame and its labels: `truth` (H, W) int32, 0 = unknown, 1 = the support of the things."""

    name: str
    frame: Frame
    truth: NDArray[np.int32]

    @property
    def min_pixels(self) -> int:
        return min_pixels(self.truth)


def load_cloud(path: Path) -> LabelledFrame:
    # Labels of one ten (30, 31) are pieces of one thing that something else divides in the image.
    # Raises RecordingError: the file is no organised PCD with the fields label, x, y, z and rgba.
    try:
        fields, width, height = _read_pcd(path.read_bytes())
    except (ValueError, KeyError, IndexError) as error:
        raise RecordingError(
            f"{path} is no organised PCD file with the fields {' '.join(_FIELDS)}, ascii excepted: {error}"
        ) from error
    z = fields["z"].astype(np.float32).reshape(height, width)
    rgba = fields["rgba"].view(np.uint32).reshape(height, width)
    focal = FOCAL_PX * width / 640
    camera = Camera(width=width, height=height, fx=focal, fy=focal, cx=(width - 1) / 2, cy=(height - 1) / 2)
    points = np.stack([fields[axis] for axis in "xyz"], axis=1).astype(np.float64)
    label = fields["label"].astype(np.int64).reshape(height, width)
    return LabelledFrame(
        name=path.stem,
        frame=Frame(
            index=0,
            stamp_ns=0,
            rgb=np.stack([rgba >> 16 & 255, rgba >> 8 & 255, rgba & 255], axis=-1).astype(np.uint8),
            depth_m=np.where(z > 0, z, np.nan).astype(np.float32),
            camera=camera,
            world_from_camera=_upright(points[np.isfinite(points).all(axis=1)]),
        ),
        truth=np.where(label >= 10, label // 10 * 10, label).astype(np.int32),
    )


def score_cloud(cloud: LabelledFrame, config: PerceptionConfig | None = None) -> MaskScore:
    masks = make_segmenter(config or PerceptionConfig()).segment(cloud.frame).instances
    truth = np.where(cloud.truth == 0, UNKNOWN, np.where(cloud.truth == 1, 0, cloud.truth))
    return score_masks(masks, truth, cloud.min_pixels)


def clouds_in(folder: Path) -> list[Path]:
    # Raises RecordingError: there are none.
    paths = sorted(folder.glob("*.pcd"))
    if not paths:
        raise RecordingError(f"{folder} holds no *.pcd files, expected labelled clouds")
    return paths


def _read_pcd(data: bytes) -> tuple[dict[str, NDArray[np.generic]], int, int]:
    header: dict[str, list[str]] = {}
    at = 0
    while "DATA" not in header:
        end = data.index(b"\n", at)
        words = data[at:end].decode("ascii").split()
        at = end + 1
        if words and not words[0].startswith("#"):
            header[words[0]] = words[1:]
    width, height = int(header["WIDTH"][0]), int(header["HEIGHT"][0])
    count = width * height
    names = header["FIELDS"]
    types = [np.dtype(_TYPES[kind, int(size)]) for kind, size in zip(header["TYPE"], header["SIZE"], strict=True)]
    missing = set(_FIELDS) - set(names)
    if missing or height < 2:
        raise ValueError(f"fields {names}, {width}x{height}")
    kind = header["DATA"][0]
    if kind == "binary":
        rows = np.frombuffer(data, dtype=list(zip(names, types, strict=True)), count=count, offset=at)
        return {name: np.ascontiguousarray(rows[name]) for name in _FIELDS}, width, height
    if kind != "binary_compressed":
        raise ValueError(f"DATA {kind}")
    packed, size = np.frombuffer(data, dtype="<u4", count=2, offset=at)
    if int(size) != count * sum(t.itemsize for t in types):
        raise ValueError(f"{size} bytes for {count} points")
    out = np.zeros(int(size), dtype=np.uint8)
    if _decompress(np.frombuffer(data, dtype=np.uint8, count=int(packed), offset=at + 8), out) != size:
        raise ValueError("its compressed data is damaged")
    fields, start = {}, 0
    for name, dtype in zip(names, types, strict=True):
        fields[name] = out[start : start + count * dtype.itemsize].view(dtype)
        start += count * dtype.itemsize
    return fields, width, height


@numba.njit(cache=True)
def _decompress(packed, out):  # type: ignore[no-untyped-def] # pragma: no cover
    i, o = 0, 0
    while i < len(packed):
        control = np.int64(packed[i])
        i += 1
        if control < 32:
            length = control + 1
            if i + length > len(packed) or o + length > len(out):
                return -1
            out[o : o + length] = packed[i : i + length]
            i, o = i + length, o + length
            continue
        length = control >> 5
        if length == 7:
            if i >= len(packed):
                return -1
            length += np.int64(packed[i])
            i += 1
        if i >= len(packed):
            return -1
        back = o - ((control & 31) << 8) - np.int64(packed[i]) - 1
        i += 1
        if back < 0 or o + length + 2 > len(out):
            return -1
        for k in range(length + 2):
            out[o + k] = out[back + k]
        o += length + 2
    return o


def _upright(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return world_from_camera with z along the normal of the plane with the most points, and nothing turned about it.

    Of 500 planes through three points each, the one within 1 cm of which most points lie, refined by least squares;
    it must lie below the camera: a normal that has something of the image's upward direction.
    """
    rng = np.random.default_rng(0)
    sample = points[rng.integers(len(points), size=4000)]
    best, most = None, -1
    for _ in range(500):
        a, b, c = sample[rng.integers(len(sample), size=3)]
        normal = np.cross(b - a, c - a)
        length = float(np.linalg.norm(normal))
        if length < 1e-6:
            continue
        normal = normal / length * -np.sign(normal[1])
        if normal[1] > -0.4:  # steeper than a table can look from any sensible view
            continue
        votes = int((np.abs((sample - a) @ normal) < 0.01).sum())
        if votes > most:
            best, most = (a, normal), votes
    if best is None:
        raise ValueError("no plane on which things could stand")
    at, normal = best
    for _ in range(3):
        near = points[np.abs((points - at) @ normal) < 0.01]
        at = near.mean(axis=0)
        _, _, axes = np.linalg.svd(near[:: max(1, len(near) // 5000)] - at, full_matrices=False)
        normal = axes[2] * -np.sign(axes[2][1])
    right = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    right /= np.linalg.norm(right)
    world_from_camera = np.eye(4)
    world_from_camera[:3, :3] = np.stack([right, np.cross(normal, right), normal])
    return world_from_camera
