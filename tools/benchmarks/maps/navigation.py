"""Planning on boxes, meshes and layer 4 of the four apartments; the times of grids and paths, in CPU seconds."""
# Layer 4 is made of the true meshes, so that shapes alone are compared; a whole run makes the same table of the maps of
# the pipeline, with unseen space as unknown.

import hashlib
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.caches import cache_folder
from hickory_stream.evaluation.evaluate import true_mesh_world
from hickory_stream.evaluation.truth import Truth, load_truth, mesh_of
from hickory_stream.geometry.mesh import Mesh, sha256_of
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.superquadric import Superquadrics, moved
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.navigation.free_space import CELL_M
from hickory_stream.navigation.occupancy import Occupancy, distance_field_m
from hickory_stream.navigation.robot import Robot, load_robot
from hickory_stream.navigation.search import NoPath, Path, first_path, plan
from hickory_stream.shapes.fit.marching_primitives import FitConfig, fit_superquadrics
from hickory_stream.shapes.inflate.inflation import InflateConfig, inflated
from tools.benchmarks.common.cached_runs import apartment_map, cached, walk_recording
from tools.benchmarks.common.code_hashes import code_hash
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.common.processes import best_s
from tools.evaluation.navigation_table import (
    R_SAFE_M,
    MethodScore,
    Obstacles,
    TrueScene,
    built,
    draw_pairs,
    format_table,
    score_saved_map,
    table_of,
    true_obstacles,
    truth_of,
)
from tools.worlds.cache import cached_recording

_APARTMENTS = 4
_TABLES = ("table", "desk", "coffee_table", "side_table")
_METHODS = {"": "layer-4", "_full_mesh": "mesh-full", "_obb": "mesh-obb"}


@dataclass(frozen=True, kw_only=True, slots=True)
class Speeds:
    """CPU seconds of one scene: the grid of all objects, one object's update, and each first path."""

    grid_s: float
    update_s: list[float]
    first_path_s: list[float]


def measure(options: Options) -> list[Figure]:
    """Return the figures, and print a table per scene; a quick run takes one scene and fewer pairs, and no maps."""
    robot = load_robot("point")
    trials, seeds = (25, range(1)) if options.quick else (100, range(5))
    scenes = [load_truth(folder) for folder in options.scenes] or [
        cached_recording(walk_recording("apartment", 1000 + i))[1] for i in range(1 if options.quick else _APARTMENTS)
    ]
    rows, speeds, under = [], [], []
    for truth in scenes:
        obstacles = true_obstacles(truth, _true_inflated(truth, InflateConfig(r_safe_m=R_SAFE_M)))
        scene = truth_of(truth, robot, cell_m=CELL_M, floor_z_m=0.0)
        drawn = [options.seed * len(seeds) + i for i in seeds]
        rows.append(table_of(obstacles, scene, robot, r_safe_m=R_SAFE_M, trials=trials, seeds=drawn))
        print(f"{truth.folder.name}, layer 4 of the true meshes\n{format_table(rows[-1])}", flush=True)
        speeds.append(_speeds(obstacles, scene, robot, draw_pairs(scene, trials, options.seed)))
        under.append(_under_tables(truth, obstacles, scene, robot))
    with_one = [any(tables) for tables in under if tables]
    if not all(with_one):
        raise AssertionError("in a scene with room under a table no path was found there")
    figures = [
        figure("scenes", len(scenes)),
        figure("pairs", sum(scene_rows[0].pairs for scene_rows in rows)),
        *_of_rows(rows),
        *_of_speeds(speeds),
    ]
    if with_one:
        each = [found for tables in under for found in tables]
        figures.append(figure("under_each_table_found_fraction", np.mean(each)))
    if not (options.scenes or options.quick):
        figures += [replace(one, name=f"map_{one.name}") for one in _of_rows(_rows_of_maps(robot, trials, seeds))]
    return figures


def _of_rows(rows: list[list[MethodScore]]) -> list[Figure]:
    by_method = {scores[0].name: scores for scores in zip(*rows, strict=True)}
    ours, full, boxes = (by_method[name] for name in _METHODS.values())
    figures = []
    for name, scale, unit, key in (
        ("success_pct", 100, "%", "success"),
        ("efficiency", 1, "", "efficiency"),
        ("free_space", 1, "", "free_space"),
    ):
        for suffix, scores in zip(_METHODS, (ours, full, boxes), strict=True):
            figures.append(figure(name + suffix, scale * _mean(getattr(row, key) for row in scores), unit))
    return [
        *figures,
        figure("path_over_optimum", _mean(row.over_optimum for row in ours), "x", "lower"),
        figure("missed_cells", sum(row.missed_cells for row in ours), "", "lower"),
        figure("lost_cells", sum(row.lost_cells for row in ours), "", "lower"),
        figure("missed_cells_full_mesh", sum(row.missed_cells for row in full), "", "lower"),
        figure("missed_cells_obb", sum(row.missed_cells for row in boxes), "", "lower"),
        figure("lost_cells_obb", sum(row.lost_cells for row in boxes), "", "lower"),
        figure("build_seconds_full_mesh", _mean(row.build_s for row in full), "s", "lower"),
        figure("build_seconds_obb", _mean(row.build_s for row in boxes), "s", "lower"),
        figure("load_seconds_meshes", _mean(row.load_s for row in full), "s", "lower"),
    ]


