"""Layer 2 by a generator: placement, judgement, blending, on an oracle that spoils the truth by seed.

Nothing here needs a network: the oracle takes its place, so that each step after it is measured by itself.
"""

from __future__ import annotations

import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy.spatial import cKDTree

from hickory_stream.evaluation.exposed import exposed_samples
from hickory_stream.evaluation.surface_score import diameter_m
from hickory_stream.geometry.rigid import apply
from hickory_stream.ports import MeshPlacement, Reconstruction
from hickory_stream.shapes.blend import BlendConfig, blended
from hickory_stream.shapes.distance_field import even_samples
from hickory_stream.shapes.fused import FusedConfig, FusedReconstructor, VolumeConfig
from hickory_stream.shapes.judgement import JudgementConfig, ShapeEvidence, judged, shape_evidence
from hickory_stream.shapes.placement import EmbeddedPlacement, PlacementConfig
from tools.benchmarks.adapter_fakes import ADAPTERS, REFINERS, adapter_fault, refiner_fault
from tools.benchmarks.figures import Figure, Options
from tools.benchmarks.foreign_logs import worlds_folder
from tools.benchmarks.intervals import bootstrap, wilson
from tools.benchmarks.layer2_objects import TUNED_WORLDS, foreign_subjects, own_subjects
from tools.benchmarks.oracle import Generated, Sighted, generated, plain_mesh, sighted
from tools.benchmarks.view_trials import view_figures

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.geometry.mesh import Mesh
    from tools.benchmarks.layer2_objects import Subject

_SAMPLES = 3000
_ADDS = 0.05
# A swapped object whose surface, placed, is the truth's to this F1 at 5 % of the diameter cannot be told from it.
_SAME_F1 = 0.8
_MAX_VIEWS = 6
# Seeds on which the thresholds of placement and judgement were chosen; what is reported has others.
TUNED_SEEDS = (0, 1, 7)
_SEED = 100
_PROCESSES = 2
_MORE_SWAPPED = 5
Fate = Literal["plain", "spoiled", "swapped"]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Row:
    """One trial: what the oracle gave, where it was put, and how near to the truth that is."""

    kind: str
    given: Generated
    placement: MeshPlacement | None
    adds: float
    scale_error: float
    seconds: float
    f1: float
    evidence: ShapeEvidence | None
    seen: Sighted


def measure(options: Options) -> list[Figure]:
    """Return the figures, and print the trials that failed; `--only views` measures the choice of views alone."""
    figures = view_figures(options) if "views" in options.only else []
    return figures if options.only == ("views",) else [*figures, *_of_oracles(options)]


def _of_oracles(options: Options) -> list[Figure]:
    count = 10 if options.quick else 114
    seed = _SEED + options.seed
    subjects = own_subjects(count, seed)
    subjects += foreign_subjects(worlds_folder(options.worlds), TUNED_WORLDS, most=4 if options.quick else None)
    where = "own worlds, home and bookstore"
    with ProcessPoolExecutor(_PROCESSES, mp_context=multiprocessing.get_context("spawn")) as pool:
        plain = _trials(pool, subjects, seed, "plain")
        spoiled = _trials(pool, subjects, seed + 1, "spoiled")
        swapped = _trials(pool, subjects, seed + 2, "swapped")
        # One in twelve differs from the truth: of the own worlds more are made, until some fifty do.
        for more in range(0 if options.quick else _MORE_SWAPPED):
            swapped += _trials(pool, own_subjects(count, seed + 1000 + more), seed + 2000 + more, "swapped")
        strange = _trials(pool, _exchanged(subjects), seed + 3, "swapped")
        figures = _of_placement(plain, spoiled, where) + _of_judgement(spoiled, swapped, strange)
        figures += _of_blending(pool, spoiled[: 8 if options.quick else None])
    sound = [name for name in ADAPTERS if adapter_fault(name) == ""]
    sound += [name for name in REFINERS if refiner_fault(name) == ""]
    told = f"of {len(ADAPTERS) + len(REFINERS)} adapters: {', '.join(sound)}; against fakes of their packages"
    return [*figures, Figure(name="adapters_checked", value=len(sound), unit="", better="higher", of=told)]


def _exchanged(subjects: list[Subject]) -> list[Subject]:
    """Return the subjects, each of which would be given the thing of another kind."""
    shift = next((n for n in range(1, len(subjects)) if subjects[n].kind != subjects[0].kind), 0)
    turned = [*subjects[shift:], *subjects[:shift]]
    pairs = zip(subjects, turned, strict=True)
    return [replace(own, other=given.mesh) for own, given in pairs if own.kind != given.kind]


