"""Layers 3 and 4, and collision checks: how good, how small, how repeatable, how fast. Seconds are CPU seconds."""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np
import trimesh

from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.geometry.superquadric import Superquadrics, joined, log_implicit_value, moved, taken
from hickory_stream.geometry.superquadric_surface import surface_points
from hickory_stream.navigation.clearance import Answer, ClearanceScene
from tools.benchmarks.figures import Figure, Options
from tools.benchmarks.foreign_shapes import foreign_figures
from tools.benchmarks.shape_meshes import MESH_NAMES, hollow_mesh, test_mesh
from tools.benchmarks.shape_rows import best_of, disturbed, fit, of_diameter_one, rotation, row_of, warm_up
from tools.benchmarks.swept_truth import way_distance_m
from tools.evaluation.shape_score import shape_score

if TYPE_CHECKING:
    from pathlib import Path

    from tools.benchmarks.shape_rows import Row

_HOLLOW = ("hollow mug", "bowl")
_SUFFIXES = (".obj", ".ply", ".stl", ".glb", ".off")
# What is said of the simplest of the thirteen.
_SIMPLE = ("box", "sphere", "cylinder", "ellipsoid", "capsule")
Better = Literal["higher", "lower"]


def measure(options: Options) -> list[Figure]:
    """Return the figures, and print a line per object; hollow objects are outside all means.

    Shapes by others, and collisions, are measured in a process of their own, beside the rest: seconds are those of
    processors.
    """
    if options.meshes:
        return _own_figures(options) + _of_collisions(options)
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        beside = [pool.submit(part, options) for part in (_of_collisions, foreign_figures)]
        return [*_own_figures(options), *(figure for part in beside for figure in part.result())]


def _own_figures(options: Options) -> list[Figure]:
    rng = np.random.default_rng(options.seed)
    meshes = _folder(options.meshes) if options.meshes else {name: test_mesh(name) for name in MESH_NAMES}
    warm_up()
    rows = []
    for name, mesh in meshes.items():
        rows.append(row_of(name, mesh, rotation(rng), options))
    if not options.meshes and not options.quick:
        for name in _HOLLOW:
            row_of(name, hollow_mesh(name), rotation(rng), options)
    figures = _of_rows(rows, with_simple=not options.meshes)
    # Quick: every other mesh is disturbed, and compared with all.
    figures += _of_scores(meshes, rng, trials=1 if options.quick else 3, every=2 if options.quick else 1)
    return figures + _of_sweeps(rows, options)


def _of_rows(rows: list[Row], *, with_simple: bool) -> list[Figure]:
    figures = [
        _figure("meshes", len(rows), "", "higher"),
        _figure("fit_seconds", np.mean([row.fit_seconds for row in rows]), "s", "lower"),
        _figure("fit_seconds_max", np.max([row.fit_seconds for row in rows]), "s", "lower"),
        _figure("iou_mean", np.mean([row.iou for row in rows]), "", "higher"),
        _figure("iou_min", np.min([row.iou for row in rows]), "", "higher"),
        _figure("primitives_mean", np.mean([len(row.fitted) for row in rows]), "", "lower"),
        _figure("distance_pct", np.mean([row.distance_pct for row in rows]), "%", "lower"),
        _figure("uncovered_triangles", sum(row.grown.certificate.uncovered_triangles for row in rows), "", "lower"),
        _figure("certified_fraction", np.mean([row.grown.certificate.holds for row in rows]), "", "higher"),
        _figure("fallback_boxes", sum(row.grown.is_fallback for row in rows), "", "lower"),
        _figure("inflated_volume_ratio", np.mean([row.volume_ratio for row in rows]), "x", "lower"),
        _figure("inflated_volume_ratio_max", np.max([row.volume_ratio for row in rows]), "x", "lower"),
        _figure("inflate_seconds", np.mean([row.inflate_seconds for row in rows]), "s", "lower"),
    ]
    if with_simple:
        counts = {row.name: len(row.fitted) for row in rows}
        figures += [_figure(f"k_{name}", counts[name], "", "lower") for name in _SIMPLE]
    return figures


def _of_scores(
    meshes: dict[str, trimesh.Trimesh], rng: np.random.Generator, *, trials: int, every: int
) -> list[Figure]:
    """Return how an object scores with itself when it is disturbed, and how far the best other one is behind."""
    scaled = [of_diameter_one(mesh) for mesh in meshes.values()]
    references = [fit(mesh).primitives for mesh in scaled]
    own: dict[str, list[float]] = {"self_rotation": [], "self_noise": [], "self_scale": []}
    margins = []
    for i, mesh in list(enumerate(scaled))[::every]:
        for _ in range(trials):
            for kind, other in disturbed(mesh, rng):
                found = fit(other).primitives
                scores = [shape_score(reference, found) for reference in references]
                own[kind].append(scores[i])
                others = [score for j, score in enumerate(scores) if j != i]
                if others:
                    margins.append(scores[i] - max(others))
    among = f"among {len(meshes)} meshes"
    figures = [
        _figure(kind, np.mean(values), "", "higher", f"{len(values)} trials {among}") for kind, values in own.items()
    ]
    if margins:
        of = f"{len(margins)} trials {among}"
        figures.append(_figure("self_other_margin", np.mean(margins), "", "higher", of))
        figures.append(_figure("rank1_fraction", np.mean(np.array(margins) > 0), "", "higher", of))
    return figures


