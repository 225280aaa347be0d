"""A map against truth: detection, surfaces, containment, poses and masks, each as `evaluate --explain` defines it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.evaluation.exposed import exposed_samples
from hickory_stream.evaluation.match import Score, meshes_of, score_map
from hickory_stream.evaluation.placement import placed_truth
from hickory_stream.evaluation.purity import purity
from hickory_stream.evaluation.seen_samples import seen_samples
from hickory_stream.evaluation.surface_score import SAMPLES, TrueSurface, diameter_m, surface_score
from hickory_stream.evaluation.trajectory_error import PoseError, pose_error
from hickory_stream.evaluation.truth import instances_of, mesh_of, moved_mesh, structure_meshes
from hickory_stream.geometry.superquadric import implicit_value
from hickory_stream.map_folder.views import read_mask

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from hickory_stream.evaluation.match import TruthScore
    from hickory_stream.evaluation.placement import Placement, ViewFrame
    from hickory_stream.evaluation.surface_score import SurfaceScore
    from hickory_stream.evaluation.truth import Truth, TruthObject
    from hickory_stream.geometry.mesh import Mesh
    from hickory_stream.geometry.superquadric import Superquadrics
    from hickory_stream.map_folder.saved_map import SavedMap
    from hickory_stream.records import TrackedObject

_LOOSE_ADD_S, _STRICT_ADD_S = 0.1, 0.05


@dataclass(frozen=True, kw_only=True, slots=True)
class ObjectEvaluation:
    """What became of one true object that counts.

    `map_id` is its match at IoU 0.25, `strict_map_id` that at 0.5, and `track_ids` all objects that lie mostly on it.
    The surface figures compare layer 2 of the match; without a layer 2, F1 is 0 and ADD-S None. `contained` is the
    share of the object's `num_seen` visible samples that lie inside layer 4 of the match, None without a layer 4.
    """

    truth_id: int
    kind: str
    diameter_m: float
    seen_fraction: float
    map_id: int | None
    iou: float
    strict_map_id: int | None
    track_ids: tuple[int, ...]
    f1_1cm: float
    f1_5pct: float
    add_s_m: float | None
    contained: float | None
    num_seen: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Evaluation:
    """Scores of a map; plain means are over all true objects that count, `matched_*` only over those that have a match.

    `containment` is over all visible samples of objects with layer 4, None if there are none; `poses` and `mask_purity`
    are None if the map keeps no views. `placement` is the transform by which the truth was moved into the map's world,
    if the log's odometry has an origin of its own.
    """

    num_truth: int
    num_objects: int
    recall_25: float
    precision_25: float
    recall_50: float
    precision_50: float
    tracks_per_object: float
    f1_1cm: float
    f1_5pct: float
    matched_f1_5pct: float
    adds_10: float
    adds_05: float
    containment: float | None
    poses: PoseError | None
    mask_purity: float | None
    median_diameter_m: float
    objects: tuple[ObjectEvaluation, ...]
    stray_ids: tuple[int, ...]
    ignored_ids: tuple[int, ...]
    placement: Placement | None


def evaluate(saved: SavedMap, truth: Truth) -> Evaluation:
    """Return how a map compares with truth.

    Raises:
        RecordingError: the truth is not of this map's log, or a file of it is missing or damaged.
        MapFolderError: a mesh or a view of the map cannot be read.
    """
    placed = placed_truth(saved, truth)
    truth = placed.truth
    meshes = meshes_of(saved)
    detection = score_map(saved.snapshot, meshes, truth)
    surfaces = {item.id: true_surface(truth, item) for item in truth.objects}
    seen = seen_samples(truth, surfaces, structure_meshes(truth))
    by_id = {tracked.id: tracked for tracked in saved.snapshot.objects}
    rows = tuple(
        _object_row(row, by_id, meshes, surfaces[row.truth_id], seen[row.truth_id])
        for row in detection.truth
        if row.counts
    )
    purity_of_masks = _mask_purity(saved, truth, placed.views)
    return _summary(detection, rows, _contained(rows, seen), _poses(placed.views), purity_of_masks, placed.placement)


def placed_mesh(tracked: TrackedObject, meshes: Mapping[int, Mesh]) -> Mesh | None:
    """Return layer 2 of an object in the world, None where it has none."""
    if tracked.shape is None or tracked.id not in meshes:
        return None
    return moved_mesh(meshes[tracked.id], tracked.shape.world_from_object)


def true_mesh_world(truth: Truth, item: TruthObject) -> Mesh:
    """Return the mesh of a true object in the world."""
    return moved_mesh(mesh_of(truth, item), item.world_from_object)


def is_inside(primitives: Superquadrics, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which of (N, 3) points lie in the union of primitives."""
    inside = np.zeros(len(points), dtype=bool)
    for i in range(len(primitives)):
        inside |= implicit_value(primitives, i, points) <= 1.0
    return inside


