"""The pose of a frame by point features with depth, relative to the last frame, or to a keyframe if that is lost.

ORB features (Rublee et al., ICCV 2011), matched by the ratio of distances (Lowe 2004); perspective-n-point in RANSAC
(OpenCV), then Gauss-Newton over the inliers, which also gives the information of the pose.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import apply, compose, from_rotation_translation, invert, rotation_of_vector
from hickory_stream.records import Frame, Keypoints

Matrix = NDArray[np.float64]

# Of a frame that is tracked, and of a keyframe that is kept for loops.
_NUM_FEATURES, _NUM_KEYPOINTS = 1000, 500
# Images of dim rooms have weak corners.
_CORNER_CONTRAST = 7
# The depth of a feature is the median of the returns within so many pixels, if they are of one surface.
_DEPTH_PX = 2
_SAME_M, _SAME_SHARE = 0.02, 0.05
_RATIO = 0.8
_INLIER_PX = 2.5
_TRIALS, _CONFIDENCE = 300, 0.999
# Wrong matches agree with a wrong pose in groups of up to ten.
_LEAST_INLIERS = 15
# In a lost frame's image, as many must be of the keyframe's: a poster looks alike on many walls.
_LEAST_FOUND = 30
_ITERATIONS = 5
# Features err alike: a pixel each, of which so many count as one.
_CORRELATED = 12.0
# A keyframe is a frame so far from all others: the base of its features.
_KEYFRAME_M, _KEYFRAME_COSINE = 0.5, 0.87
# 70 kB each; the oldest are forgotten first.
_MAX_KEYFRAMES = 1000
# A lost camera is looked for in the keyframes that every sixth of its features votes for most.
_VOTES_EVERY, _NUM_SEARCHED = 6, 8


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Features:
    """Features of a frame: `pixels` (N, 2), binary `descriptors` (N, 32), `points` (N, 3) in its camera or NaN."""

    camera: Camera
    pixels: NDArray[np.float64]
    descriptors: NDArray[np.uint8]
    points: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Sighting:
    """A pose by features: `start_from_camera` (4, 4), and its information (6, 6) in the camera's frame."""

    start_from_camera: Matrix
    information: Matrix
    num_inliers: int
    #: relative to the last frame, not to an earlier keyframe
    is_tracked: bool


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Placed:
    features: Features
    start_from_camera: Matrix


def features_of(frame: Frame, num_features: int = _NUM_FEATURES) -> Features:
    """Return the features of a frame, with the depth at each."""
    detector = cv2.ORB.create(num_features, fastThreshold=_CORNER_CONTRAST)
    corners, descriptors = detector.detectAndCompute(cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2GRAY), None)
    pixels = np.array([corner.pt for corner in corners], dtype=np.float64).reshape(-1, 2)
    camera, depth = frame.camera, _depth_at(frame.depth_m, pixels)
    x, y = (pixels[:, 0] - camera.cx) / camera.fx, (pixels[:, 1] - camera.cy) / camera.fy
    return Features(
        camera=camera,
        pixels=pixels,
        descriptors=np.empty((0, 32), np.uint8) if descriptors is None else np.asarray(descriptors, dtype=np.uint8),
        points=np.stack([x * depth, y * depth, depth], axis=1),
    )


def keypoints_of(frame: Frame) -> Keypoints:
    """Return the strongest features of a keyframe that have a depth."""
    features = features_of(frame, _NUM_KEYPOINTS)
    has = np.isfinite(features.points[:, 2])
    return Keypoints(
        camera=frame.camera,
        world_from_camera=frame.world_from_camera,
        descriptors=features.descriptors[has],
        points=features.points[has].astype(np.float32),
    )


def recognised(views: Sequence[Keypoints], others: Sequence[Keypoints]) -> tuple[int, int, Sighting] | None:
    """Return which of some keyframes shows most of which other one, and its pose by that; None: none shows enough."""
    placed, best = [_placed(other) for other in others], None
    for i, view in enumerate(views):
        found = _found(_placed(view).features, placed)
        if found is not None and (best is None or found[1].num_inliers > best[2].num_inliers):
            best = (i, *found)
    return best


def _placed(view: Keypoints) -> _Placed:
    camera, points = view.camera, view.points.astype(np.float64)
    x, y, z = points.T
    pixels = np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], axis=1)
    features = Features(camera=camera, pixels=pixels, descriptors=view.descriptors, points=points)
    return _Placed(features=features, start_from_camera=view.world_from_camera)


