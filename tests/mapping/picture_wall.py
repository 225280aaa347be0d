"""A wall with pictures of known thickness, as a stereo camera sees it: noise and steps are those of disparity."""

import cv2
import numpy as np
from hickory_stream.geometry.boxes import OrientedBox
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.records import Frame, Segmentation
from tests.perception.perception_scenes import looking

CAMERA = Camera(width=640, height=480, fx=350.0, fy=350.0, cx=319.5, cy=239.5)
_BASELINE_M, _STEPS_PER_PX, _CORRELATION_PX = 0.12, 16, 3.0
# Width, height, thickness, and the middle on the wall, all in metres; the wall is x = 0, and cameras look along -x.
PICTURES = (
    (0.5, 0.4, 0.01, -0.9, 1.8), (0.6, 0.8, 0.02, 0.0, 1.6), (0.4, 0.3, 0.03, 0.8, 1.9), (0.3, 0.4, 0.04, 0.7, 1.2),
    (0.7, 0.5, 0.05, -0.8, 1.2),
)  # fmt: skip


def true_boxes():
    return [
        OrientedBox(
            world_from_box=from_rotation_translation(np.eye(3), np.array([thick / 2, y, z])),
            half_extents_m=np.array([thick, w, h]) / 2,
        )
        for w, h, thick, y, z in PICTURES
    ]


def frames(distance_m, count, sigma_per_m, seed=0):
    """Frames from places around one at this distance, with the true masks; depth errs by `sigma_per_m` z^2."""
    rng = np.random.default_rng(seed)
    made = []
    for index in range(count):
        place = np.array([distance_m, 0.0, 1.5]) + rng.uniform(-1, 1, 3) * (0.1 * distance_m, 0.25 * distance_m, 0.2)
        pose = looking((0.0, rng.uniform(-0.2, 0.2), 1.5), start=place)
        depth, labels = _rendered(pose)
        made.append((
            Frame(
                index=index, stamp_ns=index * 300_000_000, rgb=np.full((480, 640, 3), 128, np.uint8),
                depth_m=_sensed(depth, sigma_per_m, rng), camera=CAMERA, world_from_camera=pose,
            ),
            Segmentation(instances=labels, structure=labels == 0),
        ))  # fmt: skip
    return made


def _rendered(world_from_camera):
    # Rays meet a wall, or one of the slabs before it.
    v, u = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], axis=-1)
    rays = rays @ world_from_camera[:3, :3].T
    place = world_from_camera[:3, 3]
    depth, labels = -place[0] / rays[..., 0], np.zeros(u.shape, np.int32)
    for label, box in enumerate(true_boxes(), 1):
        ends = [(box.center + sign * box.half_extents_m - place) / rays for sign in (-1, 1)]
        near, far = np.minimum(*ends).max(axis=-1), np.maximum(*ends).min(axis=-1)
        hits = (near <= far) & (near < depth)
        depth, labels = np.where(hits, near, depth), np.where(hits, np.int32(label), labels)
    return depth, labels


def _sensed(depth, sigma_per_m, rng):
    # Half of the variance is that of neighbours, too, which are matched with overlapping windows.
    smooth = cv2.GaussianBlur(rng.standard_normal(depth.shape), (0, 0), _CORRELATION_PX)
    noise = (smooth / smooth.std() + rng.standard_normal(depth.shape)) / np.sqrt(2)
    constant = CAMERA.fx * _BASELINE_M
    disparity = constant / depth + sigma_per_m * constant * noise
    sensed = constant * _STEPS_PER_PX / np.maximum(np.rint(disparity * _STEPS_PER_PX), 1)
    return np.where(np.abs(depth) < 8, np.round(sensed, 3), np.nan).astype(np.float32)
