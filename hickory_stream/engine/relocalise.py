"""Relocalisation of a running log in a stored map: it is mapped, and aligned again as its map grows.

A pose is confirmed when two poses in a row agree; the first one may be chance. A refusal between them says nothing.
"""

import asyncio
from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np

from hickory_stream.alignment.align import align
from hickory_stream.alignment.answer import Alignment, NoAlignment
from hickory_stream.alignment.object_map import ObjectMap, object_map, taken
from hickory_stream.alignment.registration import differs
from hickory_stream.config import MapperConfig
from hickory_stream.engine.mapper import Mapper
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.ports import Source
from hickory_stream.records import Phase

_AGREE_M, _AGREE_RAD = 0.3, np.radians(3.0)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Located:
    """One answer: `answer` has `a_from_b`, the stored map's frame from the log's."""

    stamp_ns: int
    num_objects: int
    answer: Alignment | NoAlignment
    #: The pose before agrees.
    is_confirmed: bool
    #: The pose before differs.
    has_jumped: bool


def relocalise(
    stored: ObjectMap,
    source: Source,
    config: MapperConfig,
    *,
    rate: float | None,
    stops_when_found: bool,
    report: Callable[[Located], None],
) -> Located | None:
    """Return the last answer when the log ends, None if nothing was mapped; `report` receives every answer.

    The log is mapped into a temporary folder. `rate` 1.0 is real time, None as fast as possible. `stops_when_found`
    ends at the first confirmed pose.

    Raises `HickoryError`: the source or the disk failed.
    """

    async def answered() -> Located | None:
        last: Located | None = None
        pose: Alignment | None = None
        known: frozenset[int] = frozenset()
        async with Mapper(config, out=None) as mapper:
            async for snapshot in mapper.run(source, rate=rate):
                objects = frozenset(item.id for item in snapshot.objects if item.phase is not Phase.TENTATIVE)
                # Until an object comes or goes, the answer is the same.
                if objects == known and last is not None:
                    continue
                known = objects
                here = object_map(snapshot, mapper.extractor_name)
                last = await asyncio.to_thread(_located, stored, here, snapshot.stamp_ns, pose)
                pose = last.answer if isinstance(last.answer, Alignment) else pose
                report(last)
                if stops_when_found and last.is_confirmed:
                    mapper.stop()
                    break
        return last

    return asyncio.run(answered())


def without(stored: ObjectMap, movable: Collection[int]) -> ObjectMap:
    """Return a map without objects that tend to move: they are no landmarks."""
    return taken(stored, np.flatnonzero(~np.isin(stored.ids, list(movable))))


def _located(stored: ObjectMap, here: ObjectMap, stamp_ns: int, before: Alignment | None) -> Located:
    answer = align(stored, here)
    is_confirmed = has_jumped = False
    if isinstance(answer, Alignment) and before is not None:
        center_b = apply(invert(answer.a_from_b), answer.center_a)
        has_jumped = differs(answer.a_from_b, before.a_from_b, center_b, distance_m=_AGREE_M, angle_rad=_AGREE_RAD)
        is_confirmed = not has_jumped
    flags = {"is_confirmed": is_confirmed, "has_jumped": has_jumped}
    return Located(stamp_ns=stamp_ns, num_objects=len(here), answer=answer, **flags)
