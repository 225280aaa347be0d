"""Three boxes on a floor, and a camera around them, as a source without file or network.

Colour, depth, instances and poses are cast analytically, hence exact. The engine warms up its kernels on it.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial, reduce

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.camera import Camera, backproject
from hickory_stream.geometry.rigid import apply
from hickory_stream.ports import Crop, ShapeInputs
from hickory_stream.records import Frame, RawFrame, SourceInfo

SCENE_CAMERA = Camera(width=240, height=180, fx=210.0, fy=210.0, cx=119.5, cy=89.5)
START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 300_000_000
_EYE_HEIGHT_M, _EYE_DISTANCE_M, _STEP_RAD = 1.1, 2.0, 0.12


@dataclass(frozen=True, kw_only=True, slots=True)
class SceneBox:
    """A box on the floor: its lowest and highest corner in the world (metres), and its colour."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    rgb: tuple[int, int, int]


SCENE_BOXES = (
    SceneBox(low=(-0.45, -0.35, 0.0), high=(-0.10, -0.05, 0.40), rgb=(190, 80, 60)),
    SceneBox(low=(0.15, -0.30, 0.0), high=(0.50, 0.05, 0.25), rgb=(70, 130, 190)),
    SceneBox(low=(-0.15, 0.25, 0.0), high=(0.20, 0.50, 0.55), rgb=(120, 170, 80)),
)


def scene_pose(index: int) -> NDArray[np.float64]:
    """Return world_from_camera (4, 4) of a frame: on a circle around the boxes, looking at their middle."""
    angle = index * _STEP_RAD
    eye = np.array([_EYE_DISTANCE_M * np.cos(angle), _EYE_DISTANCE_M * np.sin(angle), _EYE_HEIGHT_M])
    forward = np.array([0.0, 0.0, 0.2]) - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    pose[:3, 3] = eye
    return pose


def cast_scene(
    boxes: Sequence[SceneBox], camera: Camera, world_from_camera: NDArray[np.float64]
) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.int32]]:
    """Return colour (H, W, 3), depth (H, W) along the axis, NaN for none, and instances: 0 floor, i + 1 box i."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
    rays, eye = rays @ world_from_camera[:3, :3].T, world_from_camera[:3, 3]
    with np.errstate(divide="ignore"):
        floor = np.where(rays[..., 2] < 0, -eye[2] / rays[..., 2], np.inf)
        depths = np.stack([floor, *(_entry(box, eye, rays) for box in boxes)])
    instances = depths.argmin(axis=0).astype(np.int32)
    depth = depths.min(axis=0)
    points = eye + rays * np.where(np.isfinite(depth), depth, 0.0)[..., None]
    # Stripes: a surface without texture would have no gradients to describe.
    shade = 0.8 + 0.2 * np.sign(np.sin(40.0 * points.sum(axis=-1)))
    palette = np.array([(150, 145, 140), *(box.rgb for box in boxes)])
    return (
        (palette[instances] * shade[..., None]).astype(np.uint8),
        np.where(np.isfinite(depth), depth, np.nan).astype(np.float32),
        instances,
    )


def shape_inputs(boxes: Sequence[SceneBox], frames: Sequence[int]) -> ShapeInputs:
    """Return what some frames of the scene see of boxes that are one object."""
    crops = []
    for index in frames:
        pose = scene_pose(index)
        rgb, depth_m, instances = cast_scene(boxes, SCENE_CAMERA, pose)
        crops.append(Crop(rgb=rgb, depth_m=depth_m, mask=instances > 0, camera=SCENE_CAMERA, world_from_camera=pose))
    points = np.concatenate([apply(c.world_from_camera, backproject(c.depth_m, c.camera)[c.mask]) for c in crops])
    return ShapeInputs(
        crops=tuple(crops),
        points_world=points.astype(np.float32),
        colors=np.concatenate([crop.rgb[crop.mask] for crop in crops]),
        box=gravity_aligned_box(points, 0.005),
        support_z_m=0.0,
    )


def _entry(box: SceneBox, eye: NDArray[np.float64], rays: NDArray[np.float64]) -> NDArray[np.float64]:
    # (H, W), infinity where a ray misses (slab method).
    a, b = (np.array(box.low) - eye) / rays, (np.array(box.high) - eye) / rays
    # Three columns one by one: a reduction over an axis of three takes ten times as long.
    near, far = (
        reduce(np.maximum, np.moveaxis(np.minimum(a, b), -1, 0)),
        reduce(np.minimum, np.moveaxis(np.maximum(a, b), -1, 0)),
    )
    return np.where((near < far) & (near > 0), near, np.inf)


@lru_cache(maxsize=64)
def _cast_once(
    boxes: tuple[SceneBox, ...], camera: Camera, step: int
) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.int32]]:
    images = cast_scene(boxes, camera, scene_pose(step))
    for image in images:
        image.flags.writeable = False
    return images


class SceneSource:
    """A `Source` of the scene: by default frames 0.3 s and 7 degrees apart, each of them a keyframe.

    `step_of` gives the step of a frame on the camera's circle (`scene_pose`).
    """

    def __init__(
        self,
        num_frames: int = 8,
        boxes: Sequence[SceneBox] = SCENE_BOXES,
        *,
        camera: Camera = SCENE_CAMERA,
        period_ns: int = PERIOD_NS,
        step_of: Callable[[int], int] = int,
    ) -> None:
        self._num_frames = num_frames
        self._boxes = tuple(boxes)
        self._camera = camera
        self._period_ns = period_ns
        self._step_of = step_of
        self._num_yielded = 0
        self.is_closed = False

    @property
    def info(self) -> SourceInfo:
        """The scene's properties."""
        return SourceInfo(
            uri="memory:scene",
            kind="synthetic scene",
            identity=f"scene-{self._num_frames}-{len(self._boxes)}",
            camera=self._camera,
            num_frames=self._num_frames,
            start_ns=START_NS,
            end_ns=self._stamp_ns(self._num_frames - 1),
            streams=(("color", "cast"), ("depth", "cast"), ("pose", "circle")),
        )

    @cached_property
    def instances(self) -> Mapping[int, NDArray[np.int32]]:
        """The true instances (H, W) of every frame, by its stamp, for `InstanceSegmenter`."""
        return {self._stamp_ns(i): self.cast(self._step_of(i))[2] for i in range(self._num_frames)}

    def cast(self, step: int) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.int32]]:
        """Return colour, depth and instances of a step, like `cast_scene`."""
        return _cast_once(self._boxes, self._camera, step)

    def frames(self) -> Iterator[RawFrame]:
        """Yield the frames from the beginning."""
        self._num_yielded = 0
        for i in range(self._num_frames):
            self._num_yielded += 1
            yield RawFrame(
                index=i,
                stamp_ns=self._stamp_ns(i),
                camera=self._camera,
                world_from_camera=scene_pose(self._step_of(i)),
                decode=partial(self._decode, i),
            )

    def _stamp_ns(self, index: int) -> int:
        return START_NS + index * self._period_ns

    def _decode(self, index: int) -> Frame:
        step = self._step_of(index)
        rgb, depth_m, _ = self.cast(step)
        return Frame(
            index=index,
            stamp_ns=self._stamp_ns(index),
            rgb=rgb,
            depth_m=depth_m,
            camera=self._camera,
            world_from_camera=scene_pose(step),
        )

    def ledger(self) -> Mapping[str, int]:
        """Return how many frames the latest pass has yielded."""
        return {"frames": self._num_yielded}

    def close(self) -> None:
        """Record the call."""
        self.is_closed = True
