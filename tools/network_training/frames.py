"""Training frames, rendered without sensor defects and cached; defects are drawn anew for each lesson."""
# Cameras stand where one can walk, but look from any height between a small robot's and a tall person's, at any pitch,
# with a little roll and a field of view of their own.

import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import ConfigError
from hickory_stream.geometry.camera import Camera, backproject
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.worlds.rendering import Renderer
from hickory_stream.worlds.trajectory import Trajectory, camera_rotation
from tools.worlds.clutter.frames import frames_of
from tools.worlds.recording_config import RecordingConfig, walkable_world

WIDTH_PX, HEIGHT_PX = 320, 240
_NEAR_M = 0.35
_LEAST_THING_PX = 100
_TRIES = 4


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TrueFrame:
    """A frame without defects, and `sensed_m` (H, W) float32: depth with those of a camera, where the scene has one."""

    # `cosine` (H, W) of ray and surface; `instances` (H, W): 0 structure, -1 unknown; depth NaN without a hit; floor at
    # z = 0.
    rgb: NDArray[np.uint8]
    depth_m: NDArray[np.float32]
    cosine: NDArray[np.float32]
    instances: NDArray[np.int32]
    camera: Camera
    world_from_camera: NDArray[np.float64]
    sensed_m: NDArray[np.float32] | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Scene:
    """A synthetic world and how many frames of it are learnt from."""

    # `kind` is that of a recording, or `clutter-FAMILY`: random rooms.
    kind: str
    seed: int
    frames: int

    @property
    def name(self) -> str:
        return f"{self.kind}-{self.seed}-{self.frames}"


class KeptFrames(Sequence[TrueFrame]):
    """The frames of a scene as they lie on the disk; each is read when it is asked for."""

    def __init__(self, file: Path) -> None:
        self._kept = np.load(file, mmap_mode="r")

    def __len__(self) -> int:
        return len(self._kept)

    def __getitem__(self, index: int) -> TrueFrame:
        kept = self._kept[index]
        fx, fy, cx, cy = kept["camera"].tolist()
        return TrueFrame(
            rgb=np.array(kept["rgb"]), depth_m=_metres(kept["depth"]),
            cosine=kept["cosine"].astype(np.float32) / np.float32(255), instances=kept["instances"].astype(np.int32),
            camera=Camera(width=WIDTH_PX, height=HEIGHT_PX, fx=fx, fy=fy, cx=cx, cy=cy),
            world_from_camera=np.array(kept["pose"]), sensed_m=_metres(kept["sensed"]) if kept["is_sensed"] else None,
        )  # fmt: skip


def frames_of_scene(scene: Scene, folder: Path) -> KeptFrames:
    file = folder / f"{scene.name}.npy"
    if not file.is_file():
        started = time.monotonic()
        _write(file, list(_rendered(scene)))
        print(f"rendered {scene.name} ({time.monotonic() - started:.1f} s)", file=sys.stderr, flush=True)
    return KeptFrames(file)


def rendered(scenes: Sequence[Scene], folder: Path, processes: int) -> None:
    """Render the scenes that are not kept in `folder` yet, several at a time if `processes` is over 0."""
    missing = [scene for scene in scenes if not (folder / f"{scene.name}.npy").is_file()]
    if processes < 1 or not missing:
        return
    frames_of_scene(missing[0], folder)  # compiles the kernels once, for all processes
    with ProcessPoolExecutor(processes) as pool:
        for _ in pool.map(partial(_render, folder=folder), missing[1:]):
            pass


def _render(scene: Scene, folder: Path) -> None:
    frames_of_scene(scene, folder)


def _rendered(scene: Scene) -> Iterator[TrueFrame]:
    kind, _, family = scene.kind.partition("-")
    return _of_random_rooms(scene, family) if kind == "clutter" else _of_walk(scene)


def _of_random_rooms(scene: Scene, family: str) -> Iterator[TrueFrame]:
    for frame in frames_of(scene.seed, family, scene.frames, WIDTH_PX, HEIGHT_PX):
        is_known = frame.is_structure | (frame.instances > 0)
        instances = np.where(is_known, frame.instances.astype(np.int32), np.int32(-1))
        yield TrueFrame(
            rgb=frame.rgb, depth_m=frame.exact_depth_m, cosine=_cosine(frame.exact_depth_m, frame.camera),
            instances=instances.astype(np.int32), camera=frame.camera, world_from_camera=frame.world_from_camera,
            sensed_m=frame.depth_m,
        )  # fmt: skip