# ---- trials ---------------------------------------------------------------------------------------------------------


def _trials(pool: ProcessPoolExecutor, subjects: list[Subject], seed: int, how: Fate) -> list[Row]:
    rows = []
    for row in pool.map(partial(_trial, seed=seed, how=how), subjects, range(len(subjects))):
        if row is None:
            continue
        rows.append(row)
        if how != "swapped" and not row.adds < _ADDS:
            views = len(row.seen.made_from.crops)
            print(f"{how} {row.kind}, {views} views: ADD-S {row.adds:.3f} d, F1 {row.f1:.2f}", flush=True)
    return rows


def _trial(subject: Subject, index: int, *, seed: int, how: Fate) -> Row | None:
    rng = np.random.default_rng([seed, index])
    seen = sighted(subject.mesh, rng, int(rng.integers(1, _MAX_VIEWS + 1)))
    if seen is None:
        return None
    other = (subject.other or subject.mesh) if how == "swapped" else None
    given = generated(seen, rng, is_spoiled=how != "plain", other=other)
    return _row(subject.kind, seen, given, EmbeddedPlacement(PlacementConfig()))


def _row(kind: str, seen: Sighted, given: Generated, refiner: EmbeddedPlacement) -> Row:
    started = time.process_time()
    placement = refiner.place(given.mesh, seen.made_from)
    seconds = time.process_time() - started
    if not isinstance(placement, MeshPlacement):
        return Row(
            kind=kind, given=given, placement=None, adds=np.inf, scale_error=np.inf, seconds=seconds, f1=0.0,
            evidence=None, seen=seen,
        )  # fmt: skip
    true = _exposed(seen.mesh_world)
    diameter = diameter_m(seen.mesh_world.vertices)
    # What the truth becomes by all that is affine: the oracle's transform, then the placement.
    carried = placement.world_from_mesh @ given.mesh_from_true
    moved = apply(carried, true)
    world = placed_mesh(given.mesh, placement)
    evidence = shape_evidence(
        Reconstruction(mesh=world, world_from_object=np.eye(4)), seen.made_from, 1, JudgementConfig()
    )
    return Row(
        kind=kind,
        given=given,
        placement=placement,
        adds=float(cKDTree(moved).query(true)[0].mean() / diameter),
        scale_error=float(abs(np.cbrt(abs(np.linalg.det(carried[:3, :3]))) - 1)),
        seconds=seconds,
        f1=f1_at(true, _exposed(world), 0.05 * diameter),
        evidence=evidence,
        seen=seen,
    )


def _exposed(mesh: Mesh) -> NDArray[np.float64]:
    """Return (N, 3) samples of what can be seen of a mesh from outside: models have parts within others.

    A mesh that is made of a solid has none of that surface: with it in the truth, the F1 of a bed is 0.87 at best.
    """
    return exposed_samples(mesh, 2 * _SAMPLES, np.random.default_rng(0))[0][:_SAMPLES].astype(np.float64)


def placed_mesh(mesh: Mesh, placement: MeshPlacement) -> Mesh:
    """Return the mesh in the world."""
    return plain_mesh(apply(placement.world_from_mesh, mesh.vertices.astype(np.float64)), mesh.faces)


def f1_at(true: NDArray[np.float64], found: NDArray[np.float64], reach_m: float) -> float:
    """Return F1 of two sets of (N, 3) surface samples at a distance."""
    recall = float((cKDTree(found).query(true)[0] <= reach_m).mean())
    precision = float((cKDTree(true).query(found)[0] <= reach_m).mean())
    return 2 * recall * precision / (recall + precision) if recall + precision > 0 else 0.0


# ---- figures --------------------------------------------------------------------------------------------------------


def _of_placement(plain: list[Row], spoiled: list[Row], where: str) -> list[Figure]:
    seconds = [row.seconds for row in [*plain, *spoiled][1:]]
    errors = [row.scale_error for row in plain if np.isfinite(row.scale_error)]
    return [
        _share("placement_adds_05", [row.adds < _ADDS for row in plain], f"undistorted objects of {where}"),
        _share("placement_adds_05_spoiled", [row.adds < _ADDS for row in spoiled], f"spoiled objects of {where}"),
        Figure(
            name="placement_scale_error", value=100 * float(np.median(errors)), unit="%", better="lower",
            of=f"median of {len(errors)} undistorted objects",
        ),
        Figure(
            name="placement_seconds", value=float(np.mean(seconds)), unit="s", better="lower",
            of=f"mean processor seconds of {len(seconds)} placements",
        ),
    ]  # fmt: skip


