"""Labelled single-view clouds: organised PCD files with an instance label per point, as frames with their truth."""
# The files hold no pose. A frame's world is z up, as a mapper expects it: up is the normal of the plane that most of
# the cloud lies on or above, found without the labels.

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import RecordingError
from hickory_stream.geometry.camera import Camera
from hickory_stream.perception.choose import make_segmenter
from hickory_stream.perception.perceive import PerceptionConfig
from hickory_stream.pictures.open3d_import import import_open3d
from hickory_stream.records import Frame
from tools.evaluation.masks.scores import UNKNOWN, MaskScore, min_pixels, score_masks

FOCAL_PX = 525.0
"""Of the first Kinect at 640 pixels; other widths in proportion."""

_FIELDS = ("label", "positions", "colors")


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
        fields, width, height = _organised(path)
    except (ValueError, IndexError, RuntimeError) as error:
        raise RecordingError(
            f"{path} is no organised PCD file with the fields label x y z rgba, ascii excepted: {error}"
        ) from error
    points, label = fields["positions"].astype(np.float64), fields["label"].astype(np.int64).reshape(height, width)
    z = fields["positions"][:, 2].reshape(height, width)
    focal = FOCAL_PX * width / 640
    camera = Camera(width=width, height=height, fx=focal, fy=focal, cx=(width - 1) / 2, cy=(height - 1) / 2)
    return LabelledFrame(
        name=path.stem,
        frame=Frame(
            index=0,
            stamp_ns=0,
            rgb=fields["colors"].reshape(height, width, 3),
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


def _organised(path: Path) -> tuple[dict[str, NDArray[Any]], int, int]:
    # Fields (H * W, ...) by name, with the width and the height, which the reader does not keep.
    open3d = import_open3d()
    head = path.read_bytes()[:1024].decode("ascii", errors="replace")
    head = head[: head.index("\nDATA binary")]
    width, height = (int(head.split(f"\n{name} ")[1].split()[0]) for name in ("WIDTH", "HEIGHT"))
    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        cloud = open3d.t.io.read_point_cloud(str(path), remove_nan_points=False, remove_infinite_points=False)
    fields = {name: cloud.point[name].numpy() for name in _FIELDS if name in cloud.point}
    if len(fields) < len(_FIELDS) or height < 2 or len(fields["label"]) != width * height:
        raise ValueError(f"fields {', '.join(fields)}, {width}x{height}")
    return fields, width, height


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