def _depth_at(depth_m: NDArray[np.float32], pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    padded = np.pad(depth_m, _DEPTH_PX, constant_values=np.nan)
    column, row = np.rint(pixels).astype(np.int64).T
    window = np.arange(2 * _DEPTH_PX + 1)
    around = padded[row[:, None, None] + window[:, None], column[:, None, None] + window]
    around = around.reshape(len(pixels), len(window) ** 2).astype(np.float64)
    around = np.sort(np.where(around > 0, around, np.nan), axis=1)
    count, each = np.isfinite(around).sum(axis=1), np.arange(len(pixels))
    nearest, farthest, middle = around[:, 0], around[each, np.maximum(count - 1, 0)], around[each, count // 2]
    is_flat = farthest - nearest <= _SAME_M + _SAME_SHARE * nearest
    return np.where((4 * count >= around.shape[1]) & is_flat, middle, np.nan)


class VisualMotion:
    """The features of the last frame, and of keyframes among which a lost camera finds its place."""

    def __init__(self) -> None:
        self._keyframes, self._places = list[_Placed](), np.empty((0, 4, 4))
        self._last: _Placed | None = None

    def sighted(self, features: Features) -> Sighting | None:
        """Return the pose of a frame by its features; None: they match neither the last frame nor a keyframe."""
        if self._last is None:
            return None
        return _pose(features, self._last, _LEAST_INLIERS, is_tracked=True) or self.found(features)

    def found(self, features: Features) -> Sighting | None:
        """Return the pose of a frame by the keyframe that shows most of the same; None: none does."""
        found = _found(features, self._keyframes)
        return None if found is None else found[1]

    def placed(self, features: Features, start_from_camera: Matrix) -> None:
        """Remember a frame at its final pose (4, 4)."""
        self._last = placed = _Placed(features=features, start_from_camera=start_from_camera)
        is_close = np.linalg.norm(self._places[:, :3, 3] - start_from_camera[:3, 3], axis=1) < _KEYFRAME_M
        looks_alike = (self._places[:, :3, 2] * start_from_camera[:3, 2]).sum(axis=1) > _KEYFRAME_COSINE
        if not (is_close & looks_alike).any():
            self._keyframes = [*self._keyframes, placed][-_MAX_KEYFRAMES:]
            self._places = np.array([each.start_from_camera for each in self._keyframes])


def _found(features: Features, keyframes: Sequence[_Placed]) -> tuple[int, Sighting] | None:
    # The keyframe that shows most of the same, and the pose of the features by it.
    some = features.descriptors[::_VOTES_EVERY]
    votes = [len(_alike(some, each.features.descriptors)) for each in keyframes]
    likeliest = np.argsort(-np.array(votes), kind="stable")[:_NUM_SEARCHED]
    poses = ((int(i), _pose(features, keyframes[i], _LEAST_FOUND)) for i in likeliest)
    found = [(i, pose) for i, pose in poses if pose is not None]
    return max(found, key=lambda each: each[1].num_inliers, default=None)


def _pose(features: Features, other: _Placed, least: int, *, is_tracked: bool = False) -> Sighting | None:
    known = np.flatnonzero(np.isfinite(other.features.points[:, 2]))
    good = _alike(features.descriptors, other.features.descriptors[known])
    ours, theirs = (np.array([getattr(each, name) for each in good], np.int64) for name in ("queryIdx", "trainIdx"))
    if len(ours) < least:
        return None
    points = apply(other.start_from_camera, other.features.points[known[theirs]])
    located = _located(points, features, ours, least)
    if located is None:
        return None
    start_from_camera, information, num_inliers = located
    return Sighting(
        start_from_camera=start_from_camera, information=information, num_inliers=num_inliers, is_tracked=is_tracked
    )


def _alike(ours: NDArray[np.uint8], theirs: NDArray[np.uint8]) -> list[cv2.DMatch]:
    # The matches that are clearly nearer than the second nearest.
    if len(ours) == 0 or len(theirs) < 2:
        return []
    pairs = cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(ours, theirs, k=2)
    return [first for first, second in pairs if first.distance < _RATIO * second.distance]


def _located(
    points: NDArray[np.float64], features: Features, chosen: NDArray[np.int64], least: int
) -> tuple[Matrix, Matrix, int] | None:
    # The camera's pose among `points` (N, 3) that are its `chosen` features, its information, the number of inliers.
    camera, pixels, depth = features.camera, features.pixels[chosen], features.points[chosen, 2]
    lens = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
    is_found, turn, shift, _ = cv2.solvePnPRansac(
        points,
        pixels,
        lens,
        None,
        iterationsCount=_TRIALS,
        reprojectionError=_INLIER_PX,
        confidence=_CONFIDENCE,
        flags=cv2.SOLVEPNP_AP3P,
    )
    if not is_found:
        return None
    camera_from_start = from_rotation_translation(rotation_of_vector(turn[:, 0]), shift[:, 0])
    for _ in range(_ITERATIONS):
        there = apply(camera_from_start, points)
        x, y, z = there[:, 0], there[:, 1], np.maximum(there[:, 2], 1e-3)
        off = pixels - np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], axis=1)
        # Its own depth may lack a feature, but not contradict it.
        is_in = (np.abs(off).max(axis=1) <= _INLIER_PX) & ~(np.abs(depth - z) > _SAME_M + _SAME_SHARE * z)
        if is_in.sum() < least:
            return None
        rows = _jacobian(there[is_in], camera).reshape(-1, 6)
        information = rows.T @ rows / _CORRELATED
        step = np.linalg.solve(information + 1e-9 * np.eye(6), rows.T @ off[is_in].ravel() / _CORRELATED)
        moved = from_rotation_translation(rotation_of_vector(step[:3]), step[3:])
        camera_from_start = compose(invert(moved), camera_from_start)
    return invert(camera_from_start), information, int(is_in.sum())


def _jacobian(points: NDArray[np.float64], camera: Camera) -> NDArray[np.float64]:
    # (N, 2, 6) change of the pixels of points (N, 3) in the camera, by its turn, then shift, in its own frame.
    x, y, z = points.T
    zero = np.zeros_like(z)
    across = [camera.fx / z, zero, -camera.fx * x / (z * z), zero, camera.fy / z, -camera.fy * y / (z * z)]
    by_point = np.stack(across, axis=1).reshape(-1, 2, 3)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    return np.concatenate([by_point @ cross, -by_point], axis=2)
