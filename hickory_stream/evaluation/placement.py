"""The transform from the truth's world to the map's: the identity, or the rigid transform between their camera poses.

The odometry of a log may start anywhere. Drift is not rigid, and is not corrected.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import RecordingError
from hickory_stream.evaluation.truth import Truth, TruthFrame, frame_at, moved_truth
from hickory_stream.geometry.rigid import from_rotation_translation, invert, rotation_angle_rad
from hickory_stream.map_folder.saved_map import SavedMap

_SAME_WORLD_M, _SAME_WORLD_RAD = 2.0, np.deg2rad(15.0)
# A transform is accepted if its residual is at most this share of the difference, and at most this many metres.
_EXPLAINED, _MAX_REST_M = 0.2, 0.25
_MIN_POSES, _MIN_SPREAD_M = 4, 0.25
_MAX_TILT_RAD = np.deg2rad(5.0)
_HYPOTHESES = 60


@dataclass(frozen=True, kw_only=True, slots=True)
class Placement:
    """The motion of a truth into the world of a map: the rows of `map_from_world` (4, 4), its distance and angle.

    `rest_m` and `rest_deg` are median residuals over `num_poses` camera poses.
    """

    map_from_world: tuple[tuple[float, ...], ...]
    distance_m: float
    turned_deg: float
    rest_m: float
    rest_deg: float
    num_poses: int


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ViewFrame:
    """A kept view of a map: its camera pose in the map's world, and the true frame of the same stamp."""

    name: str
    world_from_camera: NDArray[np.float64]
    frame: TruthFrame


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PlacedTruth:
    """A truth in the world of a map; `placement` is None for equal worlds."""

    truth: Truth
    views: tuple[ViewFrame, ...]
    placement: Placement | None


def placed_truth(saved: SavedMap, truth: Truth) -> PlacedTruth:
    """Return a truth in the world of a map, with the true frames of the map's views.

    Raises `RecordingError` if no view has a true frame, or no rigid transform makes the camera poses agree.
    """
    views = _views_with_frames(saved, truth)
    once = {view.frame.index: view for view in views}
    found = np.array([once[i].world_from_camera for i in sorted(once)]).reshape(-1, 4, 4)
    true = np.array([once[i].frame.world_from_camera for i in sorted(once)]).reshape(-1, 4, 4)
    if len(found) == 0:
        return PlacedTruth(truth=truth, views=views, placement=None)
    apart_m, turned_rad = (float(np.median(values)) for values in _differences(found, true))
    placement = _placement(found, true, apart_m + turned_rad)
    if placement is not None:
        map_from_world = np.array(placement.map_from_world)
        _check_level(map_from_world, saved, truth)
        moved = moved_truth(truth, map_from_world)
        frames = {frame.index: frame for frame in moved.frames}
        views = tuple(replace(view, frame=frames[view.frame.index]) for view in views)
        return PlacedTruth(truth=moved, views=views, placement=placement)
    if apart_m > _SAME_WORLD_M or turned_rad > _SAME_WORLD_RAD:
        raise RecordingError(
            f"{truth.folder} is of another world than {saved.folder}: at equal stamps the cameras are "
            f"{apart_m:.1f} m apart and turned by {np.rad2deg(turned_rad):.0f} deg, and no rigid transform explains "
            "it; name the truth folder beside the log that was played"
        )
    return PlacedTruth(truth=truth, views=views, placement=None)


def _views_with_frames(saved: SavedMap, truth: Truth) -> tuple[ViewFrame, ...]:
    views = {view.name: view for tracked in saved.snapshot.objects for view in tracked.views}
    stamps = np.array([frame.stamp_ns for frame in truth.frames], dtype=np.int64)
    found = []
    for name in sorted(views):
        view = views[name]
        i = frame_at(stamps, view.stamp_ns)
        if i is not None:
            found.append(ViewFrame(name=name, world_from_camera=view.world_from_camera, frame=truth.frames[i]))
    if views and not found:
        first = min(view.stamp_ns for view in views.values())
        span = f"{stamps[0] / 1e9:.3f} s to {stamps[-1] / 1e9:.3f} s" if len(stamps) else "no frames"
        raise RecordingError(
            f"{truth.folder} is not the truth of the log of {saved.folder}: the map's first view is of "
            f"{first / 1e9:.3f} s, the truth has {span}; name the truth folder beside the log that was played"
        )
    return tuple(found)


def _placement(found: NDArray[np.float64], true: NDArray[np.float64], difference: float) -> Placement | None:
    """Return the rigid transform between (N, 4, 4) poses, None if none fits; `difference` is in metres plus radians."""
    spread_m = float(np.linalg.norm(np.ptp(true[:, :3, 3], axis=0)))
    if len(found) < _MIN_POSES or spread_m < _MIN_SPREAD_M or difference < 1e-3:
        return None
    map_from_world = _consensus(found, true)
    rest_m, rest_rad = (float(np.median(values)) for values in _differences(found, map_from_world @ true))
    if rest_m > _MAX_REST_M or rest_m + rest_rad > _EXPLAINED * difference:
        return None
    return Placement(
        map_from_world=tuple(tuple(float(value) for value in row) for row in map_from_world),
        distance_m=float(np.linalg.norm(map_from_world[:3, 3])),
        turned_deg=float(np.rad2deg(rotation_angle_rad(map_from_world[:3, :3]))),
        rest_m=rest_m,
        rest_deg=float(np.rad2deg(rest_rad)),
        num_poses=len(found),
    )


def _consensus(found: NDArray[np.float64], true: NDArray[np.float64]) -> NDArray[np.float64]:
    some = np.unique(np.linspace(0, len(found) - 1, _HYPOTHESES).round().astype(int))
    hypotheses = [found[i] @ invert(true[i]) for i in some]
    errors = [np.sum(_differences(found, hypothesis @ true), axis=0) for hypothesis in hypotheses]
    best = min(errors, key=lambda error: float(np.median(error)))
    agrees = best <= np.median(best)
    u, _, vt = np.linalg.svd(np.einsum("nij,nkj->ik", found[agrees, :3, :3], true[agrees, :3, :3]))
    rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    shift = np.median(found[agrees, :3, 3] - true[agrees, :3, 3] @ rotation.T, axis=0)
    return from_rotation_translation(rotation, shift)


def _differences(
    found: NDArray[np.float64], true: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    angles = [rotation_angle_rad(b[:3, :3].T @ a[:3, :3]) for a, b in zip(found, true, strict=True)]
    return np.linalg.norm(found[:, :3, 3] - true[:, :3, 3], axis=1), np.array(angles)


def _check_level(map_from_world: NDArray[np.float64], saved: SavedMap, truth: Truth) -> None:
    # The boxes of map and truth are upright, so that their verticals must agree.
    tilt_rad = float(np.arccos(np.clip(map_from_world[2, 2], -1.0, 1.0)))
    if tilt_rad > _MAX_TILT_RAD:
        raise RecordingError(
            f"{truth.folder} fits {saved.folder} only if it is tilted by {np.rad2deg(tilt_rad):.0f} deg: the map's z "
            "is not up. Upright boxes cannot be compared; give the log its gravity, and play it again"
        )
