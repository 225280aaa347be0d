"""Routes over free floor, and a tour through all rooms of an apartment."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter1d, label

from hickory_stream.geometry.rigid import apply
from hickory_stream.worlds.clearance import CELL_M, HEAD_M, Clearance, clearance_of
from hickory_stream.worlds.scene import World
from hickory_stream.worlds.trajectory import STEP_S, NoWalk, Trajectory, WalkConfig, camera_poses, gaze

_STEP_M = 0.12


def way_between(clearance: Clearance, a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return a short path (N, 2) with clearance between two positions, None if there is none."""
    from skimage.graph import route_through_array

    distance = clearance.distance_m
    cost = np.where(distance >= 0.2, 1.0 + 6.0 * np.maximum(0.0, 0.5 - distance) / 0.5, 1e6)
    cells, total = route_through_array(cost, clearance.cell(a), clearance.cell(b), geometric=True)
    if total >= 1e6:
        return None
    return clearance.origin_m + CELL_M * np.array(cells, dtype=np.float64)


def smoothed(route: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a closed route smoothed over about a third of a metre, to remove the steps of the grid."""
    line = gaussian_filter1d(route, 8.0, axis=0, mode="wrap")
    return np.vstack([line, line[:1]])


def clearance_of_surfaces(world: World) -> Clearance:
    """Return the clearance of a world of any meshes: free is floor at z = 0 with no surface up to 1.8 m above it."""
    # A doorstep can be walked over.
    x0, y0, x1, y1 = world.interior_m
    shape = (int(np.ceil((x1 - x0) / CELL_M)), int(np.ceil((y1 - y0) / CELL_M)))
    has_floor, is_blocked = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
    placed = [(model, np.eye(4)) for model in world.structure]
    placed += [(item.model, item.world_from_object) for item in world.objects]
    for model, world_from_model in placed:
        for part in model.parts:
            points = _points_on(apply(world_from_model, part.vertices)[part.faces], CELL_M / 2)
            cells = np.floor((points[:, :2] - (x0, y0)) / CELL_M).astype(np.int64)
            inside = ((cells >= 0) & (cells < shape)).all(axis=1)
            cells, height_m = cells[inside], points[inside, 2]
            low, high = cells[np.abs(height_m) <= _STEP_M], cells[(height_m > _STEP_M) & (height_m < HEAD_M)]
            has_floor[low[:, 0], low[:, 1]] = True
            is_blocked[high[:, 0], high[:, 1]] = True
    distance = distance_transform_edt(np.pad(has_floor & ~is_blocked, 1))[1:-1, 1:-1] * CELL_M
    return Clearance(distance_m=distance, origin_m=np.array([x0, y0]))


def _points_on(triangles: NDArray[np.float64], spacing_m: float) -> NDArray[np.float64]:
    # Points (N, 3) on (F, 3, 3) triangles, on each of them on a grid of at most the spacing.
    a, edges = triangles[:, 0], triangles[:, 1:] - triangles[:, :1]
    sides_m = np.linalg.norm(np.concatenate([edges, edges[:, 1:] - edges[:, :1]], axis=1), axis=2)
    steps = np.maximum(1, np.ceil(sides_m.max(axis=1, initial=0.0) / spacing_m)).astype(np.int64)
    points = [np.empty((0, 3))]
    for count in np.unique(steps):
        chosen = steps == count
        u, v = np.meshgrid(*2 * [np.linspace(0.0, 1.0, count + 1)], indexing="ij")
        weights = np.stack([u, v], axis=-1).reshape(-1, 2)
        weights = weights[weights.sum(axis=1) <= 1.0 + 1e-9]
        points.append((a[chosen, None] + weights @ edges[chosen]).reshape(-1, 3))
    return np.concatenate(points)


def joins_rooms(world: World, clearance_m: float) -> bool:
    """Return whether one connected area of a given clearance reaches every room, to half a metre from its walls."""
    clearance = clearance_of(world)
    pieces, count = label(clearance.distance_m >= clearance_m)
    xs = clearance.origin_m[0] + CELL_M * np.arange(pieces.shape[0])
    ys = clearance.origin_m[1] + CELL_M * np.arange(pieces.shape[1])
    common = set(range(1, count + 1))
    for x0, y0, x1, y1 in world.rooms_m:
        within = pieces[np.ix_((xs > x0 + 0.5) & (xs < x1 - 0.5), (ys > y0 + 0.5) & (ys < y1 - 0.5))]
        common &= set(np.unique(within[within > 0]).tolist())
    return bool(common)


_MIN_SECONDS = 60.0
# The rooms are a grid of two by two: in this order, consecutive rooms are neighbours.
_ROUND = (0, 1, 3, 2)


def tour(world: World, seconds: float | None, config: WalkConfig, walk_index: int) -> Trajectory | NoWalk:
    """Return a walk through all rooms; `walk_index` selects its start and direction."""
    # `seconds` None is the duration of the tour, and at least a minute.
    clearance = clearance_of(world)
    route = _route(world, clearance, walk_index)
    if route is None:
        return NoWalk(clearance_m=0.0)
    line = smoothed(route)
    clearance_m = float(clearance.at(line).min())
    if clearance_m < 0.6 * config.clearance_m:
        return NoWalk(clearance_m=clearance_m)
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    speed = config.speed_mps
    lasts = max(arc[-1] / speed, _MIN_SECONDS) if seconds is None else seconds
    times_s = np.arange(0.0, lasts + 2 * STEP_S, STEP_S)
    # Back and forth if the time is longer than the tour.
    on = arc[-1] - np.abs(np.mod(speed * times_s, 2 * arc[-1]) - arc[-1])
    positions = np.stack([np.interp(on, arc, line[:, i]) for i in range(2)], axis=1)
    yaw, pitch = gaze(world, positions, STEP_S, config)
    return Trajectory(times_s=times_s, world_from_camera=camera_poses(times_s, positions, yaw, pitch, config))


def _route(world: World, clearance: Clearance, walk_index: int) -> NDArray[np.float64] | None:
    order: tuple[int, ...] = _ROUND if walk_index % 2 == 0 else _ROUND[::-1]
    start = (walk_index // 2 + walk_index) % len(order)
    order = order[start:] + order[:start]
    stops: list[NDArray[np.float64]] = []
    for room in order:
        corners = corners_of(world.rooms_m[room], clearance)
        if walk_index % 2:
            corners = corners[::-1]
        if stops and len(corners):
            nearest = int(np.argmin(np.linalg.norm(np.array(corners) - stops[-1], axis=1)))
            corners = corners[nearest:] + corners[:nearest]
        stops += corners
    if not stops:
        return None
    pieces = [way_between(clearance, a, b) for a, b in zip(stops, [*stops[1:], stops[0]], strict=True)]
    if any(piece is None for piece in pieces):
        return None
    return np.concatenate([piece[:-1] for piece in pieces if piece is not None])


def corners_of(room: tuple[float, float, float, float], clearance: Clearance) -> list[NDArray[np.float64]]:
    """Return a free position in each quarter of a room, counter-clockwise; quarters full of furniture have none."""
    x0, y0, x1, y1 = room
    places = []
    for fx, fy in ((0.3, 0.3), (0.7, 0.3), (0.7, 0.7), (0.3, 0.7)):
        wanted = np.array([x0 + fx * (x1 - x0), y0 + fy * (y1 - y0)])
        spread = np.arange(-0.8, 0.81, CELL_M)
        grid = wanted + np.stack(np.meshgrid(spread, spread, indexing="ij"), axis=-1).reshape(-1, 2)
        clear = clearance.at(grid)
        value = np.minimum(clear, 0.6) - 0.25 * np.linalg.norm(grid - wanted, axis=1)
        best = int(np.argmax(value))
        if clear[best] >= 0.32:
            places.append(grid[best])
    return places
