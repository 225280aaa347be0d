"""Planning among a scene's boxes, meshes and layer 4: the paper's table of success and efficiency, and more."""
# Boxes (Mesh-OBB), all triangles (Mesh-Full) and layer 4 share robot, margin, walls, rasteriser, and a seeded list of
# starts and goals. These are connected in the true scene (every true triangle) and keep a small distance from it. The
# reference length is the exact shortest path, by a visibility graph.

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from hickory_stream.base.compiled import kernel
from hickory_stream.evaluation.evaluate import placed_mesh, true_mesh_world
from hickory_stream.evaluation.match import meshes_of
from hickory_stream.evaluation.truth import Truth, structure_meshes
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.superquadric import Superquadrics
from hickory_stream.map_folder.saved_map import SavedMap
from hickory_stream.navigation.free_space import FreeSpace, UnknownSpace, layer_four_of, obstacles_of
from hickory_stream.navigation.observed import Band, seen_columns, unknown_hulls
from hickory_stream.navigation.occupancy import GridFrame, distance_field_m, frame_around
from hickory_stream.navigation.robot import Robot
from hickory_stream.navigation.search import Path, SearchConfig, plan
from hickory_stream.storeys import floor_of

MethodName = Literal["mesh-obb", "mesh-full", "layer-4"]
METHOD_NAMES: tuple[MethodName, ...] = ("mesh-obb", "mesh-full", "layer-4")
_MIN_HALF_EXTENT_M = 0.001


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Obstacles:
    """The obstacles of a scene: `meshes` in the world and `inflated`, both by object; walls, and unobserved space."""

    # `load` reads the meshes and is part of the measured time, since a map has them on disk.
    load: Callable[[], Mapping[int, Mesh]]
    inflated: Mapping[int, Superquadrics]
    walls: NDArray[np.float64]
    unknown: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Built:
    """The free space of one method; CPU seconds for reading meshes and for stamping what stands in it."""

    name: MethodName
    space: FreeSpace
    load_s: float
    build_s: float


def built(
    name: MethodName, obstacles: Obstacles, robot: Robot, frame: GridFrame, *, floor_z_m: float, r_safe_m: float
) -> Built:
    """Return the free space according to one method; `r_safe_m` is the margin that layer 4 was inflated by."""
    started = time.process_time()
    meshes = {} if name == "layer-4" else obstacles.load()
    loaded = time.process_time()
    # Hulls, and walls too, get the safety margin here; layer 4 has it built in.
    space = FreeSpace(robot, frame, floor_z_m, hull_margin_m=r_safe_m)
    if name == "layer-4":
        for object_id, inflated in obstacles.inflated.items():
            space.put(object_id, inflated)
    for object_id, mesh in meshes.items():
        if name == "mesh-full":
            space.put_hulls(object_id, triangles(mesh))
        else:
            box = gravity_aligned_box(mesh.vertices, _MIN_HALF_EXTENT_M)
            space.put_hulls(object_id, box.corners_world()[None])
    ended = time.process_time()
    space.observe(obstacles.walls, obstacles.unknown)
    return Built(name=name, space=space, load_s=loaded - started, build_s=ended - loaded)


def triangles(mesh: Mesh) -> NDArray[np.float64]:
    """Return the (F, 3, 3) corners of a mesh's faces."""
    return np.asarray(mesh.vertices.astype(np.float64)[mesh.faces])


_HAIR = 1e-6


class OptimalLengths:
    """The lengths of shortest paths over a grid of blocked cells; everything outside the grid is blocked."""

    def __init__(self, is_blocked: NDArray[np.bool_], frame: GridFrame) -> None:
        self._blocked = np.ascontiguousarray(is_blocked)
        self._frame = frame
        self._corners, self._sides = _bends(self._blocked)
        a, b, lengths = _edges(self._blocked, self._corners, self._sides)
        count = len(self._corners)
        # Two more nodes: start and goal.
        self._rows, self._columns, self._lengths = a, b, lengths
        self._size = count + 2

    def length_m(self, start: NDArray[np.float64], goal: NDArray[np.float64]) -> float:
        """Return the length of the shortest path between two points (2,), infinite if there is none."""
        ends = (np.array([start, goal]) - self._frame.origin_m) / self._frame.cell_m
        direct = float(np.linalg.norm(ends[1] - ends[0]))
        if _sees(self._blocked, ends[0, 0], ends[0, 1], ends[1, 0], ends[1, 1]):
            return direct * self._frame.cell_m
        rows, columns, lengths = [self._rows], [self._columns], [self._lengths]
        for n, end in enumerate(ends):
            seen, far = _seen_from(self._blocked, self._corners, self._sides, end)
            rows.append(np.full(len(seen), self._size - 2 + n))
            columns.append(seen)
            lengths.append(far)
        graph = coo_array(
            (np.concatenate(lengths), (np.concatenate(rows), np.concatenate(columns))), shape=(self._size, self._size)
        ).tocsr()
        found = dijkstra(graph, directed=False, indices=self._size - 2)[self._size - 1]
        return float(found) * self._frame.cell_m


