"""The support graph of a saved map: objects that rest on, hang from or lean on others."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry.bounds import bounds_of
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.mapping.entities.cloud import Cloud, cloud_of
from hickory_stream.mapping.entities.observed_space import known_space
from hickory_stream.mapping.entities.rigid_motion import moved_box
from hickory_stream.mapping.rules.support_graph import REACH_M, Relation, Support, SupportGraph

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.geometry.boxes import OrientedBox
    from hickory_stream.mapping.config import MappingConfig
    from hickory_stream.records import MapSnapshot, TrackedObject

_SLACK_M = 1e-3


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ObjectBody:
    """An object of a map as a body of the graph."""

    id: int
    cloud: Cloud
    solid: Cloud
    box: OrientedBox
    bounds: NDArray[np.float32]


def supports_of(snapshot: MapSnapshot, config: MappingConfig) -> dict[int, tuple[Support, ...]]:
    """Return the relations of each object of a map by id; an object without points has none.

    Each object is compared with the observed space of its own submap, in that submap's frame.
    """
    objects = [item for item in snapshot.objects if len(item.points_world)]
    found: dict[int, tuple[Support, ...]] = {item.id: () for item in snapshot.objects}
    in_map: dict[int, ObjectBody] = {}
    spheres = np.array([_sphere(item) for item in objects]).reshape(-1, 4)
    for submap in snapshot.submaps:
        is_own = np.array([item.submap_id == submap.id for item in objects], dtype=bool)
        if not is_own.any():
            continue
        near = [item for item, is_one in zip(objects, _may_touch(spheres, is_own), strict=True) if is_one]
        is_moved = not np.array_equal(submap.world_from_submap, np.eye(4))
        if is_moved:
            submap_from_world = invert(submap.world_from_submap)
            near = [_bare(item, submap_from_world) for item in near]
        bodies = {} if is_moved else in_map
        reaches = np.array([_reach(item) for item in near])
        space = known_space(submap.observed_space)
        for k, item in enumerate(near):
            if item.submap_id != submap.id:
                continue
            around = [near[i] for i in np.flatnonzero(_meet(reaches, reaches[k]))]
            bodies.update({other.id: _body(other, config) for other in around if other.id not in bodies})
            graph = SupportGraph(
                bodies={other.id: bodies[other.id] for other in around},
                space=space,
            )
            found[item.id] = graph.edges((item.id,))
    return found


def support_text(supports: tuple[Support, ...]) -> str:
    """Return a phrase for the support of an object: on, hanging from, part of, or leaning on."""
    held = {support.relation: support.by for support in reversed(supports)}
    if Relation.RESTS_ON in held:
        by = held[Relation.RESTS_ON]
        return "the floor" if by is None else f"#{by}"
    for relation in (Relation.HANGS_FROM, Relation.PART_OF):
        if relation in held:
            return f"{relation} #{held[relation]}"
    return "a wall" if Relation.LEANS_ON in held else "-"


def _bare(item: TrackedObject, new_from_old: NDArray[np.float64]) -> TrackedObject:
    # Points and box in another frame; support depends on nothing else.
    return replace(
        item,
        points_world=apply(new_from_old, item.points_world),
        box=moved_box(item.box, new_from_old),
        views=(),
        best_view=None,
        shape=None,
        sketch=None,
    )


def _reach(item: TrackedObject) -> NDArray[np.float64]:
    """Return the bounds (2, 3) of an object's points and its box."""
    (low, high), corners = bounds_of(item.points_world).astype(np.float64), item.box.corners_world()
    return np.array([np.minimum(low, corners.min(axis=0)), np.maximum(high, corners.max(axis=0))])


def _meet(reaches: NDArray[np.float64], own: NDArray[np.float64]) -> NDArray[np.bool_]:
    # Which of (N, 2, 3) bounds are near (2, 3). The slack covers voxel means that round out of the bounds.
    reach_m = REACH_M + _SLACK_M
    is_near = (reaches[:, 0] <= own[1] + reach_m) & (own[0] <= reaches[:, 1] + reach_m)
    return np.asarray(is_near.all(axis=1))


def _sphere(item: TrackedObject) -> tuple[float, float, float, float]:
    low, high = _reach(item)
    middle = (low + high) / 2
    return (*middle, float(np.linalg.norm(high - middle)))


def _may_touch(spheres: NDArray[np.float64], is_own: NDArray[np.bool_]) -> NDArray[np.bool_]:
    # Which of n spheres (n, 4) may touch one of `is_own`. Bounds within reach along any axes have centres at most so
    # far apart along each of the three.
    own = spheres[is_own]
    apart_m = np.linalg.norm(spheres[:, None, :3] - own[None, :, :3], axis=2)
    return (apart_m <= np.sqrt(3.0) * (spheres[:, None, 3] + own[None, :, 3] + REACH_M)).any(axis=1)


def _body(item: TrackedObject, config: MappingConfig) -> ObjectBody:
    cloud = cloud_of(item.points_world, item.colors, config.voxels.object_m)
    return ObjectBody(id=item.id, cloud=cloud, solid=cloud, box=item.box, bounds=bounds_of(cloud.points))
