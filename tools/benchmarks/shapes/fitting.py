"""Layers 3 and 4, and collision checks: how good, small, repeatable and fast they are. Seconds are CPU seconds."""

import json
import multiprocessing
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import trimesh

from hickory_stream.errors import RecordingError
from hickory_stream.geometry.rigid import from_rotation_translation, yaw_rotation
from hickory_stream.geometry.superquadric import Superquadrics, joined, moved, taken
from hickory_stream.geometry.superquadric_surface import surface_points
from hickory_stream.navigation.clearance import Answer, ClearanceScene
from tools.benchmarks.common.figures import Figure, Options, figure, mean
from tools.benchmarks.common.processes import best_s
from tools.benchmarks.foreign.logs import worlds_folder
from tools.benchmarks.shapes.rows import Row, disturbed, fit, of_diameter_one, rotation, row_of, warm_up
from tools.evaluation.shape_score import shape_score
from tools.evaluation.shapes.meshes import MESH_NAMES, hollow_mesh, test_mesh
from tools.evaluation.shapes.solids import is_inside
from tools.evaluation.shapes.swept_truth import swept_distance_m

_HOLLOW = ("hollow mug", "bowl")
_SUFFIXES = (".obj", ".ply", ".stl", ".glb", ".off")
# The number of primitives is reported for the simplest of the thirteen.
_SIMPLE = ("box", "sphere", "cylinder", "ellipsoid", "capsule")


def measure(options: Options) -> list[Figure]:
    """Return the figures, and print a line per object; hollow objects are outside all means."""
    # Shapes by others, and collisions, are measured in another process at the same time: seconds are those of
    # processors.
    if options.meshes:
        return _own_figures(options) + _of_collisions(options)
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        beside = [pool.submit(part, options) for part in (_of_collisions, foreign_figures)]
        return [*_own_figures(options), *(one for part in beside for one in part.result())]


def _own_figures(options: Options) -> list[Figure]:
    rng = np.random.default_rng(options.seed)
    meshes = _folder(options.meshes) if options.meshes else {name: test_mesh(name) for name in MESH_NAMES}
    warm_up()
    rows = [row_of(name, mesh, rotation(rng), options) for name, mesh in meshes.items()]
    if not options.meshes and not options.quick:
        for name in _HOLLOW:
            row_of(name, hollow_mesh(name), rotation(rng), options)
    figures = _of_rows(rows, with_simple=not options.meshes)
    # Quick: every other mesh is disturbed, and compared with all.
    figures += _of_scores(meshes, rng, trials=1 if options.quick else 3, every=2 if options.quick else 1)
    return figures + _of_sweeps(rows, options)


def _of_rows(rows: list[Row], *, with_simple: bool) -> list[Figure]:
    def of(name: str, values: str, unit: str = "", better: str = "lower", statistic: object = np.mean) -> Figure:
        assert callable(statistic)
        return figure(name, statistic([getattr(row, values) for row in rows]), unit, better)

    counts = {row.name: len(row.fitted) for row in rows}
    certificates = [row.grown.certificate for row in rows]
    return [
        figure("meshes", len(rows)), of("fit_seconds", "fit_seconds", "s"),
        of("fit_seconds_max", "fit_seconds", "s", statistic=np.max), of("iou_mean", "iou", better="higher"),
        of("iou_min", "iou", better="higher", statistic=np.min),
        figure("primitives_mean", np.mean([*counts.values()]), "", "lower"), of("distance_pct", "distance_pct", "%"),
        figure("uncovered_triangles", sum(one.uncovered_triangles for one in certificates), "", "lower"),
        figure("certified_fraction", np.mean([one.holds for one in certificates])),
        figure("fallback_boxes", sum(row.grown.is_fallback for row in rows), "", "lower"),
        of("inflated_volume_ratio", "volume_ratio", "x"),
        of("inflated_volume_ratio_max", "volume_ratio", "x", statistic=np.max),
        of("inflate_seconds", "inflate_seconds", "s"),
        *(figure(f"k_{name}", counts[name], "", "lower") for name in _SIMPLE if with_simple),
    ]  # fmt: skip


def _of_scores(
    meshes: dict[str, trimesh.Trimesh], rng: np.random.Generator, *, trials: int, every: int
) -> list[Figure]:
    scaled = [of_diameter_one(mesh) for mesh in meshes.values()]
    references = [fit(mesh).primitives for mesh in scaled]
    own: dict[str, list[float]] = {"self_rotation": [], "self_noise": [], "self_scale": []}
    margins = []
    for i, mesh in list(enumerate(scaled))[::every]:
        for _ in range(trials):
            for kind, other in disturbed(mesh, rng):
                found = fit(other).primitives
                scores = [shape_score(reference, found) for reference in references]
                own[kind].append(scores.pop(i))
                if scores:
                    margins.append(own[kind][-1] - max(scores))
    among = f"among {len(meshes)} meshes"
    figures = [figure(kind, np.mean(vs), "", "higher", f"{len(vs)} trials {among}") for kind, vs in own.items()]
    if margins:
        of = f"{len(margins)} trials {among}"
        figures.append(figure("self_other_margin", np.mean(margins), "", "higher", of))
        figures.append(figure("rank1_fraction", np.mean(np.array(margins) > 0), "", "higher", of))
    return figures