@kernel
def _sees(blocked, x0, y0, x1, y1):
    rows, columns = blocked.shape
    if y1 < y0:
        x0, y0, x1, y1 = x1, y1, x0, y0
    first, last = int(np.floor(y0 + _HAIR)), int(np.floor(y1 - _HAIR))
    if last < first and 0 <= last and first < rows:
        # The segment runs along the line between two rows: it is blocked where both sides are.
        for i in range(
            max(int(np.floor(min(x0, x1) + _HAIR)), 0), min(int(np.floor(max(x0, x1) - _HAIR)) + 1, columns)
        ):
            if blocked[last, i] and blocked[first, i]:
                return False
    first, last = max(first, 0), min(last, rows - 1)
    slope = (x1 - x0) / (y1 - y0) if y1 > y0 else 0.0
    for j in range(first, last + 1):
        xa = x0 if y0 >= j else x0 + slope * (j - y0)
        xb = x1 if y1 <= j + 1 else x0 + slope * (j + 1 - y0)
        left, right = int(np.floor(min(xa, xb) + _HAIR)), int(np.floor(max(xa, xb) - _HAIR))
        for i in range(max(left, 0), min(right, columns - 1) + 1):
            if blocked[j, i]:
                return False
        if right < left and 0 <= right and left < columns and blocked[j, right] and blocked[j, left]:
            return False
        # Two blocked squares that touch at a corner leave no gap between them.
        if j < last:
            x = x0 + slope * (j + 1 - y0)
            i = int(np.round(x))
            if abs(x - i) < _HAIR and 0 < i < columns:
                pair, other = blocked[j, i - 1] and blocked[j + 1, i], blocked[j, i] and blocked[j + 1, i - 1]
                if pair or other:
                    return False
    return True


def _bends(blocked: NDArray[np.bool_]) -> tuple[NDArray[np.float64], NDArray[np.int8]]:
    around = np.pad(blocked, 1, constant_values=True)
    low_left, low_right = around[:-1, :-1], around[:-1, 1:]
    high_left, high_right = around[1:, :-1], around[1:, 1:]
    count = low_left.astype(int) + low_right + high_left + high_right
    rows, columns = np.nonzero(count == 1)
    sides = np.where(low_left[rows, columns] | high_right[rows, columns], 1, -1)
    return np.column_stack([columns, rows]).astype(np.float64), sides.astype(np.int8)


@kernel
def _is_taut(side, dx, dy):
    return side * dx * dy <= 0.0


@kernel
def _edges(blocked, corners, sides):
    most = 1024
    count = 0
    a, b, lengths = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most)
    for m in range(len(corners)):
        for n in range(m):
            dx, dy = corners[m, 0] - corners[n, 0], corners[m, 1] - corners[n, 1]
            if not (_is_taut(sides[m], dx, dy) and _is_taut(sides[n], dx, dy)):
                continue
            if not _sees(blocked, corners[n, 0], corners[n, 1], corners[m, 0], corners[m, 1]):
                continue
            if count == most:
                most *= 2
                a = np.concatenate((a, np.empty(count, np.int64)))
                b = np.concatenate((b, np.empty(count, np.int64)))
                lengths = np.concatenate((lengths, np.empty(count)))
            a[count], b[count], lengths[count] = m, n, np.sqrt(dx * dx + dy * dy)
            count += 1
    return a[:count].copy(), b[:count].copy(), lengths[:count].copy()


@kernel
def _seen_from(blocked, corners, sides, place):
    seen, far = np.empty(len(corners), np.int64), np.empty(len(corners))
    count = 0
    for n in range(len(corners)):
        dx, dy = corners[n, 0] - place[0], corners[n, 1] - place[1]
        if _is_taut(sides[n], dx, dy) and _sees(blocked, place[0], place[1], corners[n, 0], corners[n, 1]):
            seen[count], far[count] = n, np.sqrt(dx * dx + dy * dy)
            count += 1
    return seen[:count].copy(), far[:count].copy()


_OFF_M = 0.1
_LEAST_M = 1.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TrueScene:
    """The true scene on the grid: its free space, the largest connected piece of it, and the shortest paths in it."""

    space: FreeSpace
    is_occupied: NDArray[np.bool_]
    is_reachable: NDArray[np.bool_]
    optimum: OptimalLengths


