"""The comparison of two aligned maps of one place, object by object.

Like Khronos (Schmid et al., RSS 2024), it uses rays. "Gone" needs free space that the other map observed at the
object's place: unobserved objects stay unknown, and each verdict has a probability.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from hickory_stream.alignment.contradiction import thinned
from hickory_stream.changes.evidence import SeenPlaces, clear_points, compared_objects, evidence_at, seen_places
from hickory_stream.changes.records import ChangesConfig, Evidence, MapChanges, ObjectChange, Verdict
from hickory_stream.geometry.boxes import box_iou
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.mapping.entities.rigid_motion import moved_object
from hickory_stream.records import MapSnapshot, TrackedObject

# Cosines of pooled features: of unrelated objects, and of one object in two maps.
_COSINE = (0.3, 0.7)


def likeness(
    a: TrackedObject, b: TrackedObject, config: ChangesConfig, *, with_size: bool, with_feature: bool
) -> float:
    """Return the likeness of two objects in 0..1; missing features do not count.

    `with_size` is False for objects in one place, which one map may have seen in part. `with_feature` is False for
    features of different networks.
    """
    away = (np.linalg.norm(_lab(a) - _lab(b)) / config.color_sigma) ** 2
    if with_size:
        away += (np.abs(np.log(_sides(a) / _sides(b))).max() / config.size_sigma) ** 2
    alike = float(np.exp(-0.5 * away))
    if with_feature and a.feature is not None and b.feature is not None and a.feature.shape == b.feature.shape:
        alike *= float(np.clip((float(a.feature @ b.feature) - _COSINE[0]) / (_COSINE[1] - _COSINE[0]), 0.05, 1.0))
    return alike


def probability_same(alike: float, floor: float) -> float:
    """Return the probability that two objects are one, from their likeness and the likeness of any two objects."""
    return alike / (alike + floor)


def _sides(item: TrackedObject) -> NDArray[np.float64]:
    half = item.box.half_extents_m
    return np.array([*np.sort(half[:2]), half[2]])


def _lab(item: TrackedObject) -> NDArray[np.float64]:
    if not len(item.colors):
        return np.zeros(3)
    middle = np.median(item.colors, axis=0).astype(np.float32)[None, None] / np.float32(255)
    return np.asarray(cv2.cvtColor(middle, cv2.COLOR_RGB2LAB)[0, 0], dtype=np.float64)


_POINTS_OF_OVERLAP = 300
_TREES = 64


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Compared:
    # Two maps with their objects in the frame of map a; `near_m` is the tolerance of a surface.
    a: SeenPlaces
    b: SeenPlaces
    a_objects: tuple[TrackedObject, ...]
    b_objects: tuple[TrackedObject, ...]
    a_from_b: NDArray[np.float64]
    near_m: float
    with_feature: bool

    def evidence_in_b(self, i: int) -> Evidence:
        points = clear_points(self.a, i, self.near_m)
        return evidence_at(self.b, apply(invert(self.a_from_b), points), self.near_m)

    def evidence_in_a(self, j: int) -> Evidence:
        points = clear_points(self.b, j, self.near_m)
        return evidence_at(self.a, apply(self.a_from_b, points), self.near_m)


def compare_maps(
    a: MapSnapshot,
    b: MapSnapshot,
    a_from_b: NDArray[np.float64],
    sigma_m: float,
    config: ChangesConfig | None = None,
    *,
    with_feature: bool = True,
) -> MapChanges:
    """Return the change of every object from map a to map b, without tentative ones.

    `a_from_b` (4, 4) aligns the maps with the standard deviation `sigma_m`; `with_feature`: one extractor made the
    features of both.
    """
    config = config or ChangesConfig()
    a_objects, b_objects = compared_objects(a), compared_objects(b)
    both = _Compared(
        a=seen_places(a_objects, a.submaps),
        b=seen_places(b_objects, b.submaps),
        a_objects=a_objects,
        b_objects=tuple(moved_object(item, a_from_b) for item in b_objects),
        a_from_b=a_from_b,
        near_m=min(config.near_m + 2 * sigma_m, config.most_near_m),
        with_feature=with_feature,
    )
    pairs = _in_one_place(both, config)
    changes = [_of_pair(both, i, j, overlap, config) for i, j, overlap in pairs]
    left_a = [i for i in range(len(a_objects)) if i not in {i for i, _, _ in pairs}]
    left_b = [j for j in range(len(b_objects)) if j not in {j for _, j, _ in pairs}]
    changes += _of_single(both, left_a, left_b, config)
    order = {verdict: n for n, verdict in enumerate(Verdict)}
    changes.sort(key=lambda one: (order[one.verdict], -1 if one.id_a is None else one.id_a, one.id_b or 0))
    return MapChanges(a_from_b=a_from_b, sigma_m=sigma_m, changes=tuple(changes))


def probability_changed(evidence: Evidence, config: ChangesConfig) -> float:
    """Return the probability that an object left the place where the other map looked: Bayes' rule over looks."""
    weight = np.log(config.reliable / (1 - config.reliable))
    prior = np.log(config.change_prior / (1 - config.change_prior))
    against = config.looks * weight * (evidence.free - evidence.structure - evidence.objects)
    return float(1.0 / (1.0 + np.exp(-(prior + against))))


