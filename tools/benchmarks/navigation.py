"""Planning on boxes, meshes and layer 4 of the four apartments; how fast grids and paths are, in CPU seconds.

Layer 4 is made of the true meshes, so that what is compared is the shapes; then, where the whole pipeline's maps are at
hand (a full run plays the logs for them), the same table of those, with what was not seen as unknown.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from hickory_stream.evaluation.evaluate import true_mesh_world
from hickory_stream.evaluation.truth import Truth, load_truth
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.navigation.free_space import CELL_M
from hickory_stream.navigation.occupancy import Occupancy, distance_field_m
from hickory_stream.navigation.robot import load_robot
from hickory_stream.navigation.search import NoPath, Path, first_path, plan
from hickory_stream.shapes.inflate.inflation import InflateConfig
from tools.benchmarks.apartment_maps import apartment_map, apartment_recording
from tools.benchmarks.figures import Figure, Options
from tools.benchmarks.true_shapes import true_inflated
from tools.evaluation.navigation_methods import built
from tools.evaluation.navigation_table import (
    R_SAFE_M,
    MethodScore,
    TrueScene,
    draw_pairs,
    format_table,
    score_saved_map,
    table_of,
    true_obstacles,
    truth_of,
)
from tools.worlds.cache import cached_recording

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from hickory_stream.navigation.robot import Robot
    from tools.evaluation.navigation_methods import Obstacles

_APARTMENTS = 4
_TABLES = ("table", "desk", "coffee_table", "side_table")
Better = Literal["higher", "lower"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Speeds:
    """CPU seconds of one scene: the grid of all objects, one object's update, and each first path."""

    grid_s: float
    field_s: float
    update_s: list[float]
    first_path_s: list[float]


def measure(options: Options) -> list[Figure]:
    """Return the figures, and print a table per scene; a quick run takes one scene and fewer pairs."""
    robot = load_robot("point")
    trials, seeds = (25, range(1)) if options.quick else (100, range(5))
    scenes = _scenes(options)
    rows: list[list[MethodScore]] = []
    speeds: list[Speeds] = []
    under: list[list[bool]] = []
    for truth in scenes:
        obstacles = true_obstacles(truth, true_inflated(truth, InflateConfig(r_safe_m=R_SAFE_M)))
        scene = truth_of(truth, robot, cell_m=CELL_M, floor_z_m=0.0)
        rows.append(
            table_of(
                obstacles,
                scene,
                robot,
                r_safe_m=R_SAFE_M,
                trials=trials,
                seeds=[options.seed * len(seeds) + i for i in seeds],
            )
        )
        print(f"{truth.folder.name}, layer 4 of the true meshes\n{format_table(rows[-1])}", flush=True)
        speeds.append(_speeds(obstacles, scene, robot, draw_pairs(scene, trials, options.seed)))
        under.append(_under_tables(truth, obstacles, scene, robot))
    with_one = [any(tables) for tables in under if tables]
    if not all(with_one):
        raise AssertionError("in a scene with room under a table no path was found there")
    figures = [
        _figure("scenes", len(scenes), "", "higher"),
        _figure("pairs", sum(scene_rows[0].pairs for scene_rows in rows), "", "higher"),
        *_of_rows(rows, prefix=""),
        *_of_speeds(speeds),
    ]
    if with_one:
        figures.append(_figure("under_table_found_fraction", np.mean(with_one), "", "higher"))
        each = [found for tables in under for found in tables]
        figures.append(_figure("under_each_table_found_fraction", np.mean(each), "", "higher"))
    return figures + ([] if options.scenes else _of_maps(options, robot, trials, seeds))


def _scenes(options: Options) -> list[Truth]:
    if options.scenes:
        return [load_truth(folder) for folder in options.scenes]
    count = 1 if options.quick else _APARTMENTS
    return [cached_recording(apartment_recording(1000 + i, 0))[1] for i in range(count)]


def _of_rows(rows: list[list[MethodScore]], *, prefix: str) -> list[Figure]:
    by_method = {scores[0].name: list(scores) for scores in zip(*rows, strict=True)}
    ours, full, boxes = by_method["layer-4"], by_method["mesh-full"], by_method["mesh-obb"]
    cells = [
        _figure("missed_cells", sum(row.missed_cells for row in ours), "", "lower"),
        _figure("lost_cells", sum(row.lost_cells for row in ours), "", "lower"),
        _figure("missed_cells_full_mesh", sum(row.missed_cells for row in full), "", "lower"),
        _figure("missed_cells_obb", sum(row.missed_cells for row in boxes), "", "lower"),
        _figure("lost_cells_obb", sum(row.lost_cells for row in boxes), "", "lower"),
    ]
    figures = [
        _figure("success_pct", 100 * _mean(row.success for row in ours), "%", "higher"),
        _figure("success_pct_full_mesh", 100 * _mean(row.success for row in full), "%", "higher"),
        _figure("success_pct_obb", 100 * _mean(row.success for row in boxes), "%", "higher"),
        _figure("efficiency", _mean(row.efficiency for row in ours), "", "higher"),
        _figure("efficiency_full_mesh", _mean(row.efficiency for row in full), "", "higher"),
        _figure("efficiency_obb", _mean(row.efficiency for row in boxes), "", "higher"),
        _figure("path_over_optimum", _mean(row.over_optimum for row in ours), "x", "lower"),
        _figure("free_space", _mean(row.free_space for row in ours), "", "higher"),
        _figure("free_space_full_mesh", _mean(row.free_space for row in full), "", "higher"),
        _figure("free_space_obb", _mean(row.free_space for row in boxes), "", "higher"),
        *cells,
        _figure("build_seconds_full_mesh", _mean(row.build_s for row in full), "s", "lower"),
        _figure("build_seconds_obb", _mean(row.build_s for row in boxes), "s", "lower"),
        _figure("load_seconds_meshes", _mean(row.load_s for row in full), "s", "lower"),
    ]
    return [Figure(name=prefix + f.name, value=f.value, unit=f.unit, better=f.better) for f in figures]


