"""What the objects of a map rest on, hang from and lean on: the support graph of a map that was saved."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry.bounds import bounds_of
from hickory_stream.geometry.rigid import invert
from hickory_stream.mapping.cloud import Cloud, cloud_of
from hickory_stream.mapping.moved import moved_object
from hickory_stream.mapping.observed_space import known_space
from hickory_stream.mapping.support_graph import REACH_M, Relation, Support, SupportGraph

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.geometry.boxes import OrientedBox
    from hickory_stream.mapping.mapping_config import MappingConfig
    from hickory_stream.records import MapSnapshot, TrackedObject


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ObjectBody:
    """An object of a map as a body of the graph."""

    id: int
    cloud: Cloud
    solid: Cloud
    box: OrientedBox
    bounds: NDArray[np.float32]


def supports_of(snapshot: MapSnapshot, config: MappingConfig) -> dict[int, tuple[Support, ...]]:
    """Return the relations of each object of a map, by its id.

    Each object is compared with the observed space of its own submap, in whose frame the heights are. An object without
    points has no relations.
    """
    objects = [item for item in snapshot.objects if len(item.points_world)]
    found: dict[int, tuple[Support, ...]] = {item.id: () for item in snapshot.objects}
    in_map: dict[int, ObjectBody] = {}
    spheres = np.array([_sphere(item) for item in objects]).reshape(-1, 4)
    for submap in snapshot.submaps:
        is_own = np.array([item.submap_id == submap.id for item in objects], dtype=bool)
        if not is_own.any():
            continue
        own = {item.id for item, is_one in zip(objects, is_own, strict=True) if is_one}
        near = [item for item, is_one in zip(objects, _may_touch(spheres, is_own), strict=True) if is_one]
        if np.array_equal(submap.world_from_submap, np.eye(4)):
            in_map.update({item.id: _body(item, config) for item in near if item.id not in in_map})
            bodies = {item.id: in_map[item.id] for item in near}
        else:
            place = invert(submap.world_from_submap)
            bodies = {item.id: _body(moved_object(item, place), config) for item in near}
        graph = SupportGraph(
            bodies=bodies,
            space=known_space(submap.observed_space),
            config=config.support,
            unsupported=config.unsupported,
        )
        for edge in graph.edges(own):
            found[edge.body] += (edge,)
    return found


def told(supports: tuple[Support, ...]) -> str:
    """Return a phrase for the support of an object: what it rests on, else hangs from, is a part of, or leans on."""
    held = {support.relation: support.by for support in reversed(supports)}
    if Relation.RESTS_ON in held:
        by = held[Relation.RESTS_ON]
        return "the floor" if by is None else f"#{by}"
    for relation in (Relation.HANGS_FROM, Relation.PART_OF):
        if relation in held:
            return f"{relation} #{held[relation]}"
    return "a wall" if Relation.LEANS_ON in held else "-"


def _sphere(item: TrackedObject) -> tuple[float, float, float, float]:
    """Return the centre and the radius of a sphere around an object's points and its box, in metres."""
    reach = np.concatenate((item.points_world, item.box.corners_world())).astype(np.float64) - item.box.center
    return (*item.box.center, float(np.sqrt((reach**2).sum(axis=1).max())))


def _may_touch(spheres: NDArray[np.float64], is_own: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which of n objects (n, 4) may have a relation to one of their own, whichever way the axes lie.

    Bounds along any axes that are within reach of each other have centres at most so far apart along each of the three.
    """
    own = spheres[is_own]
    apart_m = np.linalg.norm(spheres[:, None, :3] - own[None, :, :3], axis=2)
    return (apart_m <= np.sqrt(3.0) * (spheres[:, None, 3] + own[None, :, 3] + REACH_M)).any(axis=1)


def _body(item: TrackedObject, config: MappingConfig) -> ObjectBody:
    cloud = cloud_of(item.points_world, item.colors, config.lattice.points_m)
    return ObjectBody(id=item.id, cloud=cloud, solid=cloud, box=item.box, bounds=bounds_of(cloud.points))
