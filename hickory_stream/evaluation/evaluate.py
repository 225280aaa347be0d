"""A map against truth: detection, surfaces, containment, poses and masks; `evaluate --explain` defines each figure."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from hickory_stream.evaluation.exposed import exposed_samples
from hickory_stream.evaluation.match import Counts, Score, TruthScore, meshes_of, score_map
from hickory_stream.evaluation.placement import PlacedTruth, Placement, ViewFrame, placed_truth
from hickory_stream.evaluation.reach import depth_on_objects
from hickory_stream.evaluation.surface_score import SAMPLES, TrueSurface, diameter_m, invented_m3, surface_score
from hickory_stream.evaluation.trajectory_error import PoseError, pose_error
from hickory_stream.evaluation.truth import (
    Truth,
    TruthFrame,
    TruthObject,
    instances_of,
    mesh_of,
    moved_mesh,
    structure_meshes,
)
from hickory_stream.geometry.camera import project
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.geometry.superquadric import Superquadrics, implicit_value
from hickory_stream.map_folder.saved_map import SavedMap
from hickory_stream.map_folder.views import read_crop
from hickory_stream.pictures.raycast import Scene, surface_of_mesh
from hickory_stream.records import TrackedObject


def purity(mask: NDArray[np.bool_], box_px: tuple[int, int, int, int], instances: NDArray[np.uint16]) -> float | None:
    """Return the share of a mask's pixels that show its most frequent true instance; the background counts as one.

    `mask` is cut out along its bounds `box_px` (x0, y0, x1, y1) in the (H, W) image. None if the mask is empty or the
    bounds do not fit.
    """
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    x0, y0, x1, y1 = box_px
    if len(rows) == 0 or y1 > instances.shape[0] or x1 > instances.shape[1]:
        return None
    inner = mask[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    shown = instances[y0:y1, x0:x1]
    if inner.shape != shown.shape:
        return None
    _, counts = np.unique(shown[inner], return_counts=True)
    return float(counts.max() / counts.sum())


_FRAMES = 120
_RANGE_M = (0.3, 8.0)
_OFF_SURFACE_M = 0.003


def seen_samples(
    truth: Truth, surfaces: Mapping[int, TrueSurface], structure: Sequence[Mesh]
) -> dict[int, NDArray[np.bool_]]:
    """Return which samples of each true object are visible in any of at most 120 evenly spread frames.

    Visible: the pixel shows the object at 0.3 to 8 m, and nothing occludes the sample. Raises `RecordingError` for a
    missing or damaged instance image.
    """
    solids = [surface.mesh for surface in surfaces.values()] + list(structure)
    scene = Scene([surface_of_mesh(mesh) for mesh in solids])
    seen = {i: np.zeros(len(surface.samples), dtype=bool) for i, surface in surfaces.items()}
    shown = {item.id: set(item.frames) for item in truth.objects}
    last = len(truth.frames) - 1
    for k in sorted({round(place) for place in np.linspace(0, last, _FRAMES).tolist()} if last >= 0 else ()):
        frame = truth.frames[k]
        ids = [i for i in surfaces if frame.index in shown[i] and not seen[i].all()]
        if ids:
            _mark(truth, frame, {i: surfaces[i] for i in ids}, scene, seen)
    return seen


def _mark(
    truth: Truth,
    frame: TruthFrame,
    surfaces: Mapping[int, TrueSurface],
    scene: Scene,
    seen: dict[int, NDArray[np.bool_]],
) -> None:
    instances, camera = instances_of(truth, frame), frame.camera or truth.camera
    camera_from_world, eye = invert(frame.world_from_camera), frame.world_from_camera[:3, 3]
    for i, surface in surfaces.items():
        open_ = np.flatnonzero(~seen[i])
        points_camera = apply(camera_from_world, surface.samples[open_])
        near = (points_camera[:, 2] > _RANGE_M[0]) & (points_camera[:, 2] < _RANGE_M[1])
        open_, points_camera = open_[near], points_camera[near]
        uv = np.round(project(points_camera, camera)).astype(np.int64)
        inside = (uv >= 0).all(axis=1) & (uv < (camera.width, camera.height)).all(axis=1)
        open_, uv = open_[inside], uv[inside]
        shows = instances[uv[:, 1], uv[:, 0]] == i
        open_ = open_[shows]
        if len(open_) == 0:
            continue
        towards = eye - surface.samples[open_]
        length = np.linalg.norm(towards, axis=1)
        towards = towards / length[:, None]
        # No surface between the camera and the sample; samples that face away are occluded by their own object.
        free_m = scene.distances_m(surface.samples[open_] + _OFF_SURFACE_M * towards, towards)
        seen[i][open_[free_m > length - 2 * _OFF_SURFACE_M]] = True


_LOOSE_ADD_S, _STRICT_ADD_S = 0.1, 0.05


@dataclass(frozen=True, kw_only=True, slots=True)
class ObjectEvaluation(TruthScore):
    """Scores of one true object that counts.

    Surface figures compare layer 2 of the match; without a layer 2, F1 is 0 and the others None.
    """

    diameter_m: float
    seen_fraction: float
    f1_1cm: float
    f1_5pct: float
    add_s_m: float | None
    #: share of its `num_seen` visible samples inside layer 4 of the match, None without a layer 4
    contained: float | None
    num_seen: int
    #: volume of layer 2 farther than 5 cm outside the true object, and the true volume
    invented_m3: float | None
    true_m3: float | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Evaluation(Counts):
    """Scores of a map; plain means are over all true objects that count, `matched_*` over those with a match.

    `containment` is over visible samples of objects with layer 4; `poses` and `mask_purity` need kept views.
    `placement` moves the truth into the map's world if the log's odometry has its own origin.
    """

    f1_1cm: float
    f1_5pct: float
    matched_f1_5pct: float
    adds_10: float
    adds_05: float
    containment: float | None
    #: invented over true volume of the matched with layer 2
    invented_volume: float | None
    poses: PoseError | None
    mask_purity: float | None
    median_diameter_m: float
    objects: tuple[ObjectEvaluation, ...]
    placement: Placement | None


def evaluate(saved: SavedMap, truth: Truth, detection: Score | None = None) -> Evaluation:
    """Return the scores of a map against truth; a known `detection` (`why.investigate`) saves reading the journal.

    Raises `RecordingError` for the truth of another log or a damaged file, `MapFolderError` for a mesh or a view.
    """
    placed = placed_truth(saved, truth)
    truth = placed.truth
    meshes = meshes_of(saved)
    detection = detection or score_map(saved.snapshot, meshes, truth, depth_on_objects(saved, truth))
    structure = structure_meshes(truth)
    walls = Scene([surface_of_mesh(mesh) for mesh in structure])
    surfaces = {item.id: true_surface(truth, item) for item in truth.objects}
    seen = seen_samples(truth, surfaces, structure)
    by_id = {tracked.id: tracked for tracked in saved.snapshot.objects}
    shown = {item.id: item.seen_fraction for item in truth.objects}
    rows = tuple(
        _object_row(row, shown[row.truth_id], by_id, meshes, surfaces[row.truth_id], seen[row.truth_id], walls)
        for row in detection.truth
        if row.counts
    )
    return _summary(detection, rows, placed, _mask_purity(saved, truth, placed.views))


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
    seen_fraction: float,
    by_id: Mapping[int, TrackedObject],
    meshes: Mapping[int, Mesh],
    true: TrueSurface,
    seen: NDArray[np.bool_],
    walls: Scene,
) -> ObjectEvaluation:
    tracked = by_id[row.map_id] if row.map_id is not None else None
    mesh = placed_mesh(tracked, meshes) if tracked is not None else None
    score = surface_score(true, mesh, np.random.default_rng(row.truth_id)) if mesh is not None else None
    invented, volume = invented_m3(mesh, true.mesh, walls) if mesh is not None else (None, None)
    contained = None
    if tracked is not None and tracked.shape is not None and mesh is not None and seen.any():
        if len(tracked.shape.inflated):
            contained = float(is_inside(tracked.shape.inflated, true.samples[seen]).mean())
    return ObjectEvaluation(
        **{field.name: getattr(row, field.name) for field in fields(TruthScore)},
        diameter_m=diameter_m(true.mesh.vertices),
        seen_fraction=seen_fraction,
        f1_1cm=score.f1_1cm if score is not None else 0.0,
        f1_5pct=score.f1_5pct if score is not None else 0.0,
        add_s_m=score.add_s_m if score is not None else None,
        contained=contained,
        num_seen=int(seen.sum()),
        invented_m3=invented,
        true_m3=volume,
    )


def _summary(
    detection: Score,
    rows: tuple[ObjectEvaluation, ...],
    placed: PlacedTruth,
    mask_purity: float | None,
) -> Evaluation:
    matched = [row.f1_5pct for row in rows if row.map_id is not None]
    inside = [(row.contained * row.num_seen, row.num_seen) for row in rows if row.contained is not None]

    def success(limit: float) -> float:
        return float(np.mean([row.add_s_m is not None and row.add_s_m < limit * row.diameter_m for row in rows]))

    return Evaluation(
        **{field.name: getattr(detection, field.name) for field in fields(Counts)},
        f1_1cm=float(np.mean([row.f1_1cm for row in rows])),
        f1_5pct=float(np.mean([row.f1_5pct for row in rows])),
        matched_f1_5pct=float(np.mean(matched)) if matched else 0.0,
        adds_10=success(_LOOSE_ADD_S),
        adds_05=success(_STRICT_ADD_S),
        containment=_quotient(inside),
        invented_volume=_quotient([(row.invented_m3 or 0.0, row.true_m3 or 0.0) for row in rows]),
        poses=_poses(placed.views),
        mask_purity=mask_purity,
        median_diameter_m=float(np.median([row.diameter_m for row in rows])),
        objects=rows,
        placement=placed.placement,
    )


def _quotient(pairs: Sequence[tuple[float, float]]) -> float | None:
    total = sum(whole for _, whole in pairs)
    return sum(part for part, _ in pairs) / total if total else None


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
        shares += [purity(read_crop(saved.views, name).mask, boxes[name], instances) for name in names]
    known = [share for share in shares if share is not None]
    return float(np.mean(known)) if known else None