def _of_speeds(speeds: list[Speeds]) -> list[Figure]:
    first = 1e3 * np.array([seconds for one in speeds for seconds in one.first_path_s])
    return [
        _figure("grid_seconds", np.mean([one.grid_s for one in speeds]), "s", "lower"),
        _figure("distance_field_seconds", np.mean([one.field_s for one in speeds]), "s", "lower"),
        _figure("update_seconds", np.mean([seconds for one in speeds for seconds in one.update_s]), "s", "lower"),
        _figure("update_seconds_max", np.max([seconds for one in speeds for seconds in one.update_s]), "s", "lower"),
        _figure("first_path_median_ms", np.median(first), "ms", "lower"),
        _figure("first_path_p99_ms", np.percentile(first, 99), "ms", "lower"),
    ]


def _of_maps(options: Options, robot: Robot, trials: int, seeds: range) -> list[Figure]:
    """Return the same figures of the pipeline's maps; none where a quick run finds no map."""
    rows = []
    for i in range(1 if options.quick else _APARTMENTS):
        folder = apartment_map(1000 + i, 0, plays=not options.quick)
        if folder is None:
            continue
        _, truth = cached_recording(apartment_recording(1000 + i, 0))
        rows.append(
            score_saved_map(
                open_map(folder), truth, robot, cell_m=CELL_M, unknown="blocked", trials=trials, seeds=seeds
            )
        )
        print(f"{folder.name}, as the pipeline maps it\n{format_table(rows[-1])}", flush=True)
    return _of_rows(rows, prefix="map_") if rows else []


def _speeds(obstacles: Obstacles, scene: TrueScene, robot: Robot, pairs: NDArray[np.float64]) -> Speeds:
    frame, part = scene.space.frame, scene.space.parts[0][0][0]

    def stamped() -> Occupancy:
        grid = Occupancy(frame, [part])
        for object_id, inflated in obstacles.inflated.items():
            grid.put(object_id, inflated)
        return grid

    grid = stamped()
    space = built("layer-4", obstacles, robot, frame, floor_z_m=0.0, r_safe_m=R_SAFE_M).space
    space.labels()
    first = []
    for i, (start, goal) in enumerate(pairs):
        if isinstance(plan(space, start, goal), NoPath):
            continue
        first.append(_best_of(lambda s=start, g=goal, n=i: first_path(space, s, g, np.random.default_rng(n)), 2))
    return Speeds(
        grid_s=_best_of(stamped, 9),
        field_s=_best_of(lambda: distance_field_m(grid.is_occupied(), frame.cell_m), 5),
        update_s=[_best_of(lambda i=i, q=q: grid.put(i, q), 7) for i, q in obstacles.inflated.items()],
        first_path_s=first,
    )


def _under_tables(truth: Truth, obstacles: Obstacles, scene: TrueScene, robot: Robot) -> list[bool]:
    """Return, for each table that boxes close and truth does not, whether layer 4 finds a path under it.

    To the place under its top that is farthest off all true obstacles, from the place that is so in the whole scene.
    """
    frame = scene.space.frame
    off = np.where(scene.is_reachable, distance_field_m(~scene.is_reachable, frame.cell_m), -1.0)
    centers = frame.centers_m()
    boxes = built("mesh-obb", obstacles, robot, frame, floor_z_m=0.0, r_safe_m=R_SAFE_M).space
    ours = built("layer-4", obstacles, robot, frame, floor_z_m=0.0, r_safe_m=R_SAFE_M).space
    is_closed = boxes.blocked()[0, 0]
    start = centers[np.unravel_index(int(np.where(is_closed, -1.0, off).argmax()), off.shape)]
    found = []
    for item in truth.objects:
        if item.kind not in _TABLES:
            continue
        corners = true_mesh_world(truth, item).vertices[:, :2]
        is_below = ((centers > corners.min(axis=0)) & (centers < corners.max(axis=0))).all(axis=-1)
        places = np.where(is_below & is_closed, off, -1.0)
        if places.max() > 0:
            goal = centers[np.unravel_index(int(places.argmax()), places.shape)]
            found.append(isinstance(plan(ours, start, goal), Path) and isinstance(plan(boxes, start, goal), NoPath))
    return found


def _mean(values: Iterable[float | None]) -> float:
    known = [value for value in values if value is not None]
    return float(np.mean(known))


def _best_of(work: object, repeats: int) -> float:
    assert callable(work)
    seconds = []
    for _ in range(repeats):
        # Not process_time: its other threads (OpenCV's, BLAS's) would count.
        started = time.thread_time()
        work()
        seconds.append(time.thread_time() - started)
    return min(seconds)


def _figure(name: str, value: float, unit: str, better: Better) -> Figure:
    return Figure(name=name, value=float(value), unit=unit, better=better)