@dataclass(frozen=True, kw_only=True, slots=True)
class MethodScore:
    """One method on one scene."""

    # `efficiency`: straight over path; `over_optimum`: path over the shortest; means over successes. `free_space`:
    # share of cells in the largest piece. `missed_cells`: called free, touch the true scene; `lost_cells`: reachable,
    # not called free. CPU seconds; `query_s` a pair.
    name: str
    pairs: int
    success: float
    efficiency: float | None
    over_optimum: float | None
    free_space: float
    missed_cells: int
    lost_cells: int
    load_s: float
    build_s: float
    query_s: float


def true_scene(
    objects: Mapping[int, NDArray[np.float64]], structure: Sequence[NDArray[np.float64]], robot: Robot,
    frame: GridFrame, *, floor_z_m: float, r_safe_m: float,
) -> TrueScene:  # fmt: skip
    """Return the truth of a scene: `objects` and `structure` are (F, 3, 3) triangles in the world."""
    # The robot is round, in one posture.
    space = FreeSpace(robot, frame, floor_z_m, hull_margin_m=r_safe_m)
    for object_id, hulls in objects.items():
        space.put_hulls(object_id, hulls)
    space.observe(np.concatenate([np.empty((0, 3, 3)), *structure]), np.empty((0, 8, 3)))
    is_occupied = space.blocked()[0, 0]
    is_reachable = largest_piece(space)
    return TrueScene(
        space=space, is_occupied=is_occupied, is_reachable=is_reachable, optimum=OptimalLengths(~is_reachable, frame)
    )


def largest_piece(space: FreeSpace) -> NDArray[np.bool_]:
    """Return the largest connected piece (rows, columns) of a round robot's free space."""
    labels = space.labels()[0, 0]
    counts = np.bincount(labels.ravel())
    counts[0] = 0
    return np.asarray((labels == int(counts.argmax())) & (labels > 0))


def draw_pairs(truth: TrueScene, count: int, seed: int) -> NDArray[np.float64]:
    """Return (count, 2, 2) starts and goals: at least 1 m apart, 0.1 m off the true obstacles, connected in truth."""
    frame = truth.space.frame
    off = distance_field_m(~truth.is_reachable, frame.cell_m) >= _OFF_M
    cells = np.argwhere(off)
    if len(cells) < 2:
        raise ValueError("the true scene has no room for a start and a goal")
    rng = np.random.default_rng([seed, 9])
    pairs: list[NDArray[np.float64]] = []
    for _ in range(1000 * count):
        ends = frame.origin_m + (cells[rng.integers(len(cells), size=2)][:, ::-1] + 0.5) * frame.cell_m
        if np.linalg.norm(ends[1] - ends[0]) >= _LEAST_M:
            pairs.append(ends)
        if len(pairs) == count:
            return np.array(pairs)
    raise ValueError(f"the true scene is too small for starts and goals {_LEAST_M} m apart")


def score(
    method: Built, truth: TrueScene, pairs: NDArray[np.float64], optimal_m: NDArray[np.float64], config: SearchConfig
) -> MethodScore:
    straight = np.linalg.norm(pairs[:, 1] - pairs[:, 0], axis=1)
    lengths = np.full(len(pairs), np.nan)
    started = time.process_time()
    for i, (start, goal) in enumerate(pairs):
        answer = plan(method.space, start, goal, config, np.random.default_rng(i))
        if isinstance(answer, Path):
            lengths[i] = answer.length_m
    query_s = (time.process_time() - started) / max(len(pairs), 1)
    found = np.isfinite(lengths)
    is_free = ~method.space.blocked()[0, 0]
    piece = largest_piece(method.space)
    return MethodScore(
        name=method.name, pairs=len(pairs), success=float(found.mean()),
        efficiency=float((straight[found] / lengths[found]).mean()) if found.any() else None,
        over_optimum=float((lengths[found] / optimal_m[found]).mean()) if found.any() else None,
        free_space=float(piece.mean()), missed_cells=int((truth.is_occupied & is_free).sum()),
        lost_cells=int((truth.is_reachable & ~is_free).sum()), load_s=method.load_s, build_s=method.build_s,
        query_s=query_s,
    )  # fmt: skip


def table_of(
    obstacles: Obstacles, truth: TrueScene, robot: Robot, *, r_safe_m: float, trials: int, seeds: Sequence[int],
    config: SearchConfig | None = None,
) -> list[MethodScore]:  # fmt: skip
    pairs = np.concatenate([draw_pairs(truth, trials, seed) for seed in seeds])
    optimal = np.array([truth.optimum.length_m(start, goal) for start, goal in pairs])
    frame, floor = truth.space.frame, truth.space.floor_z_m
    rows = []
    for name in METHOD_NAMES:
        method = built(name, obstacles, robot, frame, floor_z_m=floor, r_safe_m=r_safe_m)
        rows.append(score(method, truth, pairs, optimal, config or SearchConfig()))
    return rows