def _of_collisions(options: Options) -> list[Figure]:
    """Return the speeds against 300 superquadrics in 10 x 10 x 2 m; any answer unlike brute force is an error."""
    rng = np.random.default_rng(options.seed + 1000)
    primitives = _random_primitives(rng, 300)
    scene = ClearanceScene()
    for i in range(len(primitives)):
        scene.put(i, taken(primitives, np.array([i])))
    count = 500_000 if options.quick else 2_000_000
    uniform = rng.uniform((0, 0, 0), (10, 10, 2), (count, 3))
    surface = np.concatenate([surface_points(primitives, i, 500) for i in range(len(primitives))])
    directions = rng.normal(size=(count // 2, 3))
    directions *= (0.1 * rng.random((len(directions), 1))) / np.linalg.norm(directions, axis=1, keepdims=True)
    near = surface[rng.integers(len(surface), size=count // 2)] + directions
    checked = 50_000 if options.quick else count
    for points in (uniform[:checked], near[:checked]):
        expected = np.zeros(len(points), bool)
        for i in range(len(primitives)):
            expected |= log_implicit_value(primitives, i, points) <= 0
        wrong = int((~scene.is_free(points) != expected).sum())
        if wrong:
            raise AssertionError(f"{wrong} of {len(points)} points are answered unlike brute force")
    return [
        _figure("points_per_second", len(uniform) / best_of(lambda: scene.classify(uniform)), "1/s", "higher"),
        _figure("points_per_second_near", len(near) / best_of(lambda: scene.classify(near)), "1/s", "higher"),
    ]


def _of_sweeps(rows: list[Row], options: Options) -> list[Figure]:
    """Return the speeds of sweeps, and what share of the free ways is called a hit; a false free way is an error.

    In a scene of random superquadrics, and among the inflated objects in a room; a ball and a box, along ways of 1 m.
    """
    rng = np.random.default_rng(options.seed + 2000)
    scenes = {"": (_random_primitives(rng, 300), (10.0, 10.0, 2.0)), "_room": (_in_a_room(rows, rng), (6.0, 6.0, 2.0))}
    bodies = {"ball": (0.1, np.zeros(3)), "box": (0.05, np.array([0.2, 0.2, 0.3]))}
    figures = []
    for where, (primitives, size) in scenes.items():
        scene = ClearanceScene()
        scene.put(0, primitives)
        starts = rng.uniform((0, 0, 0), size, (100_000 if options.quick else 400_000, 3))
        ways = rng.normal(size=starts.shape)
        ends = starts + ways / np.linalg.norm(ways, axis=1, keepdims=True)
        for name, (radius, half) in bodies.items():
            sweep = partial(scene.sweep, starts, ends, radius_m=radius, half_extents_m=half)
            checked = slice(100 if options.quick else 2000)
            near = [
                way_distance_m(primitives, start, end, half, reach_m=2 * radius)
                for start, end in zip(starts[checked], ends[checked], strict=True)
            ]
            is_free, is_called_free = np.array(near) > radius, sweep()[checked] == Answer.FREE
            if (is_called_free & (np.array(near) < radius - 1e-6)).any():
                raise AssertionError(f"a swept {name} is called free that touches")
            false_pct = 100 * np.mean(~is_called_free[is_free])
            figures += [
                _figure(f"sweeps_per_second_{name}{where}", len(starts) / best_of(sweep), "1/s", "higher"),
                _figure(f"false_hits_pct_{name}{where}", false_pct, "%", "lower", f"{int(is_free.sum())} free ways"),
            ]
    return figures


def _in_a_room(rows: list[Row], rng: np.random.Generator) -> Superquadrics:
    """Return the inflated primitives of the objects, each three times about a room of 6 x 6 m."""
    placed = []
    for row in [*rows, *rows, *rows]:
        a = rng.uniform(0, 2 * np.pi)
        turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
        placed.append(moved(row.grown.primitives, from_rotation_translation(turn, rng.uniform((0, 0, 0), (6, 6, 1.5)))))
    return joined(placed)


def _folder(folder: Path) -> dict[str, trimesh.Trimesh]:
    files = sorted(path for path in folder.rglob("*") if path.suffix.lower() in _SUFFIXES)
    if not files:
        raise SystemExit(f"{folder} has no meshes; known are {', '.join(_SUFFIXES)}")
    return {
        str(path.relative_to(folder).with_suffix("")).replace("/", "-"): trimesh.load(path, force="mesh")
        for path in files
    }


def _random_primitives(rng: np.random.Generator, count: int) -> Superquadrics:
    rotations = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    rotations[:, :, 2] *= np.sign(np.linalg.det(rotations))[:, None]
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = rotations, rng.uniform((0, 0, 0), (10, 10, 2), (count, 3))
    exponents = rng.choice([0.1, 0.25, 0.4, 1.0], (count, 2))
    # One in four as an odd fit leaves it, so that the fast paths are not all there is.
    exponents = np.where(rng.random((count, 2)) < 0.25, rng.uniform(0.1, 1.5, (count, 2)), exponents)
    return Superquadrics(exponents=exponents, semi_axes_m=rng.uniform(0.05, 0.4, (count, 3)), world_from_local=poses)


def _figure(name: str, value: float, unit: str, better: Better, of: str = "") -> Figure:
    return Figure(name=name, value=float(value), unit=unit, better=better, of=of)
