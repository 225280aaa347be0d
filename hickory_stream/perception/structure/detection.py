"""Detection of room structure in a frame: the floor, walls and ceiling.

The floor is the lowest wide horizontal surface; a wall or a ceiling has all of the room on one side. A wall with an
open door has surface behind it, like a cupboard's front: it is known by its height, and only visible sections count.
"""

from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.base.ranges import Ranged, number
from hickory_stream.geometry import portable
from hickory_stream.geometry.portable_kernels import cos, sin
from hickory_stream.perception.structure.ground import AT_FLOOR_M, Ground, GroundConfig
from hickory_stream.perception.surface import Surface
from hickory_stream.storeys import STOREY_M

# Minimum visible area of a floor.
FLOOR_AREA_M2 = 0.25
# Minimum visible area of a wall or ceiling.
_WALL_AREA_M2 = 0.45
# Maximum share of the frame's surface behind a wall.
_BEHIND_SHARE = 0.02
# Maximum distance from a plane, plus 3 sigma of depth, of pixels that belong to it.
_TOLERANCE_M = 0.025
# A vertical plane this wide is a wall, even with surface behind it, if it is visible below the foot height above the
# floor and reaches up to the wall height, or to the cut height and the upper image border.
_WALL_WIDTH_M = 0.9
_WALL_FOOT_M = 1.2
_WALL_HEIGHT_M = 2.1
_WALL_CUT_M = 1.5


@dataclass(frozen=True, kw_only=True, slots=True)
class StructureConfig(Ranged):
    """What counts as structure."""

    #: Minimum distance of a floor below the camera.
    floor_below_camera_m: float = number(0.25, 0, 100, "m")
    #: Which surfaces are ground where the ground is not one level plane.
    ground: GroundConfig = field(default_factory=GroundConfig)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class HorizontalPlane:
    """A horizontal surface at height `z_m`, with `area_m2` of it visible in the frame."""

    z_m: float
    area_m2: float


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Wall:
    """A vertical plane, normal . p = offset, with the horizontal unit normal (2,) into the room."""

    normal: NDArray[np.float32]
    offset: float
    #: sorted indices of its visible sections, `_STRETCH_M` long; None: it bounds the room, with structure behind it
    cells: NDArray[np.int64] | None

    def distance_m(self, surface: Surface) -> NDArray[np.float32]:
        """Return (h, w) the signed distance of each pixel in front of the wall."""
        rows = surface.points_world.reshape(-1, 3)
        return np.asarray(_along(rows, self.normal).reshape(surface.depth_m.shape) - np.float32(self.offset))

    def mask(
        self, surface: Surface, distance: NDArray[np.float32], tolerance: NDArray[np.float32]
    ) -> NDArray[np.bool_]:
        """Return (h, w) the pixels of the wall, to a tolerance in metres per pixel."""
        facing = _along(surface.normals_world.reshape(-1, 3), self.normal).reshape(distance.shape)
        mask = _on_wall(distance, facing, tolerance, is_end=self.cells is None)
        if self.cells is not None:
            mask[mask] = np.isin(_stretches(surface.points_world[mask][:, :2], self.normal), self.cells)
        return mask


def _on_wall(
    distance: NDArray[np.float32], facing: NDArray[np.float32], tolerance: NDArray[np.float32], *, is_end: bool
) -> NDArray[np.bool_]:
    # Near and parallel to a wall, or very near; with `is_end`, also all behind it.
    away = distance if is_end else np.abs(distance)
    return np.asarray((away < np.float32(1.5) * tolerance) & ((facing > 0.8) | (away < np.float32(0.6) * tolerance)))


_STRETCH_M = 0.25
_SEEN_M2 = 0.03


def _stretches(at: NDArray[np.float32], normal: NDArray[np.float32]) -> NDArray[np.int64]:
    # (N,) the index of the section along a wall of each of (N, 2) points.
    sideways = _along(at, np.array([-normal[1], normal[0]], dtype=np.float32))
    return np.floor(sideways / _STRETCH_M).astype(np.int64)


def pixel_areas_m2(surface: Surface) -> NDArray[np.float32]:
    """Return (h, w) the surface area of each pixel; 0 without depth, bounded at grazing angles."""
    eye, focal2 = surface.world_from_camera[:3, 3].astype(np.float32), np.float32(surface.camera.fx * surface.camera.fy)
    return np.asarray(_pixel_areas(surface.depth_m, surface.points_world, surface.normals_world, eye, focal2))