def table_json(rows: Sequence[MethodScore]) -> list[dict[str, Any]]:
    return [asdict(row) for row in rows]


def format_table(rows: Sequence[MethodScore]) -> str:
    lines = [
        f"{'method':<10} {'success':>8} {'straight/path':>14} {'path/optimum':>13} {'free':>6} {'missed':>7}"
        f" {'lost':>6} {'load s':>8} {'build s':>8} {'query ms':>9}"
    ]
    for row in rows:
        efficiency = "-" if row.efficiency is None else f"{row.efficiency:.3f}"
        over = "-" if row.over_optimum is None else f"{row.over_optimum:.3f}"
        lines.append(
            f"{row.name:<10} {100 * row.success:>7.1f}% {efficiency:>14} {over:>13} {row.free_space:>6.3f} "
            f"{row.missed_cells:>7} {row.lost_cells:>6} {row.load_s:>8.3f} {row.build_s:>8.3f} "
            f"{1e3 * row.query_s:>9.2f}"
        )
    lines.append(
        f"{rows[0].pairs} pairs; missed: cells of the true scene called free; lost: reachable ones that are not"
    )
    return "\n".join(lines)


R_SAFE_M = 0.02


def truth_of(truth: Truth, robot: Robot, *, cell_m: float, floor_z_m: float, r_safe_m: float = R_SAFE_M) -> TrueScene:
    """Return the true scene on a grid that spans its structure, or its objects if it has no structure."""
    structure = [triangles(mesh) for mesh in structure_meshes(truth)]
    objects = {item.id: triangles(true_mesh_world(truth, item)) for item in truth.objects}
    corners = np.concatenate([hulls.reshape(-1, 3) for hulls in (structure or list(objects.values()))])
    frame = frame_around(corners.min(axis=0), corners.max(axis=0), cell_m)
    return true_scene(objects, structure, robot, frame, floor_z_m=floor_z_m, r_safe_m=r_safe_m)


def true_obstacles(truth: Truth, inflated: Mapping[int, Superquadrics]) -> Obstacles:
    """Return the true objects as obstacles, with a layer 4 made of their true meshes; walls are the true ones."""
    walls = [np.empty((0, 3, 3)), *(triangles(mesh) for mesh in structure_meshes(truth))]
    return Obstacles(
        load=lambda: {item.id: true_mesh_world(truth, item) for item in truth.objects},
        inflated=inflated,
        walls=np.concatenate(walls),
        unknown=np.empty((0, 8, 3)),
    )


def score_saved_map(
    saved: SavedMap, truth: Truth, robot: Robot, *, cell_m: float, unknown: UnknownSpace, trials: int,
    seeds: Sequence[int],
) -> list[MethodScore]:  # fmt: skip
    """Return the table of a map that the pipeline made; all methods are given its observed walls and unknown space."""
    # The map must be in the frame of the truth, as it is if its log was played with true poses.
    robot = replace(robot, postures=robot.postures[:1])
    snapshot = saved.snapshot
    floor = floor_of(snapshot)
    margins = [tracked.shape.containment.margin_m for tracked in snapshot.objects if tracked.shape is not None]
    r_safe = float(np.median(margins)) if margins else R_SAFE_M
    scene = truth_of(truth, robot, cell_m=cell_m, floor_z_m=floor, r_safe_m=r_safe)
    frame = scene.space.frame
    parts = [part for headings in scene.space.parts for parts in headings for part in parts]
    band = Band(
        low_m=min(part.low_m - part.ball_m for part in parts), high_m=max(part.high_m + part.ball_m for part in parts)
    )
    seen = seen_columns(snapshot.submaps, frame, band, floor)
    obstacles = Obstacles(
        load=lambda: _placed_meshes(saved),
        inflated={tracked.id: layer_four_of(tracked) for tracked in obstacles_of(snapshot)},
        walls=seen.walls,
        unknown=unknown_hulls(seen.is_known, frame, band) if unknown == "blocked" else np.empty((0, 8, 3)),
    )
    return table_of(obstacles, scene, robot, r_safe_m=r_safe, trials=trials, seeds=seeds)


def _placed_meshes(saved: SavedMap) -> dict[int, Mesh]:
    meshes = meshes_of(saved)
    placed = ((tracked.id, placed_mesh(tracked, meshes)) for tracked in obstacles_of(saved.snapshot))
    return {object_id: mesh for object_id, mesh in placed if mesh is not None}
