"""The search for loops: the place of a submap that has ended in the earlier ones.

Its surface is registered to the earlier submaps that it overlaps by the graph. In those of which the graph is too
uncertain its keyframes are recognised by their point features. If these fail, and no surface meets, its objects are
aligned with theirs. The surfaces refine the answer. Budgets are in candidates and iterations, never in time: the same
snapshot gives the same loops.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hickory_stream.alignment.align import align
from hickory_stream.alignment.answer import Alignment
from hickory_stream.alignment.object_map import ObjectMap, object_map
from hickory_stream.geometry.rigid import apply, compose, from_rotation_translation, invert, yaw_rotation
from hickory_stream.geometry.voxels import contains, keys_of_points, sorted_unique
from hickory_stream.graph.factors import LoopMethod, adjoint, tangent_covariance
from hickory_stream.graph.gate import difference, mahalanobis2
from hickory_stream.loops.config import MIN_AGREEING_POINTS, LoopConfig
from hickory_stream.loops.predictions import Predicted
from hickory_stream.loops.surfaces import Surface, SurfaceFit, approached, refined, registered, with_known_start
from hickory_stream.poses.visual_motion import recognised
from hickory_stream.records import Keypoints, Loop, MapSnapshot

_CELL_M = 0.4
_WITHIN_SIGMAS = 3.0
# A place that the graph knows this well has no rival nearby.
_SURE_M = 0.1
_SAME_M, _SAME_RAD = 0.15, 0.035
_LEAST_OBJECTS = 4
# Minimum share of a submap's surface in the other one for them to be a candidate.
_MIN_OVERLAP = 0.15
# Where the graph is less sure than this of where two submaps lie, their images or objects have to locate them.
_MAX_SIGMA_M = 0.7
# Rooms of one plan with one poster agree to 0.97 at most if their furniture differs, and right places to more.
_ALIKE_AGREEMENT = 0.97
# Another place nearby with more than this share of the best one's support makes a loop ambiguous.
_RIVAL_SHARE = 0.85


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LoopQuery:
    """The search for submap `later_id` in the earlier ones of `predicted`, by their `surfaces`."""

    later_id: int
    surfaces: Mapping[int, Surface]
    predicted: Mapping[int, Predicted]
    keypoints: Mapping[int, Sequence[Keypoints]] = field(default_factory=dict)
    #: the map with all of them; None: objects are not compared
    snapshot: MapSnapshot | None = None
    extractor: str = ""


def search_loops(query: LoopQuery, config: LoopConfig) -> tuple[Loop, ...]:
    """Return the loops found, with a reason if they are not believed."""
    if len(query.surfaces[query.later_id].points) < MIN_AGREEING_POINTS:
        return ()
    known = [i for i in sorted(query.predicted) if query.predicted[i].sigma_m <= _MAX_SIGMA_M]
    loops = [_by_surface(query, earlier_id, config) for earlier_id in _overlapped(query, known, config)]
    if len(known) == len(query.predicted):
        return tuple(loops)
    by_appearance = _by_appearance(query, [i for i in sorted(query.predicted) if i not in known], config)
    loops += [] if by_appearance is None else [by_appearance]
    by_objects = None if any(loop.reason is None for loop in loops) else _by_objects(query, config)
    return (*loops, *(() if by_objects is None else (by_objects,)))


def _overlapped(query: LoopQuery, earlier_ids: list[int], config: LoopConfig) -> list[int]:
    # The most overlapping earlier submaps, in the order of their ids.
    later = query.surfaces[query.later_id]
    shares: list[tuple[float, int]] = []
    for earlier_id in earlier_ids:
        earlier, predicted = query.surfaces[earlier_id], query.predicted[earlier_id]
        if len(earlier.points) < MIN_AGREEING_POINTS:
            continue
        cells = sorted_unique(keys_of_points(earlier.points, _CELL_M))
        there = apply(predicted.earlier_from_later, later.points)
        share = float(contains(cells, keys_of_points(there, _CELL_M)).mean())
        if share >= _MIN_OVERLAP:
            shares.append((-share, earlier_id))
    return sorted(earlier_id for _, earlier_id in sorted(shares)[: config.max_candidates])


def _by_surface(query: LoopQuery, earlier_id: int, config: LoopConfig) -> Loop:
    # From the place in the graph, and from around it.
    earlier, later, predicted = query.surfaces[earlier_id], query.surfaces[query.later_id], query.predicted[earlier_id]
    reach_m = _WITHIN_SIGMAS * predicted.sigma_m
    fits: list[SurfaceFit] = []
    for start in _starts(predicted, later):
        near = approached(earlier, later, start, reach_m)
        # Most starts come to where one before has led to; one that led nowhere says nothing about the others.
        led = [fit for fit in fits if _why_not(fit, config) is None]
        if not any(_differ(near, fit.earlier_from_later, fit.covariance, later) < 1.0 for fit in led):
            fits.append(refined(earlier, later, start, near))
    best = max(fits, key=lambda fit: fit.support)
    reason = _why_not(best, config)
    rivals = [fit.support for fit in fits if not _is_same(fit, best, later)]
    most = max(rivals, default=0)
    if reason is None and most > _RIVAL_SHARE * best.support:
        reason = f"it fits elsewhere nearby as well: {best.support} points speak for it, {most} for that"
    return _loop(earlier_id, query.later_id, best, "surface", reason)


def _starts(predicted: Predicted, later: Surface) -> list[NDArray[np.float64]]:
    starts = [predicted.earlier_from_later]
    if predicted.sigma_m <= _SURE_M:
        return starts
    for sign in (1.0, -1.0):
        for axis in range(2):
            shifted = np.array(predicted.earlier_from_later)
            shifted[axis, 3] += sign * 1.5 * predicted.sigma_m
            starts.append(shifted)
        turn = from_rotation_translation(yaw_rotation(sign * 1.5 * predicted.sigma_yaw_rad), np.zeros(3))
        about = from_rotation_translation(np.eye(3), apply(predicted.earlier_from_later, later.anchor[None, :3, 3])[0])
        starts.append(compose(about, turn, invert(about), predicted.earlier_from_later))
    return starts


def _is_same(a: SurfaceFit, b: SurfaceFit, later: Surface) -> bool:
    # Along the directions in which both are certain.
    return _differ(a.earlier_from_later, b.earlier_from_later, a.covariance + b.covariance, later) < 1.0


def _differ(a: NDArray[np.float64], b: NDArray[np.float64], covariance: NDArray[np.float64], later: Surface) -> float:
    # The squared distance of two places, earlier_from_later, in units of the tolerance.
    error = difference(compose(a, later.anchor), compose(b, later.anchor))
    tolerance = np.diag([_SAME_RAD * _SAME_RAD] * 3 + [_SAME_M * _SAME_M] * 3)
    return mahalanobis2(error, covariance + tolerance)


def _why_not(fit: SurfaceFit, config: LoopConfig) -> str | None:
    # Why a fit is not believed, None where it is.
    if fit.num_met < MIN_AGREEING_POINTS:
        return f"{fit.num_met} points of the surfaces meet; expected {MIN_AGREEING_POINTS} and more"
    if fit.agreement < config.min_agreement:
        against = f"{fit.num_known - fit.num_met} points lie in free space"
        return f"{fit.agreement:.0%} of the surface agrees, {against}; expected {config.min_agreement:.0%} and more"
    return None


def _loop(earlier_id: int, later_id: int, fit: SurfaceFit, method: LoopMethod, reason: str | None) -> Loop:
    return Loop(
        earlier=earlier_id,
        later=later_id,
        earlier_from_later=fit.earlier_from_later,
        covariance=fit.covariance,
        method=method,
        score=round(fit.agreement, 6),
        reason=reason,
    )


def _by_appearance(query: LoopQuery, earlier_ids: Sequence[int], config: LoopConfig) -> Loop | None:
    # None: no keyframe shows enough of an earlier one.
    later, views = query.surfaces[query.later_id], query.keypoints.get(query.later_id, ())
    others = [(i, view) for i in earlier_ids for view in query.keypoints.get(i, ())]
    found = recognised(views, [view for _, view in others])
    if found is None or len(query.surfaces[others[found[1]][0]].points) < MIN_AGREEING_POINTS:
        return None
    view, earlier_id, sighting = views[found[0]], others[found[1]][0], found[2]
    start = compose(sighting.start_from_camera, invert(view.world_from_camera))
    carry = adjoint(compose(invert(later.anchor), view.world_from_camera))
    covariance = carry @ np.linalg.inv(sighting.information) @ carry.T
    fit = with_known_start(registered(query.surfaces[earlier_id], later, start, 0.0), covariance)
    surer = replace(config, min_agreement=max(config.min_agreement, _ALIKE_AGREEMENT))
    return _loop(earlier_id, query.later_id, fit, "appearance", _why_not(fit, surer))


def _by_objects(query: LoopQuery, config: LoopConfig) -> Loop | None:
    # None: too few objects, no alignment, or no surface to refine it.
    if query.snapshot is None:
        return None
    later_map = _objects_of(query.snapshot, {query.later_id}, query.extractor)
    earlier_map = _objects_of(query.snapshot, set(query.predicted), query.extractor)
    if min(len(later_map), len(earlier_map)) < _LEAST_OBJECTS:
        return None
    answer = align(earlier_map, later_map)
    if not isinstance(answer, Alignment):
        return None
    places = {submap.id: submap.world_from_submap for submap in query.snapshot.submaps}
    owner = dict(zip(earlier_map.ids.tolist(), earlier_map.submap_ids.tolist(), strict=True))
    owners = [owner[pair.id_a] for pair in answer.pairs]
    earlier_id = max(sorted(set(owners)), key=owners.count)
    start = compose(invert(places[earlier_id]), answer.a_from_b, places[query.later_id])
    earlier, later = query.surfaces[earlier_id], query.surfaces[query.later_id]
    if min(len(earlier.points), len(later.points)) < MIN_AGREEING_POINTS:
        return None
    carry = adjoint(invert(compose(places[query.later_id], later.anchor)))
    covariance = carry @ tangent_covariance(answer.a_from_b, answer.covariance, answer.center_a) @ carry.T
    fit = registered(earlier, later, start, _WITHIN_SIGMAS * answer.translation_sigma_m)
    fit = with_known_start(fit, covariance)
    return _loop(earlier_id, query.later_id, fit, "objects", _why_not(fit, config))


def _objects_of(snapshot: MapSnapshot, submap_ids: set[int], extractor: str) -> ObjectMap:
    objects = tuple(item for item in snapshot.objects if item.submap_id in submap_ids)
    submaps = tuple(submap for submap in snapshot.submaps if submap.id in submap_ids)
    part = MapSnapshot(revision=snapshot.revision, stamp_ns=snapshot.stamp_ns, submaps=submaps, objects=objects)
    return object_map(part, extractor)