@kernel(error_model="numpy")
def _pixel_areas(depth, points, normals, eye, focal2):
    out = np.zeros(depth.shape, np.float32)
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            z, px, py, pz = depth[y, x], points[y, x, 0] - eye[0], points[y, x, 1] - eye[1], points[y, x, 2] - eye[2]
            across = abs(px * normals[y, x, 0] + py * normals[y, x, 1] + pz * normals[y, x, 2])
            cosine = across / np.sqrt(px * px + py * py + pz * pz)
            if not np.isnan(cosine):
                out[y, x] = z * z / focal2 / max(cosine, np.float32(0.15))
    return out


def horizontal_planes(surface: Surface, areas_m2: NDArray[np.float32], *, min_area_m2: float) -> list[HorizontalPlane]:
    """Return the upward-facing horizontal planes of a frame, lowest first: peaks of the height histogram."""
    upward, bin_m = surface.normals_world[..., 2] > 0.9, 0.01
    heights, weights = surface.points_world[..., 2][upward], areas_m2[upward]
    if len(heights) == 0:
        return []
    low = float(heights.min()) - 3 * bin_m
    bins = int((float(heights.max()) - low) / bin_m) + 4
    histogram = np.bincount(((heights - low) / bin_m).astype(np.int64), weights=weights, minlength=bins)
    # Sums of five bins: a plane with depth noise of a centimetre or two is one peak.
    smooth = np.convolve(histogram, np.ones(5), mode="same")
    planes: list[HorizontalPlane] = []
    while True:
        peak = int(np.argmax(smooth))
        if smooth[peak] < min_area_m2:
            return sorted(planes, key=lambda plane: plane.z_m)
        near = np.abs(heights - (low + (peak + 0.5) * bin_m)) < 2.5 * bin_m
        z_m = float(np.average(heights[near], weights=weights[near])) if near.any() else low + (peak + 0.5) * bin_m
        planes.append(HorizontalPlane(z_m=z_m, area_m2=float(smooth[peak])))
        smooth[max(0, peak - 4) : peak + 5] = 0.0


def floor_height_m(
    surface: Surface, planes: list[HorizontalPlane], known_m: float | None, config: StructureConfig
) -> float | None:
    """Return the floor's height in this frame, or the map's if the frame shows no floor.

    Only a lower plane replaces the map's floor: a table that fills the view is no floor. For a camera a storey above
    the map's floor, the floor is the largest plane below it.
    """
    camera_z = float(surface.world_from_camera[2, 3])
    highest_m = camera_z - config.floor_below_camera_m
    below = [plane for plane in planes if plane.area_m2 >= FLOOR_AREA_M2 and plane.z_m <= highest_m]
    if known_m is None:
        return _floor_of(below).z_m if below else None
    # A camera higher than a storey above the map's floor is on another storey.
    if camera_z - known_m > STOREY_M:
        return max(below, key=lambda plane: (plane.area_m2, -plane.z_m)).z_m if below else known_m
    # A floor a storey lower belongs to the storey below, seen over a railing.
    lower = [plane for plane in below if known_m - STOREY_M < plane.z_m <= known_m + AT_FLOOR_M]
    return _floor_of(lower).z_m if lower else known_m


def _floor_of(planes: list[HorizontalPlane]) -> HorizontalPlane:
    # A tilted or noisy floor has a flank of its own peak: of the planes at the lowest one's height, the largest counts.
    return max((p for p in planes if p.z_m <= planes[0].z_m + AT_FLOOR_M), key=lambda plane: plane.area_m2)


def structure_mask(
    surface: Surface,
    areas_m2: NDArray[np.float32],
    floor_z_m: float | None,
    ground: Ground | None,
) -> NDArray[np.bool_]:
    """Return (h, w) the pixels on or behind floor (`floor_z_m` or `ground`), walls or ceiling."""
    tolerance = _TOLERANCE_M + 2.0 * surface.sigma_m
    mask = _ceiling(surface, areas_m2, tolerance)
    if floor_z_m is not None:
        height = surface.points_world[..., 2] - np.float32(floor_z_m) if ground is None else ground.height_m
        level = surface.normals_world[..., 2] > 0.8
        mask |= (height < tolerance) & (level | (height < 0.6 * tolerance))
    for wall in _walls(surface, areas_m2, floor_z_m):
        mask |= wall.mask(surface, wall.distance_m(surface), tolerance)
    return mask


