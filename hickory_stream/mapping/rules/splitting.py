"""Split candidates: parts of a track that keyframes segment apart, to repair under-segmentation by an early view.

E.g. a bowl that an early view segmented with its table. An observation on a track that another observation of the
keyframe matches is a part of that track, its host. A part that recurs, mostly apart, becomes a track of its own.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from hickory_stream.base.ranges import Ranged, number
from hickory_stream.mapping.entities.cloud import Cloud, fuse, share_near

# Minimum ratio of the time for which a part is segmented apart to that for which it is segmented with its host.
_APART_RATIO = 2.0
# Two observations belong to one candidate if this share of each cloud lies on the other.
SAME_SHARE = 0.45
# An observation of the host that covers this share of the candidate counts as together, unless this share of the
# observation lies on the candidate.
_COVERED_SHARE = 0.6
_ALONE_SHARE = 0.8
# Candidates with fewer voxels are noise.
MIN_VOXELS = 40


@dataclass(frozen=True, kw_only=True, slots=True)
class TrackSplitConfig(Ranged):
    """When a part is split off its host."""

    #: Minimum time for which keyframes segment the part apart.
    min_apart_s: float = number(1.5, 0, 1e9, "s")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SplitCandidate:
    """A part of a host, and for how long keyframes segmented it apart and together with the host."""

    cloud: Cloud
    #: the last keyframe that segmented it apart
    frame_index: int
    sightings: int
    apart_ns: int
    together_ns: int = 0

    def is_object(self, config: TrackSplitConfig) -> bool:
        """Return whether it was segmented apart often enough to be an object."""
        return self.apart_ns >= 1e9 * config.min_apart_s and self.apart_ns >= _APART_RATIO * self.together_ns


# By the id of their host.
SplitCandidates = dict[int, tuple[SplitCandidate, ...]]


def with_keyframe(
    candidates: Mapping[int, tuple[SplitCandidate, ...]],
    frame_index: int,
    passed_ns: int,
    apart: Sequence[tuple[int, Cloud]],
    whole: Sequence[tuple[int, Cloud]],
) -> SplitCandidates:
    """Return the candidates after a keyframe, which counts for `passed_ns`.

    `apart`, `whole`: (host id, cloud) of observed parts and whole tracks.
    """
    updated = dict(candidates)
    for host_id, cloud in apart:
        if len(cloud.keys) >= MIN_VOXELS:
            updated[host_id] = _with_candidate(updated.get(host_id, ()), frame_index, passed_ns, cloud)
    for host_id, cloud in whole:
        if host_id in updated:
            updated[host_id] = tuple(_seen_with(own, frame_index, passed_ns, cloud) for own in updated[host_id])
    return updated


def reassigned(candidates: Mapping[int, tuple[SplitCandidate, ...]], kept: int, gone: int) -> SplitCandidates:
    """Return the candidates after track `gone` was merged into `kept`."""
    updated = {host: own for host, own in candidates.items() if host != gone}
    if gone in candidates:
        updated[kept] = (*updated.get(kept, ()), *candidates[gone])
    return updated


def _with_candidate(
    own: tuple[SplitCandidate, ...], frame_index: int, passed_ns: int, cloud: Cloud
) -> tuple[SplitCandidate, ...]:
    for i, candidate in enumerate(own):
        if _is_same(candidate.cloud, cloud):
            if frame_index == candidate.frame_index:
                return own
            apart_ns, sightings = candidate.apart_ns + passed_ns, candidate.sightings + 1
            both = fuse(candidate.cloud, cloud)
            seen = replace(candidate, cloud=both, frame_index=frame_index, sightings=sightings, apart_ns=apart_ns)
            return (*own[:i], seen, *own[i + 1 :])
    return (*own, SplitCandidate(cloud=cloud, frame_index=frame_index, sightings=1, apart_ns=passed_ns))


def _seen_with(candidate: SplitCandidate, frame_index: int, passed_ns: int, whole: Cloud) -> SplitCandidate:
    if frame_index == candidate.frame_index or share_near(candidate.cloud.keys, whole) < _COVERED_SHARE:
        return candidate
    # An observation of the part alone is no evidence: the rest may be occluded, or outside of the image.
    if share_near(whole.keys, candidate.cloud) >= _ALONE_SHARE:
        return candidate
    return replace(candidate, together_ns=candidate.together_ns + passed_ns)


def _is_same(a: Cloud, b: Cloud) -> bool:
    return share_near(a.keys, b) >= SAME_SHARE and share_near(b.keys, a) >= SAME_SHARE
