"""One view of a map, drawn and shaded on the CPU.

Light: a headlight, a sun and an ambient sky with ambient occlusion. Walls fade towards their tops, the floor where it
was not seen.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from hickory_stream.geometry.arrays import freeze
from hickory_stream.pictures.rasterize import Dots, first_hits
from hickory_stream.pictures.raycast import Hits, Scene, Surface
from hickory_stream.pictures.render_parts import LEVEL_M, coarse, coarse_squares, wall_surface
from hickory_stream.pictures.viewpoint import Viewpoint
from hickory_stream.records import Submap

_BACKGROUND = np.array([[0.93, 0.94, 0.96], [0.985, 0.985, 0.99]], dtype=np.float32)
_FLOOR, _GRID = np.array([[0.87, 0.865, 0.85], [0.74, 0.735, 0.72]], dtype=np.float32)
_SHADE_REACH_M = 0.45
_CELL_M = 0.05
_NOWHERE = np.empty((0, 3))
# The floor is uneven if more than this share of its cells is not level; its heights are means over some decimetres. Of
# rooms a twentieth is not level: scraps of walls and furniture.
_UNEVEN_SHARE, _SMOOTH_CELLS = 0.1, 4.0
# A ray meets uneven ground after so many steps, each to the height below the one before.
_STEPS = 4
_SHADE_RAYS = 16
_EDGE_CONTRAST = 0.04
# Sample positions in a pixel: its middle, and a rotated grid whose four points nearly horizontal or vertical edges pass
# one by one.
_SAMPLES = np.array([[0, 0], [-0.125, -0.375], [0.375, -0.125], [0.125, 0.375], [-0.375, 0.125]], dtype=np.float32)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Floor:
    """The ground: from `origin_m` on, (H, W) how much of each cell was seen, and (H, W) its height."""

    origin_m: NDArray[np.float64]
    weights: NDArray[np.float32]
    heights_m: NDArray[np.float32]

    def __post_init__(self) -> None:
        freeze(self, "origin_m", np.float64, (2,))
        freeze(self, "weights", np.float32, (None, None))
        freeze(self, "heights_m", np.float32, self.weights.shape)

    def at(self, values: NDArray[np.float32], places: NDArray[Any]) -> NDArray[np.float32]:
        """Return (N,) values of the cells at (N, 2) places."""
        column, row = ((places - self.origin_m) / _CELL_M - 0.5).T
        return np.asarray(map_coordinates(values, [row, column], order=1, output=np.float32, mode="nearest"))

    def above_m(self, points: NDArray[Any]) -> NDArray[np.float32]:
        """Return (N,) the heights of (N, 3) points above the ground."""
        return np.asarray(points[:, 2] - self.at(self.heights_m, points[:, :2]), dtype=np.float32)


def floor_around(corners: NDArray[np.float64], z_m: float, seen: NDArray[np.float64] = _NOWHERE) -> Floor:
    """Return the floor below (N, 3) corners: where (M, 3) points of it were seen, or all of it without any."""
    import cv2

    margin_m = 0.5
    around = np.concatenate([corners[:, :2], seen[:, :2]])
    origin = around.min(axis=0) - margin_m
    columns, rows = np.ceil((around.max(axis=0) + margin_m - origin) / _CELL_M).astype(int)
    weights, sums = np.zeros((2, rows, columns), dtype=np.float32)
    heights = np.full((rows, columns), z_m, dtype=np.float32)
    if len(seen):
        x, y = ((seen[:, :2] - origin) / _CELL_M).astype(int).T
        np.add.at(weights, (y, x), np.float32(1))
        np.add.at(sums, (y, x), (seen[:, 2] - z_m).astype(np.float32))
        is_off = np.abs(seen[:, 2] - z_m) > LEVEL_M
        if len(np.unique(y[is_off] * columns + x[is_off])) > _UNEVEN_SHARE * np.count_nonzero(weights):
            # Also between and beside what was seen.
            near, off = (cv2.GaussianBlur(cells, (0, 0), _SMOOTH_CELLS) for cells in (weights, sums))
            heights += off / np.maximum(near, np.float32(1e-6))
        weights = cv2.morphologyEx(np.minimum(weights, 1), cv2.MORPH_CLOSE, np.ones((9, 9), np.uint8))
    else:
        weights[6:-6, 6:-6] = 1.0
    return Floor(origin_m=origin, weights=cv2.GaussianBlur(weights, (0, 0), 1.2), heights_m=heights)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Model:
    """The parts of a picture that do not depend on the viewpoint; `points` is layer 1."""

    solid: list[Surface]
    translucent: list[Surface]
    points: list[Dots]
    submaps: tuple[Submap, ...]
    floor: Floor


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Seen:
    # First hits of each kind of surface at the same places.
    solid: Hits
    walls: Hits
    glass: Hits

    def part(self, chosen: NDArray[np.int64]) -> "_Seen":
        return _Seen(solid=self.solid.part(chosen), walls=self.walls.part(chosen), glass=self.glass.part(chosen))


def draw_view(model: Model, viewpoint: Viewpoint) -> NDArray[np.uint8]:
    """Return the (H, W, 3) picture from one viewpoint: one sample per pixel, and four more at edges of colour."""
    walls = [wall_surface(submap, model.floor.above_m, viewpoint) for submap in model.submaps]
    drawn = [(model.solid, model.points), (walls, []), (model.translucent, [])]
    kinds = [first_hits(surfaces, dots, viewpoint, within_px=_SAMPLES) for surfaces, dots in drawn]
    seen = [_Seen(solid=solid, walls=wall, glass=glass) for solid, wall, glass in zip(*kinds, strict=True)]
    centers = viewpoint.centers_px()
    shade = _shade_of(_shading(model, viewpoint), model.floor, viewpoint).reshape(-1)
    image = _colors(seen[0], model.floor, viewpoint, centers, shade)
    edges = np.flatnonzero(_is_edge(image.reshape(viewpoint.height, viewpoint.width, 3)))
    finer = [
        _colors(one.part(edges), model.floor, viewpoint, centers[edges] + place, shade[edges])
        for one, place in zip(seen[1:], _SAMPLES[1:], strict=True)
    ]
    image[edges] = np.mean(finer, axis=0)
    pixels: NDArray[np.uint8] = np.clip(image * 255 + 0.5, 0, 255).astype(np.uint8)
    return pixels.reshape(viewpoint.height, viewpoint.width, 3)


def _shading(model: Model, viewpoint: Viewpoint) -> Scene:
    # Objects without layer 1 in the picture occlude the sky with their points.
    drawn = {surface.owner for surface in model.solid}
    squares = [coarse_squares(dots, viewpoint) for dots in model.points if dots.owner not in drawn]
    return Scene([*(coarse(surface, viewpoint) for surface in model.solid), *squares])


def _colors(
    seen: _Seen, floor: Floor, viewpoint: Viewpoint, places_px: NDArray[np.float32], shade: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the (N, 3) float32 colours in 0..1 at (N, 2) image positions; `shade` (N,) is their ambient light."""
    origins, directions = viewpoint.rays(places_px)
    floor_m = _floor_distance(floor, origins, directions)
    solid, walls, glass = seen.solid, seen.walls, seen.glass

    down = (places_px[:, 1:] / viewpoint.height).astype(np.float32)
    color = _mixed(_BACKGROUND[0], _BACKGROUND[1], down)
    floor_color, weight = _floor_color(floor, origins, directions, floor_m, viewpoint)
    color = _mixed(color, floor_color * shade[:, None], weight)
    color = _mixed(color, walls.colors * _wall_light(walls.normals), _wall_weight(walls, floor, origins, directions))
    # In the view from above, walls are drawn as a plan on the floor, below everything else.
    is_object = np.isfinite(solid.distance_m)
    if not viewpoint.is_orthographic:
        is_object &= solid.distance_m < walls.distance_m
    lit = _lit(solid.colors, solid.normals, directions) * shade[:, None]
    color = np.where(is_object[:, None], lit, color)
    is_over = np.isfinite(glass.distance_m) & (glass.distance_m < solid.distance_m)
    rim = 1 - np.abs(np.einsum("nc,nc->n", glass.normals, directions))
    opacity = (0.22 + 0.5 * rim**3) * is_over
    return np.asarray(_mixed(color, _lit(glass.colors, glass.normals, directions), opacity[:, None]), dtype=np.float32)