def _ceiling(surface: Surface, areas_m2: NDArray[np.float32], tolerance: NDArray[np.float32]) -> NDArray[np.bool_]:
    downward = surface.normals_world[..., 2] < -0.9
    z = surface.points_world[..., 2]
    above = z > surface.world_from_camera[2, 3] + 0.4
    if float(areas_m2[downward & above].sum()) < _WALL_AREA_M2:
        return np.zeros(z.shape, dtype=bool)
    top = float(np.nanmax(z[downward & above]))
    return np.asarray((z > top - 2 * tolerance - 0.05) & above)


def _walls(surface: Surface, areas_m2: NDArray[np.float32], floor_z_m: float | None) -> list[Wall]:
    # By direction, the rearmost first.
    points, normals = surface.points_world.reshape(-1, 3), surface.normals_world.reshape(-1, 3)
    weights = areas_m2.reshape(-1)
    sigma, own = surface.sigma_m.reshape(-1), np.flatnonzero(weights > 0)
    all_at, all_weight = points.take(own, axis=0), weights[own].astype(np.float64)
    all_sigma = np.float32(2) * sigma[own]
    left = _upright(points, normals, sigma, weights)
    if len(left.pixels) == 0:
        return []
    walls: list[Wall] = []
    width, total = surface.depth_m.shape[1], float(all_weight.sum())
    for _ in range(8):
        normal = _dominant_direction(left)
        agreement = _along(left.direction, normal)
        facing, left = left.among(agreement > 0.97), left.among(~(agreement > 0.94))
        for peak in _peaks(_along(facing.at, normal), facing, _WALL_AREA_M2):
            inward, offset = _refined(facing, normal, peak)
            offsets = _along(facing.at, inward)
            on_it = np.flatnonzero(np.abs(offsets - np.float32(offset)) < 0.04 + facing.sigma)
            if len(on_it) == 0:
                continue
            at = facing.at.take(on_it, axis=0)
            all_offsets = _along(all_at, inward)
            places = np.flatnonzero(all_offsets < np.float32(offset - 0.12) - all_sigma)
            behind = float(all_weight[places].sum())
            if behind < _BEHIND_SHARE * total:
                if _is_tall(at[:, 2], floor_z_m):
                    walls.append(Wall(normal=inward, offset=offset, cells=None))
            elif _is_high(at[:, 2], facing.pixels[on_it], width, floor_z_m):
                sections, inverse = np.unique(_stretches(at, inward), return_inverse=True)
                cells = sections[np.bincount(inverse, weights=facing.weight[on_it]) > _SEEN_M2]
                if len(cells) * _STRETCH_M > _WALL_WIDTH_M:
                    walls.append(Wall(normal=inward, offset=offset, cells=cells))
        if float(left.weight.sum()) < _WALL_AREA_M2:
            break
    return walls


@dataclass(frozen=True, slots=True, eq=False)
class _Upright:
    # N pixels of vertical surface: positions `at` (N, 3), depth sigma, area, horizontal direction (N, 2) and its bin.
    pixels: NDArray[np.int64]
    at: NDArray[np.float32]
    sigma: NDArray[np.float32]
    weight: NDArray[np.float64]
    direction: NDArray[np.float32]
    azimuths: NDArray[np.int64]

    def among(self, mask: NDArray[np.bool_]) -> "_Upright":
        places = np.flatnonzero(mask)
        return _Upright(*(getattr(self, field.name).take(places, axis=0) for field in fields(self)))


def _upright(
    points: NDArray[np.float32], normals: NDArray[np.float32], sigma: NDArray[np.float32], areas: NDArray[np.float32]
) -> _Upright:
    # The pixels with an area and a horizontal normal, of (P, 3) points and normals.
    pixels = np.flatnonzero((np.abs(normals[:, 2]) < 0.2) & (areas > 0))
    direction = np.ascontiguousarray(normals.take(pixels, axis=0)[:, :2])
    direction /= np.sqrt(direction[:, 0] * direction[:, 0] + direction[:, 1] * direction[:, 1])[:, None]
    weight, azimuths = areas[pixels].astype(np.float64), _bins_of_azimuth(direction, _AZIMUTHS)
    return _Upright(pixels, points.take(pixels, axis=0), sigma[pixels], weight, direction, azimuths)


def _bins_of_azimuth(directions: NDArray[np.float32], count: int) -> NDArray[np.int64]:
    # The bin of each direction (N, 2), of `count` equal bins of azimuth from -pi on.
    turns = (portable.arctan2(directions[:, 1], directions[:, 0]) + np.pi) / (2 * np.pi)
    bins = (turns * count).astype(np.int64)
    return np.where(bins < count, bins, 0)