def _of_speeds(speeds: list[Speeds]) -> list[Figure]:
    first_ms = 1e3 * np.array([seconds for one in speeds for seconds in one.first_path_s])
    updates_s = [seconds for one in speeds for seconds in one.update_s]
    return [
        figure("grid_seconds", np.mean([one.grid_s for one in speeds]), "s", "lower"),
        figure("update_seconds", np.mean(updates_s), "s", "lower"),
        figure("update_seconds_max", np.max(updates_s), "s", "lower"),
        figure("first_path_median_ms", np.median(first_ms), "ms", "lower"),
        figure("first_path_p99_ms", np.percentile(first_ms, 99), "ms", "lower"),
    ]


def _rows_of_maps(robot: Robot, trials: int, seeds: range) -> list[list[MethodScore]]:
    rows = []
    for i in range(_APARTMENTS):
        folder = apartment_map(1000 + i, 0)
        truth = cached_recording(walk_recording("apartment", 1000 + i))[1]
        saved = open_map(folder)
        rows.append(score_saved_map(saved, truth, robot, cell_m=CELL_M, unknown="blocked", trials=trials, seeds=seeds))
        print(f"{folder.name}, as the pipeline maps it\n{format_table(rows[-1])}", flush=True)
    return rows


def _speeds(obstacles: Obstacles, scene: TrueScene, robot: Robot, pairs: NDArray[np.float64]) -> Speeds:
    frame, part = scene.space.frame, scene.space.parts[0][0][0]

    def stamped() -> Occupancy:
        grid = Occupancy(frame, [part])
        for object_id, body in obstacles.inflated.items():
            grid.put(object_id, body)
        return grid

    def least_s(work: Callable[[], object], repeats: int) -> float:
        # Not process_time: the other threads of OpenCV and BLAS would count.
        return best_s(work, repeats, time.thread_time)

    grid = stamped()
    space = built("layer-4", obstacles, robot, frame, floor_z_m=0.0, r_safe_m=R_SAFE_M).space
    space.labels()
    first = [
        least_s(lambda s=start, g=goal, n=i: first_path(space, s, g, np.random.default_rng(n)), 2)
        for i, (start, goal) in enumerate(pairs)
        if not isinstance(plan(space, start, goal), NoPath)
    ]
    return Speeds(
        grid_s=least_s(stamped, 9),
        update_s=[least_s(lambda i=i, q=q: grid.put(i, q), 7) for i, q in obstacles.inflated.items()],
        first_path_s=first,
    )


def _under_tables(truth: Truth, obstacles: Obstacles, scene: TrueScene, robot: Robot) -> list[bool]:
    # Return, for each table that boxes close and truth does not, whether layer 4 finds a path under it. To the place
    # under its top with the largest distance to all true obstacles, from such a place of the whole scene.
    frame = scene.space.frame
    off = np.where(scene.is_reachable, distance_field_m(~scene.is_reachable, frame.cell_m), -1.0)
    centers = frame.centers_m()
    boxes, ours = (
        built(name, obstacles, robot, frame, floor_z_m=0.0, r_safe_m=R_SAFE_M).space for name in ("mesh-obb", "layer-4")
    )
    is_closed = boxes.blocked()[0, 0]
    start = centers[np.unravel_index(int(np.where(is_closed, -1.0, off).argmax()), off.shape)]
    found = []
    for item in truth.objects:
        if item.kind in _TABLES:
            corners = true_mesh_world(truth, item).vertices[:, :2]
            is_below = ((centers > corners.min(axis=0)) & (centers < corners.max(axis=0))).all(axis=-1)
            places = np.where(is_below & is_closed, off, -1.0)
            if places.max() > 0:
                goal = centers[np.unravel_index(int(places.argmax()), places.shape)]
                is_new = isinstance(plan(boxes, start, goal), NoPath)
                found.append(is_new and isinstance(plan(ours, start, goal), Path))
    return found


def _mean(values: Iterable[float | None]) -> float:
    return float(np.mean([value for value in values if value is not None]))


def _true_inflated(truth: Truth, config: InflateConfig) -> dict[int, Superquadrics]:
    return {item.id: _inflated(mesh_of(truth, item), item.world_from_object, config) for item in truth.objects}


def _inflated(mesh: Mesh, world_from_object: NDArray[np.float64], config: InflateConfig) -> Superquadrics:
    code = code_hash("hickory_stream/geometry", "hickory_stream/shapes")
    key = hashlib.sha256(f"{sha256_of(mesh)} {world_from_object.tobytes().hex()} {asdict(config)} {code}".encode())

    def measured() -> dict[str, Any]:
        fitted = moved(fit_superquadrics(mesh, FitConfig()), world_from_object)
        vertices = apply(world_from_object, mesh.vertices.astype(np.float64))
        found = inflated(fitted, vertices, mesh.faces, np.empty((0, 3)), config).primitives
        return {field.name: getattr(found, field.name).tolist() for field in fields(found)}

    found = cached(cache_folder("true-shapes") / f"{key.hexdigest()}.json", measured)
    return Superquadrics(**{name: np.array(values) for name, values in found.items()})
