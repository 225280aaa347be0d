"""Layers 3 and 4, and collision checks: how good, how small, how repeatable, how fast. Seconds are CPU seconds."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np
import trimesh

from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.rigid import from_rotation_translation, invert
from hickory_stream.geometry.shape_score import shape_score
from hickory_stream.geometry.superquadric import Superquadrics, joined, log_implicit_value, moved, taken
from hickory_stream.geometry.superquadric_surface import display_mesh, surface_points
from hickory_stream.navigation.clearance import Answer, ClearanceScene
from hickory_stream.shapes.fit import FitConfig, fit_superquadrics
from hickory_stream.shapes.inflate import InflateConfig, Inflated, inflated
from tools.benchmarks.figures import Figure, Options
from tools.benchmarks.shape_meshes import MESH_NAMES, hollow_mesh, test_mesh
from tools.benchmarks.shape_truth import Solid, grown_volume_ratio, surface_distance_pct, volumetric_iou
from tools.benchmarks.swept_truth import way_distance_m

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

_MARGIN_M = 0.05
_PICTURE_PX = 320
_NOISE, _STRETCH = 0.005, (0.02, 0.03)
_NO_POINTS = np.empty((0, 3))
_HOLLOW = ("hollow mug", "bowl")
_SUFFIXES = (".obj", ".ply", ".stl", ".glb", ".off")
# What is said of the simplest of the thirteen.
_SIMPLE = ("box", "sphere", "cylinder", "ellipsoid", "capsule")
Better = Literal["higher", "lower"]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Row:
    """One object as it was measured."""

    name: str
    fitted: Superquadrics
    grown: Inflated
    fit_seconds: float
    inflate_seconds: float
    iou: float
    distance_pct: float
    volume_ratio: float


def measure(options: Options) -> list[Figure]:
    """Return the figures, and print a line per object; hollow objects are outside all means."""
    rng = np.random.default_rng(options.seed)
    meshes = _folder(options.meshes) if options.meshes else {name: test_mesh(name) for name in MESH_NAMES}
    _warm_up()
    rows = []
    for name, mesh in meshes.items():
        rows.append(_row(name, mesh, _rotation(rng), options))
    if not options.meshes and not options.quick:
        for name in _HOLLOW:
            _row(name, hollow_mesh(name), _rotation(rng), options)
    figures = _of_rows(rows, with_simple=not options.meshes)
    figures += _of_scores(meshes, rng, trials=1 if options.quick else 3)
    return figures + _of_collisions(options) + _of_sweeps(rows, options)


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


def _of_scores(meshes: dict[str, trimesh.Trimesh], rng: np.random.Generator, trials: int) -> list[Figure]:
    """Return how an object scores with itself when it is disturbed, and how far the best other one is behind."""
    scaled = [_of_diameter_one(mesh) for mesh in meshes.values()]
    references = [_fit(mesh) for mesh in scaled]
    own: dict[str, list[float]] = {"self_rotation": [], "self_noise": [], "self_scale": []}
    margins = []
    for i, mesh in enumerate(scaled):
        for _ in range(trials):
            for kind, disturbed in _disturbed(mesh, rng):
                found = _fit(disturbed)
                scores = [shape_score(reference, found) for reference in references]
                own[kind].append(scores[i])
                others = [score for j, score in enumerate(scores) if j != i]
                if others:
                    margins.append(scores[i] - max(others))
    figures = [_figure(kind, np.mean(values), "", "higher") for kind, values in own.items()]
    if margins:
        figures.append(_figure("self_other_margin", np.mean(margins), "", "higher"))
        figures.append(_figure("rank1_fraction", np.mean(np.array(margins) > 0), "", "higher"))
    return figures


def _disturbed(mesh: trimesh.Trimesh, rng: np.random.Generator) -> Iterator[tuple[str, trimesh.Trimesh]]:
    yield "self_rotation", _turned(mesh, _rotation(rng))
    # Noise on a mesh of eight vertices would be another shape: edges of at most a twentieth first.
    vertices, faces = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, 0.05, max_iter=30)
    noise = trimesh.Trimesh(vertices, faces)
    noise.vertices = noise.vertices + rng.normal(size=noise.vertices.shape) * _NOISE
    yield "self_noise", noise
    stretched = mesh.copy()
    stretched.apply_scale(1 + rng.uniform(*_STRETCH, 3) * rng.choice([-1, 1], 3))
    yield "self_scale", stretched


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
        _figure("points_per_second", len(uniform) / _best_of(lambda: scene.classify(uniform)), "1/s", "higher"),
        _figure("points_per_second_near", len(near) / _best_of(lambda: scene.classify(near)), "1/s", "higher"),
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
            checked = slice(300 if options.quick else 2000)
            near = [
                way_distance_m(primitives, start, end, half, reach_m=2 * radius)
                for start, end in zip(starts[checked], ends[checked], strict=True)
            ]
            is_free, is_called_free = np.array(near) > radius, sweep()[checked] == Answer.FREE
            if (is_called_free & (np.array(near) < radius - 1e-6)).any():
                raise AssertionError(f"a swept {name} is called free that touches")
            false_pct = 100 * np.mean(~is_called_free[is_free])
            figures += [
                _figure(f"sweeps_per_second_{name}{where}", len(starts) / _best_of(sweep), "1/s", "higher"),
                _figure(f"false_hits_pct_{name}{where}", false_pct, "%", "lower"),
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


def _row(name: str, upright: trimesh.Trimesh, turn: NDArray[np.float64], options: Options) -> Row:
    mesh = _turned(upright, turn)
    started = time.process_time()
    fitted = _fit(mesh)
    fit_seconds = time.process_time() - started
    vertices, faces = _arrays(mesh)
    config = InflateConfig(r_safe_m=_MARGIN_M)
    grown = inflated(fitted, vertices, faces, _NO_POINTS, config)
    inflate_seconds = _best_of(lambda: inflated(fitted, vertices, faces, _NO_POINTS, config))
    solid = Solid(mesh)
    row = Row(
        name=name,
        fitted=fitted,
        grown=grown,
        fit_seconds=fit_seconds,
        inflate_seconds=inflate_seconds,
        iou=volumetric_iou(solid, fitted),
        distance_pct=surface_distance_pct(solid, fitted),
        volume_ratio=grown_volume_ratio(solid, grown.primitives, _MARGIN_M, cells=56 if options.quick else 96),
    )
    state = "box" if grown.is_fallback else "certified" if grown.certificate.holds else "NOT COVERED"
    print(
        f"{name:<20} {fit_seconds:6.2f} s  K {len(fitted):2d}  IoU {row.iou:.3f}  distance {row.distance_pct:.2f} %  "
        f"inflated {1e3 * inflate_seconds:5.1f} ms, {row.volume_ratio:.2f} x, {state}"
    )
    if options.render is not None:
        _render(options.render, row, upright, invert(turn))
    return row


def _render(folder: Path, row: Row, upright: trimesh.Trimesh, upright_from_mesh: NDArray[np.float64]) -> None:
    """Draw the mesh, its fit and its inflation, the latter at a smaller scale, standing as the mesh was made."""
    import cv2

    from hickory_stream.evaluation.close_up import close_up_of, draw
    from hickory_stream.evaluation.raycast import Surface
    from hickory_stream.evaluation.render_parts import superquadric_surfaces

    # Faces that meet at an edge share no vertex, so that each is shaded as the plane that it is.
    shaded = trimesh.graph.smooth_shade(upright, angle=0.6)
    grey = np.full((len(shaded.vertices), 3), 176, np.uint8)
    mesh = Surface(vertices=np.asarray(shaded.vertices, np.float32), faces=shaded.faces, colors=grey, owner=0)
    fitted, grown = (moved(found, upright_from_mesh) for found in (row.fitted, row.grown.primitives))
    around = np.concatenate([display_mesh(grown, i)[0] for i in range(len(grown))])
    near, far = (close_up_of(points, 0.6, _PICTURE_PX) for points in (upright.vertices, around))
    panels = [
        draw([mesh], near),
        draw(superquadric_surfaces(fitted, 1), near),
        draw(superquadric_surfaces(grown, 1), far),
    ]
    picture = np.ascontiguousarray(np.concatenate(panels, axis=1)[..., ::-1])
    state = "a box" if row.grown.is_fallback else "certified" if row.grown.certificate.holds else "NOT COVERED"
    titles = (
        row.name,
        f"{len(fitted)} superquadrics, IoU {row.iou:.2f}",
        f"with 5 cm: {row.volume_ratio:.2f} x, {state}",
    )
    for i, title in enumerate(titles):
        place = (12 + i * _PICTURE_PX, 24)
        cv2.putText(picture, title, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, (60, 60, 60), 1, cv2.LINE_AA)
    folder.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(folder / f"{row.name.replace(' ', '-')}.png"), picture)


def _fit(mesh: trimesh.Trimesh) -> Superquadrics:
    vertices, faces = _arrays(mesh)
    count = len(vertices)
    return fit_superquadrics(
        Mesh(
            vertices=vertices.astype(np.float32),
            faces=faces,
            colors=np.zeros((count, 3), np.uint8),
            is_seen=np.ones(count, bool),
        ),
        FitConfig(),
    )


def _arrays(mesh: trimesh.Trimesh) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    return np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int32)


def _warm_up() -> None:
    """Load the compiled kernels: what is measured is the work, not the first call."""
    mesh = test_mesh("monitor")
    inflated(_fit(mesh), *_arrays(mesh), _NO_POINTS, InflateConfig(r_safe_m=_MARGIN_M))
    _fit(test_mesh("torus"))


def _folder(folder: Path) -> dict[str, trimesh.Trimesh]:
    files = sorted(path for path in folder.rglob("*") if path.suffix.lower() in _SUFFIXES)
    if not files:
        raise SystemExit(f"{folder} has no meshes; known are {', '.join(_SUFFIXES)}")
    return {
        str(path.relative_to(folder).with_suffix("")).replace("/", "-"): trimesh.load(path, force="mesh")
        for path in files
    }


def _rotation(rng: np.random.Generator) -> NDArray[np.float64]:
    return np.asarray(trimesh.transformations.random_rotation_matrix(rng.random(3)))


def _turned(mesh: trimesh.Trimesh, turn: NDArray[np.float64]) -> trimesh.Trimesh:
    turned = mesh.copy()
    turned.apply_transform(turn)
    return turned


def _of_diameter_one(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    scaled = mesh.copy()
    scaled.apply_scale(1 / float(np.linalg.norm(np.ptp(mesh.vertices, axis=0))))
    return scaled


def _random_primitives(rng: np.random.Generator, count: int) -> Superquadrics:
    rotations = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    rotations[:, :, 2] *= np.sign(np.linalg.det(rotations))[:, None]
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = rotations, rng.uniform((0, 0, 0), (10, 10, 2), (count, 3))
    exponents = rng.choice([0.1, 0.25, 0.4, 1.0], (count, 2))
    # One in four as an odd fit leaves it, so that the fast paths are not all there is.
    exponents = np.where(rng.random((count, 2)) < 0.25, rng.uniform(0.1, 1.5, (count, 2)), exponents)
    return Superquadrics(exponents=exponents, semi_axes_m=rng.uniform(0.05, 0.4, (count, 3)), world_from_local=poses)


def _best_of(work: object, repeats: int = 4) -> float:
    assert callable(work)
    seconds = []
    for _ in range(repeats):
        started = time.process_time()
        work()
        seconds.append(time.process_time() - started)
    return min(seconds)


def _figure(name: str, value: float, unit: str, better: Better) -> Figure:
    return Figure(name=name, value=float(value), unit=unit, better=better)