def _of_collisions(options: Options) -> list[Figure]:
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
        wrong = int((~scene.is_free(points) != is_inside(primitives, points)).sum())
        if wrong:
            raise AssertionError(f"{wrong} of {len(points)} points are answered unlike brute force")
    return [
        figure("points_per_second", len(uniform) / best_s(lambda: scene.classify(uniform)), "1/s"),
        figure("points_per_second_near", len(near) / best_s(lambda: scene.classify(near)), "1/s"),
    ]


def _of_sweeps(rows: list[Row], options: Options) -> list[Figure]:
    # Return the speeds of sweeps, and the share of free sweeps that are called a hit; a false free one is an error. In
    # a scene of random superquadrics, and among the inflated objects in a room; a ball and a box, moved by 1 m.
    rng = np.random.default_rng(options.seed + 2000)
    scenes = {"": (_random_primitives(rng, 300), (10.0, 10.0, 2.0)), "_room": (_in_a_room(rows, rng), (6.0, 6.0, 2.0))}
    bodies = {"ball": (0.1, np.zeros(3)), "box": (0.05, np.array([0.2, 0.2, 0.3]))}
    figures = []
    for where, (primitives, size) in scenes.items():
        scene = ClearanceScene()
        scene.put(0, primitives)
        starts = rng.uniform((0, 0, 0), size, (100_000 if options.quick else 400_000, 3))
        steps = rng.normal(size=starts.shape)
        ends = starts + steps / np.linalg.norm(steps, axis=1, keepdims=True)
        for name, (radius, half) in bodies.items():
            sweep = partial(scene.sweep, starts, ends, radius_m=radius, half_extents_m=half)
            checked = slice(100 if options.quick else 2000)
            near = np.array(
                [
                    swept_distance_m(primitives, start, end, half, reach_m=2 * radius)
                    for start, end in zip(starts[checked], ends[checked], strict=True)
                ]
            )
            is_free, is_called_free = near > radius, sweep()[checked] == Answer.FREE
            if (is_called_free & (near < radius - 1e-6)).any():
                raise AssertionError(f"a swept {name} is called free that touches")
            false_pct = 100 * np.mean(~is_called_free[is_free])
            figures += [
                figure(f"sweeps_per_second_{name}{where}", len(starts) / best_s(sweep), "1/s"),
                figure(f"false_hits_pct_{name}{where}", false_pct, "%", "lower", f"{int(is_free.sum())} free ways"),
            ]
    return figures


def _in_a_room(rows: list[Row], rng: np.random.Generator) -> Superquadrics:
    placed = []
    for row in [*rows, *rows, *rows]:
        turn = yaw_rotation(rng.uniform(0, 2 * np.pi))
        placed.append(moved(row.grown.primitives, from_rotation_translation(turn, rng.uniform((0, 0, 0), (6, 6, 1.5)))))
    return joined(placed)


def _folder(folder: Path) -> dict[str, trimesh.Trimesh]:
    files = sorted(path for path in folder.rglob("*") if path.suffix.lower() in _SUFFIXES)
    if not files:
        raise SystemExit(f"{folder} has no meshes; known are {', '.join(_SUFFIXES)}")
    names = [str(path.relative_to(folder).with_suffix("")).replace("/", "-") for path in files]
    return {name: trimesh.load(path, force="mesh") for name, path in zip(names, files, strict=True)}


def _random_primitives(rng: np.random.Generator, count: int) -> Superquadrics:
    rotations = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    rotations[:, :, 2] *= np.sign(np.linalg.det(rotations))[:, None]
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = rotations, rng.uniform((0, 0, 0), (10, 10, 2), (count, 3))
    exponents = rng.choice([0.1, 0.25, 0.4, 1.0], (count, 2))
    # One in four as an odd fit leaves it, so that slow paths of the code are measured, too.
    exponents = np.where(rng.random((count, 2)) < 0.25, rng.uniform(0.1, 1.5, (count, 2)), exponents)
    return Superquadrics(exponents=exponents, semi_axes_m=rng.uniform(0.05, 0.4, (count, 3)), world_from_local=poses)


