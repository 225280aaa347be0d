"""Planning among a scene's boxes, meshes and layer 4: the paper's table of success and efficiency, and more."""
# All methods are given the same robot, the same margin and the same seeded list of starts and goals. These are
# connected in the true scene and keep a small distance from its obstacles, as robots do. The true scene is every true
# triangle, those of walls included. Scenes to plan in: from a truth folder, and from a saved map as boxes, meshes or
# layer 4.

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.evaluation.evaluate import placed_mesh, true_mesh_world
from hickory_stream.evaluation.match import meshes_of
from hickory_stream.evaluation.truth import Truth, structure_meshes
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.superquadric import Superquadrics
from hickory_stream.map_folder.saved_map import SavedMap
from hickory_stream.navigation.free_space import FreeSpace, UnknownSpace, layer_four_of, obstacles_of
from hickory_stream.navigation.observed import Band, seen_columns, unknown_hulls
from hickory_stream.navigation.occupancy import GridFrame, distance_field_m, frame_around
from hickory_stream.navigation.robot import Robot
from hickory_stream.navigation.search import Path, SearchConfig, plan
from hickory_stream.storeys import floor_of
from tools.evaluation.navigation_methods import METHOD_NAMES, Built, Obstacles, built, triangles
from tools.evaluation.navigation_optimum import OptimalLengths

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

    # `success` is the share of pairs with a path; `efficiency` is straight-line distance over path length,
    # `over_optimum` path length over the shortest path of the true scene, both means over the successes, None without
    # any. `free_space` is the share of all cells in the largest connected piece. `missed_cells` are called free but
    # touch the true scene; `lost_cells` are reachable in the true scene but not called free. Seconds are CPU seconds;
    # `query_s` is the mean per pair.
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
    objects: Mapping[int, NDArray[np.float64]],
    structure: Sequence[NDArray[np.float64]],
    robot: Robot,
    frame: GridFrame,
    *,
    floor_z_m: float,
    r_safe_m: float,
) -> TrueScene:
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
    import time

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
        name=method.name,
        pairs=len(pairs),
        success=float(found.mean()),
        efficiency=float((straight[found] / lengths[found]).mean()) if found.any() else None,
        over_optimum=float((lengths[found] / optimal_m[found]).mean()) if found.any() else None,
        free_space=float(piece.mean()),
        missed_cells=int((truth.is_occupied & is_free).sum()),
        lost_cells=int((truth.is_reachable & ~is_free).sum()),
        load_s=method.load_s,
        build_s=method.build_s,
        query_s=query_s,
    )


def table_of(
    obstacles: Obstacles,
    truth: TrueScene,
    robot: Robot,
    *,
    r_safe_m: float,
    trials: int,
    seeds: Sequence[int],
    config: SearchConfig | None = None,
) -> list[MethodScore]:
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


def first_posture(robot: Robot) -> Robot:
    return replace(robot, postures=robot.postures[:1])


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
    saved: SavedMap,
    truth: Truth,
    robot: Robot,
    *,
    cell_m: float,
    unknown: UnknownSpace,
    trials: int,
    seeds: Sequence[int],
) -> list[MethodScore]:
    """Return the table of a map that the pipeline made; all methods are given its observed walls and unknown space."""
    # The map must be in the frame of the truth, as it is if its log was played with true poses.
    robot = first_posture(robot)
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
