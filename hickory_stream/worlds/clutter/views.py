"""Random views in a random room: mostly of some object, from a height of 0.3 to 1.8 m, level or tilted."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.worlds.clutter.draws import chance, log_uniform, one_of, uniform
from hickory_stream.worlds.clutter.footprints import is_inside
from hickory_stream.worlds.trajectory import camera_rotation

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.geometry.camera import Camera
    from hickory_stream.worlds.clutter.room import ClutterRoom
    from hickory_stream.worlds.rendering import Probe, Renderer

_DRAWS = 40
_PROBE_PX = 48
_LOW_M, _HIGH_M = 0.3, 1.8


def random_view(
    rng: np.random.Generator, room: ClutterRoom, renderer: Renderer, camera: Camera
) -> NDArray[np.float64] | None:
    """Return `world_from_camera` of a view with things in it; None if no draw finds one.

    The camera is in free space, no near surface fills its image, and nearly always several things are visible.
    """
    if not room.world.objects:
        return None
    least = 1 if chance(rng, 0.1) else 3
    covered = uniform(rng, 0.03, 0.4)
    small = camera.scaled(_PROBE_PX / camera.width)
    for _ in range(_DRAWS):
        pose = _at_something(rng, room) if chance(rng, 0.75) else _anywhere(rng, room)
        if is_inside(pose[None, :2, 3], room.plan.outline_m)[0] and _shows(renderer.probe(small, pose), least, covered):
            return pose
    return None


def _shows(probe: Probe, least: int, covered: float) -> bool:
    """Return whether a view is from free space, not too near to surfaces, with enough things on enough of its area."""
    near = float((probe.depth_m < 0.25).mean())
    counts = np.unique(probe.instances[probe.instances > 0], return_counts=True)[1]
    shares = counts / len(probe.instances)
    return (
        near < 0.03
        and float(probe.is_within.mean()) < 0.004
        and 0.45 < float(np.median(probe.depth_m)) < 7.0
        and int((shares > 0.003).sum()) >= least
        and float(shares.max(initial=0.0)) < 0.65
        and float(shares.sum()) >= covered
    )


def _at_something(rng: np.random.Generator, room: ClutterRoom) -> NDArray[np.float64]:
    """Return a view of a random thing, from a distance proportional to its size."""
    item = one_of(rng, room.world.objects)
    low, high = item.model.bounds_m()
    center = (item.world_from_object @ [*((low + high) / 2), 1.0])[:3]
    size = float(np.linalg.norm(high - low))
    turn, away = uniform(rng, 0, 2 * np.pi), log_uniform(rng, 0.4, 2.6) + 0.45 * size
    eye = np.array([center[0] + away * np.cos(turn), center[1] + away * np.sin(turn), uniform(rng, _LOW_M, _HIGH_M)])
    to = center - eye
    yaw = float(np.arctan2(to[1], to[0])) + float(rng.normal(0, 0.2))
    pitch = float(np.arctan2(to[2], np.hypot(to[0], to[1]))) + float(rng.normal(0, 0.12))
    return _pose(rng, eye, yaw, float(np.clip(pitch, -1.2, 0.5)))


def _anywhere(rng: np.random.Generator, room: ClutterRoom) -> NDArray[np.float64]:
    """Return a view from anywhere in the room, as from a person or a robot that moves through it."""
    x0, y0, x1, y1 = room.plan.bounds_m
    eye = np.array([uniform(rng, x0, x1), uniform(rng, y0, y1), uniform(rng, _LOW_M, _HIGH_M)])
    # A low camera looks ahead, a high one down.
    pitch = float(rng.normal(-0.25 * (eye[2] - 0.5), 0.15))
    return _pose(rng, eye, uniform(rng, -np.pi, np.pi), pitch)


def _pose(rng: np.random.Generator, eye: NDArray[np.float64], yaw: float, pitch: float) -> NDArray[np.float64]:
    roll = float(rng.normal(0, 0.2)) if chance(rng, 0.15) else float(rng.normal(0, 0.03))
    return from_rotation_translation(camera_rotation(yaw, pitch, roll), eye)