def _of_judgement(spoiled: list[Row], swapped: list[Row], strange: list[Row]) -> list[Figure]:
    config = JudgementConfig()
    refused = []
    for row in spoiled:
        verdict = judged(row.evidence, config) if row.evidence is not None else None
        refused.append(verdict is None or not verdict.is_accepted)
        if refused[-1]:
            print(f"good one refused, {row.kind}, F1 {row.f1:.2f}: {verdict.reason if verdict else 'not placed'}")
    figures = []
    # The mirror image of a stranger's victim says nothing that that of a swapped one does not.
    strangers = [row for row in strange if row.given.fate == "other"]
    for name, rows, what in (
        ("wrong_accepted_fraction", swapped, "objects swapped for another of the class, or mirrored,"),
        ("stranger_accepted_fraction", strangers, "objects swapped for one of another class"),
    ):
        wrong = [row for row in rows if row.f1 < _SAME_F1]
        accepted = [row.evidence is not None and judged(row.evidence, config).is_accepted for row in wrong]
        for row in (row for row, is_in in zip(wrong, accepted, strict=True) if is_in):
            print(f"{name}: {row.kind} ({row.given.fate}), F1 {row.f1:.2f}: {row.evidence}")
        if wrong:
            told = f"{what} whose F1 at 5 % of the diameter, placed, is under {_SAME_F1}"
            figures.append(_share(name, accepted, told, better="lower"))
    return [*figures, _share("good_refused_fraction", refused, "spoiled objects", better="lower")]


def _of_blending(pool: ProcessPoolExecutor, rows: list[Row]) -> list[Figure]:
    """Return F1 of the blended and of the fused shape at 5 % of the diameter, over the objects that have both."""
    scores = []
    for row, score in zip(rows, pool.map(_blended_and_fused, rows), strict=True):
        if score is not None:
            scores.append(score)
            views = len(row.seen.made_from.crops)
            print(f"blended {row.kind}, {views} views: F1 {score[0]:.3f}, fused {score[1]:.3f}", flush=True)
    if not scores:
        return []
    values = np.array(scores)
    of = f"mean of {len(values)} spoiled objects that were accepted, each seen from 1 to {_MAX_VIEWS} places"
    return [
        Figure(
            name=name, value=float(column.mean()), unit="", better="higher", of=of,
            interval=bootstrap([column[:, None]], lambda groups: float(groups[0].mean())), interval_by="bootstrap",
        )
        for name, column in zip(("blended_f1_5pct", "fused_f1_5pct"), values.T, strict=True)
    ]  # fmt: skip


def _blended_and_fused(row: Row) -> tuple[float, float] | None:
    """Return F1 of the blended and of the fused shape; None where the generated one is refused, or either fails."""
    if row.placement is None or row.evidence is None or not judged(row.evidence, JudgementConfig()).is_accepted:
        return None
    world = Reconstruction(mesh=placed_mesh(row.given.mesh, row.placement), world_from_object=np.eye(4))
    made = blended(world, row.seen.made_from, VolumeConfig(), BlendConfig())
    fused = FusedReconstructor(FusedConfig()).reconstruct(row.seen.made_from)
    if not (isinstance(made, Reconstruction) and isinstance(fused, Reconstruction)):
        return None
    return _f1_of(made, row.seen), _f1_of(fused, row.seen)


def _f1_of(shape: Reconstruction, seen: Sighted) -> float:
    found, _ = even_samples(shape.mesh.vertices, shape.mesh.faces, _SAMPLES)
    found = apply(shape.world_from_object, found)
    return f1_at(_exposed(seen.mesh_world), found, 0.05 * diameter_m(seen.mesh_world.vertices))


def _share(name: str, values: list[bool], of: str, *, better: Literal["higher", "lower"] = "higher") -> Figure:
    found = sum(bool(value) for value in values)
    return Figure(
        name=name, value=found / len(values), unit="", better=better, of=f"{found} of {len(values)} {of}",
        interval=wilson(found, len(values)), interval_by="Wilson",
    )  # fmt: skip