def true_surface(truth: Truth, item: TruthObject) -> TrueSurface:
    """Return the surface of a true object in the world, with samples of what is visible from outside."""
    mesh = true_mesh_world(truth, item)
    samples, _ = exposed_samples(mesh, SAMPLES, np.random.default_rng(item.id))
    return TrueSurface(mesh=mesh, samples=samples.astype(np.float64))


def _object_row(
    row: TruthScore,
    by_id: Mapping[int, TrackedObject],
    meshes: Mapping[int, Mesh],
    true: TrueSurface,
    seen: NDArray[np.bool_],
) -> ObjectEvaluation:
    tracked = by_id[row.map_id] if row.map_id is not None else None
    mesh = placed_mesh(tracked, meshes) if tracked is not None else None
    score: SurfaceScore | None = None
    contained = None
    if tracked is not None and mesh is not None and tracked.shape is not None:
        score = surface_score(true, mesh, np.random.default_rng(row.truth_id))
        if seen.any() and len(tracked.shape.inflated):
            contained = float(is_inside(tracked.shape.inflated, true.samples[seen]).mean())
    return ObjectEvaluation(
        truth_id=row.truth_id,
        kind=row.kind,
        diameter_m=diameter_m(true.mesh.vertices),
        seen_fraction=row.seen_fraction,
        map_id=row.map_id,
        iou=row.iou,
        strict_map_id=row.strict_map_id,
        track_ids=row.track_ids,
        f1_1cm=score.f1_1cm if score is not None else 0.0,
        f1_5pct=score.f1_5pct if score is not None else 0.0,
        add_s_m=score.add_s_m if score is not None else None,
        contained=contained,
        num_seen=int(seen.sum()),
    )


def _summary(
    detection: Score,
    rows: tuple[ObjectEvaluation, ...],
    containment: float | None,
    poses: PoseError | None,
    mask_purity: float | None,
    placement: Placement | None,
) -> Evaluation:
    matched = [row.f1_5pct for row in rows if row.map_id is not None]

    def success(limit: float) -> float:
        return float(np.mean([row.add_s_m is not None and row.add_s_m < limit * row.diameter_m for row in rows]))

    return Evaluation(
        num_truth=detection.num_truth,
        num_objects=detection.num_objects,
        recall_25=detection.recall_25,
        precision_25=detection.precision_25,
        recall_50=detection.recall_50,
        precision_50=detection.precision_50,
        tracks_per_object=detection.tracks_per_object,
        f1_1cm=float(np.mean([row.f1_1cm for row in rows])),
        f1_5pct=float(np.mean([row.f1_5pct for row in rows])),
        matched_f1_5pct=float(np.mean(matched)) if matched else 0.0,
        adds_10=success(_LOOSE_ADD_S),
        adds_05=success(_STRICT_ADD_S),
        containment=containment,
        poses=poses,
        mask_purity=mask_purity,
        median_diameter_m=float(np.median([row.diameter_m for row in rows])),
        objects=rows,
        stray_ids=detection.stray_ids,
        ignored_ids=detection.ignored_ids,
        placement=placement,
    )


def _contained(rows: tuple[ObjectEvaluation, ...], seen: Mapping[int, NDArray[np.bool_]]) -> float | None:
    weights = [(int(seen[row.truth_id].sum()), row.contained) for row in rows if row.contained is not None]
    total = sum(count for count, _ in weights)
    return sum(count * share for count, share in weights) / total if total else None


def _poses(views: Sequence[ViewFrame]) -> PoseError | None:
    by_index = {v.frame.index: (v.world_from_camera[:3, 3], v.frame.world_from_camera[:3, 3]) for v in views}
    if not by_index:
        return None
    found, true = zip(*(by_index[i] for i in sorted(by_index)), strict=True)
    return pose_error(np.array(found), np.array(true))


def _mask_purity(saved: SavedMap, truth: Truth, views: Sequence[ViewFrame]) -> float | None:
    boxes = {view.name: view.box_px for tracked in saved.snapshot.objects for view in tracked.views}
    by_frame: dict[int, list[str]] = {}
    true_frames = {view.frame.index: view.frame for view in views}
    for view in views:
        by_frame.setdefault(view.frame.index, []).append(view.name)
    shares = []
    for index, names in by_frame.items():
        instances = instances_of(truth, true_frames[index])
        shares += [purity(read_mask(saved.views, name), boxes[name], instances) for name in names]
    known = [share for share in shares if share is not None]
    return float(np.mean(known)) if known else None