def _in_one_place(both: _Compared, config: ChangesConfig) -> list[tuple[int, int, float]]:
    overlaps = np.zeros((len(both.a_objects), len(both.b_objects)))
    # Pairs of one object of map a come one after another, and those of map b in its room.
    a_tree, b_tree = (
        lru_cache(size)(partial(_tree, objects)) for size, objects in ((1, both.a_objects), (_TREES, both.b_objects))
    )
    for i, j in np.argwhere(_may_touch(both.a_objects, both.b_objects)):
        one, other = both.a_objects[i], both.b_objects[j]
        iou = box_iou(one.box, other.box)
        if iou > 0:
            near = [_share_near(a_tree(i), other, both.near_m), _share_near(b_tree(j), one, both.near_m)]
            overlaps[i, j] = max(iou, min(near))
    overlaps[overlaps < config.min_overlap] = 0.0
    rows, columns = linear_sum_assignment(overlaps, maximize=True)
    return [(int(i), int(j), float(overlaps[i, j])) for i, j in zip(rows, columns, strict=True) if overlaps[i, j] > 0]


def _may_touch(some: Sequence[TrackedObject], others: Sequence[TrackedObject]) -> NDArray[np.bool_]:
    # (N, M) the spheres around the boxes meet.
    (centers, radii), (other_centers, other_radii) = (
        (
            np.array([item.box.center for item in items]).reshape(-1, 3),
            np.array([item.box.diagonal_m / 2 for item in items]),
        )
        for items in (some, others)
    )
    return np.asarray(cdist(centers, other_centers) < radii[:, None] + other_radii)


def _tree(objects: Sequence[TrackedObject], i: int) -> cKDTree:
    return cKDTree(objects[i].points_world)


def _share_near(tree: cKDTree, other: TrackedObject, near_m: float) -> float:
    # `tree` has all points of the other object, one a voxel of a centimetre or two.
    some = thinned(other.points_world, _POINTS_OF_OVERLAP)
    return float((tree.query(some, distance_upper_bound=near_m)[0] <= near_m).mean())


def _of_pair(both: _Compared, i: int, j: int, overlap: float, config: ChangesConfig) -> ObjectChange:
    one, other = both.a_objects[i], both.b_objects[j]
    evidence = both.evidence_in_b(i)
    alike = likeness(one, other, config, with_size=False, with_feature=both.with_feature)
    same = probability_same(alike, config.look_floor)
    if alike < config.unlike:
        return _change(Verdict.EXCHANGED, one, other, 1 - same, evidence)
    sized = likeness(one, other, config, with_size=True, with_feature=both.with_feature)
    as_large = probability_same(sized, config.look_floor)
    shift = other.box.center - one.box.center
    # A fixture does not move: its boundary was drawn elsewhere, or another one took its place.
    may_move = not (one.is_fixture or other.is_fixture)
    is_away = may_move and float(np.linalg.norm(shift)) > config.moved_m + both.near_m - config.near_m
    moved = probability_changed(evidence, config)
    if is_away and sized >= config.unlike and evidence.free >= config.moved_free and moved >= 0.5:
        return _change(Verdict.MOVED, one, other, moved * same, evidence)
    differs = _differs(evidence, both.evidence_in_a(j), config)
    if differs >= config.min_probability:
        # The same thing, turned on the spot, or another one.
        is_turned = may_move and as_large >= config.alike
        verdict, sure = (Verdict.MOVED, as_large) if is_turned else (Verdict.EXCHANGED, 1 - as_large)
        return _change(verdict, one, other, differs * sure, evidence)
    # A place that is taken by something alike: overlap speaks for it as free space speaks against it.
    there = 1 - (1 - overlap) * moved
    return _change(Verdict.STILL_THERE, one, other, there, evidence)