# Layers 3 and 4 of shapes by others: every closed mesh of their rooms and scans, each shape once.
# A mesh is closed if, with equal vertices joined, each edge has two faces. Structure, such as a wall, is no object.
# Every other mesh of the rooms and scans for tuning is reported, and all of the rooms for reporting.
_TUNED = ("home", "bookstore")
_HELD_OUT = ("service-office", "warehouse")
# Meshes with as many faces, and as much surface and volume to this share, are one shape.
_ALIKE = 0.02
_QUICK = 8


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ForeignShape:
    """A closed mesh, its name, and whether it is reported: nothing was tuned on it."""

    name: str
    mesh: trimesh.Trimesh
    is_reported: bool


def foreign_figures(options: Options) -> list[Figure]:
    """Return the figures of both halves, and print a line per object; none where there are no such meshes."""
    try:
        worlds = worlds_folder(options.worlds)
    except RecordingError as error:
        print(f"no shapes by others: {error}")
        return []
    shapes = closed_shapes(worlds)
    rng = np.random.default_rng(options.seed + 3000)
    figures = []
    for half, is_reported in (("foreign", True), ("foreign_tuned", False)):
        own = [shape for shape in shapes if shape.is_reported == is_reported]
        figures += _of_half(half, own[1::_QUICK] if options.quick else own, rng, options)
    return figures


def closed_shapes(worlds: Path) -> list[ForeignShape]:
    """Return the closed meshes of a folder of worlds, and of the scans beside it, by name; each shape once."""
    seen: set[tuple[int, int, int]] = set()
    shapes, num_tuned = [], 0
    for name, file in _files(worlds):
        mesh = _joined(file)
        if not (mesh.is_watertight and mesh.volume > 0):
            continue
        key = (len(mesh.faces), round(np.log(mesh.area) / _ALIKE), round(np.log(mesh.volume) / _ALIKE))
        if key not in seen:
            seen.add(key)
            is_held_out = name.startswith(_HELD_OUT)
            shapes.append(ForeignShape(name=name, mesh=mesh, is_reported=is_held_out or num_tuned % 2 == 1))
            num_tuned += not is_held_out
    return shapes


def _files(worlds: Path) -> Iterator[tuple[str, Path]]:
    for world in (*_TUNED, *_HELD_OUT):
        objects = json.loads((worlds / world / "world.json").read_text())["objects"]
        for name in sorted({item["mesh"] for item in objects if not item["is_structure"]}):
            yield f"{world}-{Path(name).stem}", worlds / world / name
    for file in sorted((worlds.parent / "data" / "ycb").glob("*.obj")):
        yield f"ycb-{file.stem}", file


def _joined(file: Path) -> trimesh.Trimesh:
    found = trimesh.load(file, force="mesh", process=False)
    mesh = trimesh.Trimesh(found.vertices, found.faces, process=False)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    mesh.update_faces(mesh.nondegenerate_faces())
    mesh.remove_unreferenced_vertices()
    return mesh


def _of_half(half: str, shapes: list[ForeignShape], rng: np.random.Generator, options: Options) -> list[Figure]:
    rows = [row_of(shape.name, shape.mesh, rotation(rng), options, is_thin=True) for shape in shapes]
    scores: dict[str, list[float]] = {"self_rotation": [], "self_noise": [], "self_scale": []}
    for shape in shapes:
        mesh = of_diameter_one(shape.mesh)
        reference = fit(mesh).primitives
        for kind, other in disturbed(mesh, rng):
            scores[kind].append(shape_score(reference, fit(other).primitives))
    ratios, solid = [row.volume_ratio for row in rows], [row.iou for row in rows if row.kind != "envelope"]
    proven = [row.grown.certificate.holds and not row.grown.is_fallback for row in rows]
    of, role = f"{len(rows)} closed meshes by others", "reported" if half == "foreign" else "tuned"
    return [
        mean(f"{half}_iou_mean", [row.iou for row in rows], "", "higher", of, role=role),
        mean(f"{half}_iou_without_envelopes", solid, "", "higher", f"{len(solid)} of {of}", role=role),
        figure(f"{half}_iou_min_without_envelopes", min(solid), "", "higher", of, role=role),
        figure(f"{half}_envelopes", len(rows) - len(solid), "", "lower", of, role=role),
        mean(f"{half}_inflated_ratio", ratios, "x", "lower", of, role=role),
        figure(f"{half}_inflated_ratio_max", max(ratios), "x", "lower", of, role=role),
        figure(f"{half}_certified_fraction", np.mean(proven), "", "higher", of, role=role),
        mean(f"{half}_fit_seconds", [row.fit_seconds for row in rows], "s", "lower", of, role=role),
        mean(f"{half}_inflate_seconds", [row.inflate_seconds for row in rows], "s", "lower", of, role=role),
        *(mean(f"{half}_{kind}", values, "", "higher", of, role=role) for kind, values in scores.items()),
    ]
