"""Parts of a track that are seen as things of their own: a bowl that an early view took for a piece of its table.

An observation that lies on a track which is already another observation of the same keyframe is a part of it. A part
that comes back at the same place, and is seen apart far more often than as one with the rest, is an object: it is
promoted, and its points are taken off the host.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from hickory_stream.mapping.cloud import Cloud, fuse, share_near
from hickory_stream.ranges import Ranged, number

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


@dataclass(frozen=True, kw_only=True, slots=True)
class PartConfig(Ranged):
    """When a part is an object.

    Attributes:
        min_apart: keyframes that must see it apart ...
        apart_ratio: ... and this many times as many as see it as one with its host.
        same_share: share of either cloud that must lie on the other for two observations to be of one part.
        covered_share: share of a part that an observation of its host covers which sees it as one with the host ...
        alone_share: ... unless this share of the observation lies on the part.
        min_voxels: smaller parts are noise.
        min_size_m: what is thinner, or less than twice that wide, is a rim or a board of its host.
    """

    min_apart: int = number(4, 1, 1_000_000, "keyframes")
    apart_ratio: float = number(2.0, 0, 1000, "ratio")
    same_share: float = number(0.45, 0, 1, "share")
    covered_share: float = number(0.6, 0, 1, "share")
    alone_share: float = number(0.8, 0, 1, "share")
    min_voxels: int = number(40, 1, 1_000_000, "voxels")
    min_size_m: float = number(0.025, 0, 10, "m")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Part:
    """A part of a host: its points, the keyframes that saw it apart, and how many saw it as one with the host."""

    cloud: Cloud
    frames: tuple[int, ...]
    together: int = 0

    def is_object(self, config: PartConfig) -> bool:
        """Return whether it has been seen apart often enough."""
        apart = len(self.frames)
        return apart >= config.min_apart and apart >= config.apart_ratio * self.together


Parts = dict[int, tuple[Part, ...]]
"""The parts by the id of their host."""


def with_keyframe(
    parts: Mapping[int, tuple[Part, ...]],
    frame_index: int,
    apart: Sequence[tuple[int, Cloud]],
    whole: Sequence[tuple[int, Cloud]],
    config: PartConfig,
) -> Parts:
    """Return the parts after a keyframe: `apart` and `whole` are (host id, cloud) of its parts and of its hosts."""
    updated = dict(parts)
    for host_id, cloud in apart:
        if len(cloud.keys) >= config.min_voxels:
            updated[host_id] = _with_part(updated.get(host_id, ()), frame_index, cloud, config)
    for host_id, cloud in whole:
        if host_id in updated:
            updated[host_id] = tuple(_seen_with(part, frame_index, cloud, config) for part in updated[host_id])
    return updated


def moved_to(parts: Mapping[int, tuple[Part, ...]], kept: int, gone: int) -> Parts:
    """Return the parts after track `gone` became `kept`."""
    updated = {host: own for host, own in parts.items() if host != gone}
    if gone in parts:
        updated[kept] = (*updated.get(kept, ()), *parts[gone])
    return updated


def _with_part(own: tuple[Part, ...], frame_index: int, cloud: Cloud, config: PartConfig) -> tuple[Part, ...]:
    for i, part in enumerate(own):
        if _is_same(part.cloud, cloud, config):
            if frame_index in part.frames:
                return own
            seen = replace(part, cloud=fuse(part.cloud, cloud), frames=(*part.frames, frame_index))
            return (*own[:i], seen, *own[i + 1 :])
    return (*own, Part(cloud=cloud, frames=(frame_index,)))


def _seen_with(part: Part, frame_index: int, whole: Cloud, config: PartConfig) -> Part:
    if frame_index in part.frames or share_near(part.cloud.keys, whole) < config.covered_share:
        return part
    # What shows the part and nothing else says nothing: the rest may be hidden, or out of the picture.
    if share_near(whole.keys, part.cloud) >= config.alone_share:
        return part
    return replace(part, together=part.together + 1)


def _is_same(a: Cloud, b: Cloud, config: PartConfig) -> bool:
    return share_near(a.keys, b) >= config.same_share and share_near(b.keys, a) >= config.same_share