def _differs(left: Evidence, came: Evidence, config: ChangesConfig) -> float:
    # A thing that stays leaves no free space, and reaches into none: else one map saw through a good part of what the
    # other has there. The rest may lie on a surface of the other thing.
    free = max(left, came, key=lambda one: one.free)
    if free.free < config.min_free:
        return 0.0
    return probability_changed(replace(free, structure=0.0, objects=0.0), config)


def _of_single(
    both: _Compared, left_a: Sequence[int], left_b: Sequence[int], config: ChangesConfig
) -> list[ObjectChange]:
    evidence_a = {i: both.evidence_in_b(i) for i in left_a}
    evidence_b = {j: both.evidence_in_a(j) for j in left_b}
    # What still shows a surface where it was has not moved away.
    away = [i for i in left_a if not both.a_objects[i].is_fixture and _is_bare(evidence_a[i])]
    arrived = [j for j in left_b if not both.b_objects[j].is_fixture and _is_bare(evidence_b[j])]
    moved = _moved(both, away, arrived, config)
    changes = []
    for i, j, same in moved:
        left = probability_changed(evidence_a[i], config)
        one, other = both.a_objects[i], both.b_objects[j]
        # That it stands elsewhere now is evidence, too: an object that was not seen again is still only one.
        changes.append(_change(Verdict.MOVED, one, other, same * max(left, 0.5), evidence_a[i]))
    gone_a, gone_b = {i for i, _, _ in moved}, {j for _, j, _ in moved}
    changes += [_alone(both.a_objects[i], None, evidence_a[i], config) for i in left_a if i not in gone_a]
    changes += [_alone(None, both.b_objects[j], evidence_b[j], config) for j in left_b if j not in gone_b]
    return changes


def _is_bare(evidence: Evidence) -> bool:
    return evidence.free >= evidence.structure + evidence.objects


def _moved(
    both: _Compared, away: Sequence[int], arrived: Sequence[int], config: ChangesConfig
) -> list[tuple[int, int, float]]:
    # Pairs by looks alone. Equal objects share the probability: of two equal mugs neither is known to be the one.
    alike = np.array(
        [
            [
                likeness(both.a_objects[i], both.b_objects[j], config, with_size=True, with_feature=both.with_feature)
                for j in arrived
            ]
            for i in away
        ]
    ).reshape(len(away), len(arrived))
    rows, columns = linear_sum_assignment(alike, maximize=True)
    found = []
    for r, c in zip(rows, columns, strict=True):
        rivals = max(np.delete(alike[r], c).max(initial=0.0), np.delete(alike[:, c], r).max(initial=0.0))
        same = probability_same(float(alike[r, c]), config.look_floor + float(rivals) * config.look_floor)
        if same >= config.alike:
            found.append((away[r], arrived[c], same))
    return found


def _alone(
    one: TrackedObject | None, other: TrackedObject | None, evidence: Evidence, config: ChangesConfig
) -> ObjectChange:
    changed = probability_changed(evidence, config)
    is_earlier = one is not None
    if changed >= config.min_probability and evidence.free >= config.min_free:
        return _change(Verdict.GONE if is_earlier else Verdict.NEW, one, other, changed, evidence)
    if evidence.structure + evidence.objects > 0.5 and 1 - changed >= config.min_probability:
        # Its surface is there, as a part of something else in the other map.
        return _change(Verdict.STILL_THERE, one, other, 1 - changed, evidence)
    verdict = Verdict.NOT_SEEN_AGAIN if is_earlier else Verdict.NOT_SEEN_BEFORE
    return _change(verdict, one, other, 1 - changed, evidence)


def _change(
    verdict: Verdict, one: TrackedObject | None, other: TrackedObject | None, probability: float, evidence: Evidence
) -> ObjectChange:
    shift = None
    if verdict is Verdict.MOVED and one is not None and other is not None:
        x, y, z = (round(float(part), 4) for part in other.box.center - one.box.center)
        shift = (x, y, z)
    latest = one if other is None else other
    assert latest is not None
    return ObjectChange(
        verdict=verdict,
        id_a=None if one is None else one.id,
        id_b=None if other is None else other.id,
        probability=round(min(max(probability, 0.0), 1.0), 4),
        evidence=evidence,
        shift_m=shift,
        kind=latest.kind,
        fixture_probability=latest.fixture_probability,
    )
