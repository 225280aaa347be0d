"""Matching of mapped objects with true ones, and recall and precision from it.

An object's box is the gravity-aligned box of layer 2 (else layer 1). A true object counts if at least 30 % of its
surface was seen; others, and objects mapped on them, are ignored. Tentative tracks are not counted. A fixture matches
as an object does; a fixture on true structure is neither right nor false.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from hickory_stream.errors import RecordingError
from hickory_stream.evaluation.surface_score import area_m2, generated_m2
from hickory_stream.evaluation.truth import Truth, TruthObject, mesh_of, moved_mesh, structure_meshes
from hickory_stream.geometry.boxes import OrientedBox, box_iou, gravity_aligned_box
from hickory_stream.geometry.depth_sensor import DepthSensor
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.rigid import apply
from hickory_stream.map_folder.saved_map import SavedMap
from hickory_stream.pictures.raycast import Scene, Surface, surface_of_mesh
from hickory_stream.records import MapSnapshot, Phase, TrackedObject

MIN_SEEN, MIN_DEPTH_KEYFRAMES = 0.3, 3
LOOSE_IOU, STRICT_IOU = 0.25, 0.5
SURFACE_REACH_M = 0.03
STRUCTURE = -2
_MIN_HALF_EXTENT_M = 0.005
_MAX_POINTS = 3000
# More than rounding takes off the bounds of a box.
_SLACK_M = 1e-4


@dataclass(frozen=True, kw_only=True, slots=True)
class BoxMatch:
    """A pair of boxes by their indices."""

    truth_index: int
    map_index: int
    iou: float


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TrueBox:
    """A true object by its box, or by several, of which the one with the largest IoU is compared."""

    id: int
    kind: str
    counts: bool
    boxes: tuple[OrientedBox, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class TruthScore:
    """Outcome of one true object; `counts` is False if too little of it was seen, or a label says so."""

    truth_id: int
    kind: str
    counts: bool
    #: match at IoU 0.25; `iou` is 0 without one
    map_id: int | None
    iou: float
    #: match at IoU 0.5
    strict_map_id: int | None
    #: all objects that lie mostly on it
    track_ids: tuple[int, ...]
    #: `map_id` is a fixture
    is_fixture: bool
    #: at least three keyframes have depth on it; None without a journal
    is_reachable: bool | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Counts:
    """Figures of boxes.

    Recall is the matched share of the `num_truth` true objects that count, or of the `num_reachable` (None without a
    journal); precision of the `num_objects`.
    """

    num_truth: int
    num_reachable: int | None
    num_objects: int
    recall_25: float
    recall_50: float
    reachable_recall_25: float | None
    reachable_recall_50: float | None
    precision_25: float
    precision_50: float
    #: mean number of mapped objects on a true object that has any
    tracks_per_object: float
    #: share of the matched true objects whose match is a fixture
    fixture_share: float | None
    #: share of the surface of layer 2 that is generated
    generated_share: float | None
    #: objects on no true object
    stray_ids: tuple[int, ...]
    #: objects on ignored truth; unless matched, they do not change precision
    ignored_ids: tuple[int, ...]
    #: fixtures on true structure without a match; they do not change precision
    structure_ids: tuple[int, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class Score(Counts):
    """Comparison of a map with truth."""

    truth: tuple[TruthScore, ...]


def match_boxes(
    truth_boxes: Sequence[OrientedBox], map_boxes: Sequence[OrientedBox], min_iou: float = LOOSE_IOU
) -> tuple[BoxMatch, ...]:
    """Return one-to-one pairs of IoU `min_iou` or more with the largest sum, in the order of truth."""
    return _matches(box_ious(truth_boxes, map_boxes), min_iou)


def box_ious(truth_boxes: Sequence[OrientedBox], map_boxes: Sequence[OrientedBox]) -> NDArray[np.float64]:
    """Return the (N, M) IoUs of boxes; computed where their bounds meet, which is rare in a building."""
    ious = np.zeros((len(truth_boxes), len(map_boxes)))
    if ious.size == 0:
        return ious
    lows, highs = _bounds(map_boxes)
    for i, (truth, low, high) in enumerate(zip(truth_boxes, *_bounds(truth_boxes), strict=True)):
        for j in np.flatnonzero(((lows <= high) & (low <= highs)).all(axis=1)).tolist():
            ious[i, j] = box_iou(truth, map_boxes[j])
    return ious


def _bounds(boxes: Sequence[OrientedBox]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    corners = np.array([box.corners_world() for box in boxes])
    return corners.min(axis=1) - _SLACK_M, corners.max(axis=1) + _SLACK_M


def _matches(ious: NDArray[np.float64], min_iou: float) -> tuple[BoxMatch, ...]:
    if ious.size == 0:
        return ()
    ious = np.where(ious >= min_iou, ious, 0.0)
    rows, columns = linear_sum_assignment(ious, maximize=True)
    return tuple(
        BoxMatch(truth_index=int(i), map_index=int(j), iou=float(ious[i, j]))
        for i, j in zip(rows, columns, strict=True)
        if ious[i, j] > 0
    )


def score_map(
    snapshot: MapSnapshot, meshes: Mapping[int, Mesh], truth: Truth, depth_on: Mapping[int, int] | None = None
) -> Score:
    """Return the score of a map; `meshes` holds layer 2 by object id, in the object frames. Raises `RecordingError`."""
    if not any(item.seen_fraction >= MIN_SEEN for item in truth.objects):
        raise RecordingError(f"{truth.folder} has no object of which {MIN_SEEN:.0%} was seen; record a longer log")
    surfaces = [surface_of(truth, item) for item in truth.objects]
    boxes = [gravity_aligned_box(surface.vertices, _MIN_HALF_EXTENT_M) for surface in surfaces]
    true = [
        TrueBox(id=item.id, kind=item.kind, counts=item.seen_fraction >= MIN_SEEN, boxes=(box,))
        for item, box in zip(truth.objects, boxes, strict=True)
    ]
    all_of_it = Scene([*surfaces, *structure_surfaces(truth)])
    return score_of(
        true, snapshot, meshes, depth_on, owner_of=lambda tracked: _owner(tracked, all_of_it),
        is_structure=lambda fixture: _lies_on_structure(fixture, all_of_it),
    )  # fmt: skip


def score_of(
    true: Sequence[TrueBox],
    snapshot: MapSnapshot,
    meshes: Mapping[int, Mesh],
    depth_on: Mapping[int, int] | None,
    *,
    owner_of: Callable[[TrackedObject], int | None],
    is_structure: Callable[[TrackedObject], bool],
) -> Score:
    """Return the score of a map against boxes.

    `owner_of` returns the true object that an object lies on, if any; `is_structure` whether a fixture is structure.
    `depth_on` holds the number of keyframes with depth on each true object.
    """
    counting, ignored = [item for item in true if item.counts], [item for item in true if not item.counts]
    objects = [tracked for tracked in snapshot.objects if tracked.phase != Phase.TENTATIVE]
    boxes = [best_box(tracked, meshes) for tracked in objects]
    owners = [owner_of(tracked) for tracked in objects]

    ious = _best_ious(counting, boxes)
    loose, strict = _matches(ious, LOOSE_IOU), _matches(ious, STRICT_IOU)
    ignored_ids = {item.id for item in ignored}
    aside = {i for i, owner in enumerate(owners) if owner in ignored_ids}
    aside |= {match.map_index for match in _matches(_best_ious(ignored, boxes), LOOSE_IOU)}
    fixtures = {tracked.id for tracked in objects if tracked.is_fixture}
    other = {i for i, one in enumerate(objects) if one.id in fixtures} - aside - {match.map_index for match in loose}
    structure = {i for i in other if is_structure(objects[i])}
    of_truth = {counting[match.truth_index].id: (objects[match.map_index].id, match.iou) for match in loose}
    of_strict = {counting[match.truth_index].id: objects[match.map_index].id for match in strict}
    rows = tuple(
        TruthScore(
            truth_id=item.id,
            kind=item.kind,
            counts=item.counts,
            map_id=of_truth.get(item.id, (None, 0.0))[0],
            iou=of_truth.get(item.id, (None, 0.0))[1],
            strict_map_id=of_strict.get(item.id),
            track_ids=tuple(tracked.id for tracked, owner in zip(objects, owners, strict=True) if owner == item.id),
            is_fixture=of_truth.get(item.id, (None, 0.0))[0] in fixtures,
            is_reachable=None if depth_on is None else depth_on.get(item.id, 0) >= MIN_DEPTH_KEYFRAMES,
        )
        for item in true
    )
    counted = [row for row in rows if row.counts]
    within = [row for row in counted if row.is_reachable]
    shapes = [meshes[one.id] for one in objects if one.id in meshes]
    tracks = [len(row.track_ids) for row in counted if row.track_ids]
    return Score(
        num_truth=len(counting),
        num_reachable=None if depth_on is None else len(within),
        num_objects=len(objects),
        reachable_recall_25=_share(row.map_id is not None for row in within),
        reachable_recall_50=_share(row.strict_map_id is not None for row in within),
        recall_25=len(loose) / len(counting),
        recall_50=len(strict) / len(counting),
        precision_25=_precision(loose, len(objects), aside | structure),
        precision_50=_precision(strict, len(objects), aside | structure),
        tracks_per_object=sum(tracks) / len(tracks) if tracks else 0.0,
        truth=rows,
        stray_ids=tuple(tracked.id for tracked, owner in zip(objects, owners, strict=True) if owner is None),
        ignored_ids=tuple(objects[i].id for i in sorted(aside)),
        structure_ids=tuple(objects[i].id for i in sorted(structure)),
        fixture_share=_share(row.is_fixture for row in counted if row.map_id is not None),
        generated_share=sum(map(generated_m2, shapes)) / sum(map(area_m2, shapes)) if shapes else None,
    )


def _share(are: Iterable[bool]) -> float | None:
    every = list(are)
    return sum(every) / len(every) if every else None


def _best_ious(true: Sequence[TrueBox], map_boxes: Sequence[OrientedBox]) -> NDArray[np.float64]:
    most = max((len(item.boxes) for item in true), default=1)
    kinds = [[item.boxes[min(k, len(item.boxes) - 1)] for item in true] for k in range(most)]
    best: NDArray[np.float64] = np.max([box_ious(boxes, map_boxes) for boxes in kinds], axis=0)
    return best


def meshes_of(saved: SavedMap) -> dict[int, Mesh]:
    """Return layer 2 of a saved map by object id; raises `MapFolderError` when a mesh cannot be read."""
    return {tracked.id: saved.mesh(tracked.shape) for tracked in saved.snapshot.objects if tracked.shape}


def best_box(tracked: TrackedObject, meshes: Mapping[int, Mesh]) -> OrientedBox:
    """Return the gravity-aligned box of layer 2, else of layer 1."""
    if tracked.shape is None or tracked.id not in meshes:
        return tracked.box
    vertices = apply(tracked.shape.world_from_object, meshes[tracked.id].vertices)
    return gravity_aligned_box(vertices, _MIN_HALF_EXTENT_M)


def surface_of(truth: Truth, item: TruthObject) -> Surface:
    """Return the mesh of a true object in the world; raises `RecordingError` if it cannot be read."""
    return surface_of_mesh(moved_mesh(mesh_of(truth, item), item.world_from_object), item.id)


def structure_surfaces(truth: Truth) -> list[Surface]:
    """Return floor, walls and the like in the world; raises `RecordingError` if a mesh cannot be read."""
    return [surface_of_mesh(mesh, STRUCTURE) for mesh in structure_meshes(truth)]


def shares_on(tracked: TrackedObject, scene: Scene) -> dict[int, float]:
    """Return the share of an object's points that are nearest to each owner's surface, and within reach of it.

    The reach is 3 cm, or one sigma of depth at the farthest view, by the law of a camera of which nothing is known.
    """
    eyes = np.array([view.world_from_camera[:3, 3] for view in tracked.views]).reshape(-1, 3)
    depth_m = np.linalg.norm(eyes - tracked.box.center, axis=1).astype(np.float32)
    reach_m = float(DepthSensor().sigma_m(depth_m).max(initial=SURFACE_REACH_M))
    some = tracked.points_world[:: max(1, len(tracked.points_world) // _MAX_POINTS)]
    distance_m, owners = scene.nearest(some)
    ids, counts = np.unique(owners[distance_m <= reach_m], return_counts=True)
    return {int(i): float(count / len(some)) for i, count in zip(ids, counts, strict=True)}


def _lies_on_structure(fixture: TrackedObject, scene: Scene) -> bool:
    return shares_on(fixture, scene).get(STRUCTURE, 0.0) > 0.5


def _owner(tracked: TrackedObject, scene: Scene) -> int | None:
    return next((i for i, share in shares_on(tracked, scene).items() if share > 0.5 and i != STRUCTURE), None)


def _precision(matches: Sequence[BoxMatch], num_objects: int, aside: set[int]) -> float:
    matched = {match.map_index for match in matches}
    counted = num_objects - len(aside - matched)
    return len(matched) / counted if counted else 0.0
