"""Scenes by construction: a camera above a floor, with boxes, cylinders and walls rendered by exact ray casting."""

from dataclasses import dataclass
from functools import reduce
import numpy as np
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.records import Frame

CAMERA = Camera(width=320, height=240, fx=290.0, fy=290.0, cx=159.5, cy=119.5)


@dataclass(frozen=True, kw_only=True)
class Block:
    """An upright box from `low` to `high` (metres, world), of one colour."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    color: tuple[int, int, int]

    def depths(self, origin, rays):
        with np.errstate(divide="ignore", invalid="ignore"):
            a, b = (np.array(self.low) - origin) / rays, (np.array(self.high) - origin) / rays
        # Faster than along the last axis.
        enter = reduce(np.maximum, np.moveaxis(np.minimum(a, b), -1, 0))
        leave = reduce(np.minimum, np.moveaxis(np.maximum(a, b), -1, 0))
        return np.where((enter < leave) & (enter > 0), enter, np.inf)


@dataclass(frozen=True, kw_only=True)
class Cylinder:
    """An upright closed cylinder that stands at `foot`."""

    foot: tuple[float, float, float]
    radius: float
    height: float
    color: tuple[int, int, int]

    def depths(self, origin, rays):
        start = origin - np.array(self.foot)
        a, b = (rays[..., :2] ** 2).sum(-1), rays[..., :2] @ start[:2]
        root = b**2 - a * (start[:2] @ start[:2] - self.radius**2)
        with np.errstate(divide="ignore", invalid="ignore"):
            side = (-b - np.sqrt(root)) / a
            top = (self.height - start[2]) / rays[..., 2]
            z = start[2] + side * rays[..., 2]
        side = np.where((root > 0) & (side > 0) & (z > 0) & (z < self.height), side, np.inf)
        lid = start[:2] + top[..., None] * rays[..., :2]
        top = np.where((top > 0) & ((lid**2).sum(-1) < self.radius**2), top, np.inf)
        return np.minimum(side, top)


def floor(color=(120, 110, 100)):
    return Block(low=(-20.0, -20.0, -1.0), high=(20.0, 20.0, 0.0), color=color)


def looking(at, *, start):
    """Return world_from_camera of a camera at `start` that looks at a point, its x axis level."""
    forward = np.subtract(at, start) / np.linalg.norm(np.subtract(at, start))
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    return from_rotation_translation(np.stack([right, np.cross(forward, right), forward], axis=1), np.asarray(start))


def render(things, world_from_camera, camera=CAMERA):
    """Return the frame and, per pixel, the index of the thing that it shows; -1 where there is nothing."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
    rays = rays @ world_from_camera[:3, :3].T
    depths = np.stack([thing.depths(world_from_camera[:3, 3], rays) for thing in things])
    nearest = depths.min(axis=0)
    shown = np.where(np.isfinite(nearest), depths.argmin(axis=0), -1)
    colors = np.array([thing.color for thing in things] + [(0, 0, 0)], dtype=np.uint8)
    frame = Frame(
        index=0, stamp_ns=0, rgb=colors[shown],
        depth_m=np.where(np.isfinite(nearest), nearest, np.nan).astype(np.float32), camera=camera,
        world_from_camera=world_from_camera,
    )  # fmt: skip
    return frame, shown


def best_iou(instances, mask):
    """Return the best IoU of a mask with an instance, and the instance's label."""
    best = (0.0, 0)
    for label in np.unique(instances[mask]):
        if label > 0:
            region = instances == label
            best = max(best, (float((region & mask).sum() / (region | mask).sum()), int(label)))
    return best
