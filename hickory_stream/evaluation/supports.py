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
from hickory_stream.mapping.support_graph import Relation, Support, SupportGraph

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
    in_map = {item.id: _body(item, config) for item in objects}
    for submap in snapshot.submaps:
        own = {item.id for item in objects if item.submap_id == submap.id}
        if not own:
            continue
        is_in_place = np.array_equal(submap.world_from_submap, np.eye(4))
        place = invert(submap.world_from_submap)
        graph = SupportGraph(
            bodies=in_map if is_in_place else {item.id: _body(moved_object(item, place), config) for item in objects},
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


def _body(item: TrackedObject, config: MappingConfig) -> ObjectBody:
    cloud = cloud_of(item.points_world, item.colors, config.lattice.points_m)
    return ObjectBody(id=item.id, cloud=cloud, solid=cloud, box=item.box, bounds=bounds_of(cloud.points))