def _is_high(
    heights: NDArray[np.float32],
    pixels: NDArray[np.int64],
    width: int,
    floor_z_m: float | None,
) -> bool:
    # Higher than furniture, or cut by the upper image border, and reaching down.
    if floor_z_m is None:
        return False
    low, high = np.percentile(heights, [2, 98])
    if low - floor_z_m > _WALL_FOOT_M or high - floor_z_m < _WALL_CUT_M:
        return False
    columns = np.unique(pixels % width)
    goes_on = len(np.unique(pixels[pixels < 3 * width] % width)) > 0.3 * len(columns)
    return bool(goes_on or high - floor_z_m > _WALL_HEIGHT_M)


def _is_tall(heights: NDArray[np.float32], floor_z_m: float | None) -> bool:
    # Over 1.3 m above the floor, or over 1 m of it in view.
    low, high = np.percentile(heights, [2, 98])
    return bool((floor_z_m is not None and high - floor_z_m > 1.3) or high - low > 1.0)


_AZIMUTHS = 120


def _dominant_direction(left: _Upright) -> NDArray[np.float32]:
    # The unit direction (2,) of most of the remaining area: a refined peak of the histogram.
    areas = np.bincount(left.azimuths, weights=left.weight, minlength=_AZIMUTHS)
    smooth = areas + 0.7 * (np.roll(areas, 1) + np.roll(areas, -1))
    center = (int(np.argmax(smooth)) + 0.5) / _AZIMUTHS * 2 * np.pi - np.pi
    near = np.flatnonzero(_along(left.direction, np.array([cos(center), sin(center)], dtype=np.float32)) > 0.98)
    weight = left.weight[near]
    mean = portable.matmul(left.direction.take(near, axis=0).T, weight) / weight.sum()
    return (mean / portable.norm(mean)).astype(np.float32)


def _refined(facing: _Upright, normal: NDArray[np.float32], offset: float) -> tuple[NDArray[np.float32], float]:
    # Least squares, twice; an error of a degree is 9 cm on 5 m of wall.
    tolerance_m = 0.05 + 2.0 * facing.sigma
    for _ in range(2):
        near = np.flatnonzero(np.abs(_along(facing.at, normal) - np.float32(offset)) < tolerance_m)
        if len(near) < 20:
            break
        at_near, share = facing.at.take(near, axis=0), facing.weight.take(near)
        middle, spread = _spread(at_near[:, :2], share / share.sum())
        _, axes = portable.eigh(spread)
        across = axes[:, 0] * np.sign(portable.dot(axes[:, 0], normal))
        if portable.dot(across, normal) < 0.98:
            break
        normal, offset = across.astype(np.float32), portable.dot(across, middle)
    return normal, offset


def _spread(at: NDArray[np.float32], share: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # The mean (2,) of (N, 2) places whose shares add up to 1, and the covariance (2, 2).
    columns = at.T.astype(np.float64, order="C")
    middle = portable.matmul(columns, share)
    columns -= middle[:, None]
    return middle, portable.matmul(columns * share, columns.T)


def _peaks(offsets: NDArray[np.float32], facing: _Upright, min_area_m2: float) -> list[float]:
    # The offsets along a normal of up to four planes with enough area, the rearmost first; noise spreads far ones.
    if len(offsets) == 0:
        return []
    weight, bin_m = facing.weight, max(0.02, float(np.median(facing.sigma)))
    low = float(offsets.min()) - 2 * bin_m
    histogram = np.bincount(((offsets - low) / bin_m).astype(np.int64), weights=weight)
    smooth = np.convolve(histogram, np.ones(3), mode="same")
    peaks: list[float] = []
    first = 0
    while len(peaks) < 4:
        enough = np.flatnonzero(smooth[first:] > min_area_m2)
        if len(enough) == 0:
            break
        first += int(enough[0])
        peak = first + int(np.argmax(smooth[first : first + 4]))
        near = np.abs(offsets - (low + (peak + 0.5) * bin_m)) < 1.5 * bin_m
        peaks.append(float(np.average(offsets[near], weights=weight[near])))
        first = peak + 6  # the flank of this peak is not another peak
    return peaks


@kernel
def _along(rows, direction):
    # (N,) the projections of (N, 2) or (N, 3) rows on a horizontal direction (2,), in single precision.
    out = np.empty(len(rows), dtype=np.float32)
    x, y = direction[0], direction[1]
    for i in range(len(rows)):
        out[i] = np.float32(0.0) + rows[i, 0] * x + rows[i, 1] * y
    return out