def _cosine(depth_m: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    points = backproject(depth_m, camera).astype(np.float64)
    right, below = np.roll(points, -1, axis=1) - points, np.roll(points, -1, axis=0) - points
    normal = np.cross(right, below)
    lengths = np.linalg.norm(normal, axis=2) * np.linalg.norm(points, axis=2)
    cosine = np.abs((normal * points).sum(axis=2)) / np.maximum(lengths, 1e-12)
    is_edge = np.maximum(np.abs(right[..., 2]), np.abs(below[..., 2])) > 0.05 * depth_m
    return np.where(is_edge | ~np.isfinite(cosine), 1.0, cosine).astype(np.float32)


def _of_walk(scene: Scene) -> Iterator[TrueFrame]:
    rng = np.random.default_rng([scene.seed, 71])
    try:
        world, trajectory = walkable_world(RecordingConfig(scene=scene.kind, seed=scene.seed, seconds=None))
    except ConfigError:
        return  # a seed without a walk teaches nothing
    renderer = Renderer(world)
    for _ in range(scene.frames):
        for _ in range(_TRIES):
            camera = _camera(rng)
            pose = _pose(scene.kind, trajectory, rng)
            seen = renderer.render(camera, pose)
            near = np.mean(seen.depth_m < _NEAR_M)
            ids, pixels = np.unique(seen.instances[seen.instances > 0], return_counts=True)
            if near < 0.1 and np.count_nonzero(pixels >= _LEAST_THING_PX) >= 2 and len(ids) >= 2:
                yield TrueFrame(
                    rgb=seen.rgb, depth_m=seen.depth_m, cosine=seen.cosine, instances=seen.instances.astype(np.int32),
                    camera=camera, world_from_camera=pose,
                )  # fmt: skip
                break


def _camera(rng: np.random.Generator) -> Camera:
    focal_px = WIDTH_PX / 2 / np.tan(np.radians(rng.uniform(50, 95)) / 2)
    cx, cy = (WIDTH_PX - 1) / 2 + rng.normal(0, 3), (HEIGHT_PX - 1) / 2 + rng.normal(0, 3)
    return Camera(width=WIDTH_PX, height=HEIGHT_PX, fx=float(focal_px), fy=float(focal_px), cx=float(cx), cy=float(cy))


def _pose(kind: str, trajectory: Trajectory, rng: np.random.Generator) -> NDArray[np.float64]:
    before = trajectory.pose_at(float(rng.uniform(0, trajectory.times_s[-1])))
    forward = before[:3, 2]
    yaw, pitch = np.arctan2(forward[1], forward[0]), np.arcsin(np.clip(forward[2], -1, 1))
    place = before[:3, 3].copy()
    if kind == "tabletop":
        place += rng.normal(0, 0.08, 3)
        yaw, pitch = yaw + rng.normal(0, 0.1), pitch + rng.normal(0, 0.1)
    else:
        place[2] = rng.uniform(0.3, 1.8)
        yaw += rng.normal(0, 0.5)
        pitch = np.radians(rng.uniform(-45, 5)) * min(1.0, place[2] / 1.4) + np.radians(rng.normal(0, 5))
    roll = np.radians(rng.normal(0, 3))
    return from_rotation_translation(camera_rotation(float(yaw), float(pitch), float(roll)), place)


_IMAGE = (HEIGHT_PX, WIDTH_PX)
_KEPT = np.dtype([
    ("rgb", np.uint8, (*_IMAGE, 3)), ("depth", np.uint16, _IMAGE), ("sensed", np.uint16, _IMAGE),
    ("is_sensed", np.bool_), ("cosine", np.uint8, _IMAGE), ("instances", np.int16, _IMAGE), ("camera", np.float64, 4),
    ("pose", np.float64, (4, 4)),
])  # fmt: skip


def _write(file: Path, frames: Sequence[TrueFrame]) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    kept = np.zeros(len(frames), dtype=_KEPT)
    for row, frame in zip(kept, frames, strict=True):
        row["rgb"], row["instances"], row["pose"] = frame.rgb, frame.instances, frame.world_from_camera
        row["depth"], row["cosine"] = _fifths_mm(frame.depth_m), (frame.cosine * 255).astype(np.uint8)
        row["camera"] = frame.camera.fx, frame.camera.fy, frame.camera.cx, frame.camera.cy
        if frame.sensed_m is not None:
            row["sensed"], row["is_sensed"] = _fifths_mm(frame.sensed_m), True
    unfinished = file.with_suffix(".unfinished.npy")
    np.save(unfinished, kept)
    unfinished.replace(file)


def _fifths_mm(depth_m: NDArray[np.float32]) -> NDArray[np.float64]:
    return np.asarray(np.nan_to_num(np.clip(np.round(5000.0 * depth_m), 0, 65535)))


def _metres(fifths_mm: NDArray[np.uint16]) -> NDArray[np.float32]:
    depth = fifths_mm.astype(np.float32) / np.float32(5000)
    return np.where(depth > 0, depth, np.float32(np.nan))