def _is_edge(image: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return (H, W) the pixels whose neighbourhood is not of one colour."""
    import cv2

    around = np.ones((3, 3), np.uint8)
    return np.asarray((cv2.dilate(image, around) - cv2.erode(image, around)).max(axis=2) > _EDGE_CONTRAST)


def _mixed(below: NDArray[Any], above: NDArray[Any], weight: NDArray[Any]) -> NDArray[Any]:
    return below + (above - below) * weight


def _lit(
    colors: NDArray[np.float32], normals: NDArray[np.float32], directions: NDArray[np.float32]
) -> NDArray[np.float32]:
    sun = np.array([0.35, -0.5, 0.79], dtype=np.float32)
    sky = 0.5 + 0.5 * normals[:, 2]
    eye = np.maximum(-np.einsum("nc,nc->n", normals, directions), 0)
    light = 0.32 + 0.22 * sky + 0.34 * np.maximum(normals @ sun, 0) + 0.26 * eye
    return np.asarray(colors * light[:, None])


# ---- the floor ------------------------------------------------------------------------------------------------------


def _floor_distance(floor: Floor, origins: NDArray[np.float32], directions: NDArray[np.float32]) -> NDArray[np.float32]:
    down = directions[:, 2] < -1e-6
    rise = np.where(down, directions[:, 2], -1.0)
    distance = (floor.heights_m[0, 0] - origins[:, 2]) / rise
    for _ in range(_STEPS * bool(np.ptp(floor.heights_m))):
        distance -= floor.above_m(origins + directions * distance[:, None]) / rise
    return np.where(down & (distance > 0), distance, np.inf).astype(np.float32)


def _floor_color(
    floor: Floor,
    origins: NDArray[np.float32],
    directions: NDArray[np.float32],
    distance_m: NDArray[np.float32],
    viewpoint: Viewpoint,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the colour (N, 3) of the floor with a grid of 1 m, and its opacity (N, 1)."""
    is_floor = np.isfinite(distance_m)
    reach = np.where(is_floor, distance_m, 0)[:, None]
    places = (origins + directions * reach)[:, :2]
    pixel_m = (1.0 if viewpoint.is_orthographic else reach) / viewpoint.focal_px
    off_line = np.abs(places - np.round(places))
    line = np.clip(1.2 - off_line / np.maximum(pixel_m, 0.004), 0, 1).max(axis=1, keepdims=True)
    weight = floor.at(floor.weights, places) * is_floor
    return _mixed(_FLOOR, _GRID, line).astype(np.float32), weight[:, None]


def _wall_light(normals: NDArray[np.float32]) -> NDArray[np.float32]:
    # Brightness (N, 1) varies with direction, so that corners are visible.
    return np.asarray(0.95 + 0.04 * normals[:, :1] + 0.02 * normals[:, 1:2])


def _wall_weight(
    walls: Hits, floor: Floor, origins: NDArray[np.float32], directions: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the opacity (N, 1) of walls, which decreases towards their tops."""
    reach = np.where(np.isfinite(walls.distance_m), walls.distance_m, 0)[:, None]
    height_m = floor.above_m(origins + directions * reach)
    fading = np.where(directions[:, 2] < -0.99, 0.9, np.clip(1 - height_m / 2.2, 0.1, 1))
    return np.asarray((np.isfinite(walls.distance_m) * fading)[:, None], dtype=np.float32)


# ---- shade ----------------------------------------------------------------------------------------------------------


def _shade_of(scene: Scene, floor: Floor, viewpoint: Viewpoint) -> NDArray[np.float32]:
    # Visible part of the sky (H, W) in 0..1. Every fourth pixel is computed; the sample directions rotate in a 4 x 4
    # pattern, which a blur of that size removes.
    import cv2

    columns, rows = viewpoint.width // 2, viewpoint.height // 2
    column, row = np.meshgrid(np.arange(columns), np.arange(rows))
    origins, directions = viewpoint.rays(np.stack([2 * column.reshape(-1) + 1, 2 * row.reshape(-1) + 1], axis=1))
    hits = scene.cast(origins, directions)
    floor_m = _floor_distance(floor, origins, directions)
    distance = np.minimum(hits.distance_m, floor_m)
    surface = np.flatnonzero(np.isfinite(distance))
    on_floor = (floor_m <= hits.distance_m)[surface, None]
    normals = np.where(on_floor, np.array([0, 0, 1], dtype=np.float32), hits.normals[surface])
    points = origins[surface] + directions[surface] * distance[surface, None] + normals * np.float32(0.004)
    turn_rad = ((row % 4 * 4 + column * 5 % 4).reshape(-1)[surface] * (2 * np.pi / 16)).astype(np.float32)
    hidden = np.zeros(len(surface), dtype=np.float32)
    for ray in _sky_directions(_SHADE_RAYS):
        towards = _turned(ray, turn_rad) + normals * np.float32(1.02)
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        hidden += scene.is_occluded(points, towards, _SHADE_REACH_M)
    shade = np.ones(rows * columns, dtype=np.float32)
    shade[surface] = 1 - 0.75 * hidden / _SHADE_RAYS
    blurred = cv2.blur(shade.reshape(rows, columns), (4, 4))
    return np.asarray(cv2.resize(blurred, (viewpoint.width, viewpoint.height), interpolation=cv2.INTER_LINEAR))


def _sky_directions(count: int) -> NDArray[np.float32]:
    """Return (count, 3) uniform directions on the sphere; added to a unit normal they are cosine-weighted around it."""
    i = np.arange(count) + 0.5
    z = 1 - 2 * i / count
    angle = np.pi * (1 + 5**0.5) * i
    radius = np.sqrt(1 - z**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1).astype(np.float32)


def _turned(ray: NDArray[np.float32], turn_rad: NDArray[np.float32]) -> NDArray[np.float32]:
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    x, y, z = ray
    return np.stack([c * x - s * y, s * x + c * y, np.full(len(turn_rad), z)], axis=1)
