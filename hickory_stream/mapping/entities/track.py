"""A track: the state of one object in the core. Immutable; each update makes a new one.

A sighting: one observation of a keyframe, and the track that it was assigned to.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.geometry import portable
from hickory_stream.geometry.bounds import bounds_of
from hickory_stream.geometry.boxes import OrientedBox, gravity_aligned_box
from hickory_stream.geometry.lazy_arrays import give_up
from hickory_stream.geometry.sketch import sketch
from hickory_stream.geometry.voxels import without_outliers
from hickory_stream.mapping.entities.cloud import Cloud, array_of, fuse, solid_part
from hickory_stream.mapping.entities.existence import Existence, no_evidence
from hickory_stream.mapping.entities.views import better
from hickory_stream.records import Phase, TrackedObject, View

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from numpy.typing import NDArray

    from hickory_stream.geometry.superquadric import Superquadrics
    from hickory_stream.records import ObjectShape, Observation


_BOX_POINTS = 10_000
_NO_POINTS, _NO_COLORS = np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8)
# The sketch, a preliminary superquadric, is fitted again when the number of solid points changed by this share.
_SKETCH_GROWTH = 0.3


@dataclass(frozen=True, kw_only=True, slots=True)
class ShapeState:
    """The state of a track's shape jobs: the open ticket, and the inputs of the last request.

    `is_replacement`: the last request replaced an open job.
    """

    open_ticket: int | None = None
    asked_clock_ns: int = 0
    asked_points: int = 0
    asked_views: tuple[str, ...] = ()
    asked_score: float = 0.0
    is_replacement: bool = False
    failures: int = 0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Track:
    """One object as the core holds it.

    `seen_clock_ns` is a time of the core's own clock, which a jump of the stamps does not change. `solid` is the cloud
    without voxels that are likely to be noise; the box and the `bounds` are made from it. `bounds` (2, 3): least and
    greatest coordinates, for a fast test whether two objects can touch. `coverage` holds the kept views by viewing
    sector. `seen_through` counts keyframes that saw through the object's place, `doubts` consecutive keyframes that
    under-segmented it with its surroundings. `is_promoted`: it was split off another track and must not be merged back
    as a part of it. `submap_id` is the submap in which it was first seen, `seen_in` the one in which it was last seen.
    `existence` is the evidence that the object exists, `aside_evidence` that evidence when the track was last set aside
    as part of the room. `sketch` is a superquadric fitted to `sketched_points` points, None while the track is
    tentative and once it has a shape.
    """

    id: int
    phase: Phase
    sightings: int
    first_seen_ns: int
    last_seen_ns: int
    seen_clock_ns: int
    cloud: Cloud
    solid: Cloud
    box: OrientedBox
    bounds: NDArray[np.float32]
    coverage: tuple[tuple[int, View], ...] = ()
    best_view: View | None = None
    shape: ObjectShape | None = None
    shape_state: ShapeState = ShapeState()
    merged_ids: tuple[int, ...] = ()
    seen_through: int = 0
    doubts: int = 0
    is_promoted: bool = False
    submap_id: int = 0
    seen_in: int = 0
    sketch: Superquadrics | None = None
    sketched_points: int = 0
    existence: Existence = field(default_factory=no_evidence)
    aside_evidence: float = 0.0

    @property
    def names_of_views(self) -> tuple[str, ...]:
        """The names of the kept views, each once."""
        names = dict.fromkeys(view.name for _, view in self.coverage)
        if self.best_view is not None:
            names[self.best_view.name] = None
        return tuple(names)

    @property
    def views(self) -> tuple[View, ...]:
        """The kept views, each once, in the order of their frames."""
        kept = {view.name: view for _, view in self.coverage}
        if self.best_view is not None:
            kept[self.best_view.name] = self.best_view
        return tuple(sorted(kept.values(), key=lambda view: (view.frame_index, view.box_px)))


def new_track(
    track_id: int,
    cloud: Cloud,
    *,
    phase: Phase,
    stamp_ns: int,
    clock_ns: int,
    sightings: int,
    submap_id: int,
    existence: Existence,
    voxel_m: float,
) -> Track:
    """Return a new track with a cloud that was first seen at a stamp, in a submap."""
    return Track(
        id=track_id,
        phase=phase,
        sightings=sightings,
        first_seen_ns=stamp_ns,
        last_seen_ns=stamp_ns,
        seen_clock_ns=clock_ns,
        cloud=cloud,
        solid=cloud,
        box=box_of(cloud.points, voxel_m),
        bounds=bounds_of(cloud.points),
        submap_id=submap_id,
        seen_in=submap_id,
        existence=existence,
    )


def grown(track: Track, seen: Cloud, sightings: int, voxel_m: float) -> Track:
    """Return the track with a cloud fused into its own and the box updated; `sightings` is the new total."""
    return with_cloud(track, fuse(track.cloud, seen), sightings, voxel_m)


def with_cloud(track: Track, cloud: Cloud, sightings: int, voxel_m: float) -> Track:
    """Return the track with another cloud, and the box and bounds updated; `sightings` is the new total."""
    sure = solid_part(cloud, sightings)
    return replace(
        track,
        cloud=cloud,
        solid=sure,
        sightings=sightings,
        box=box_of(sure.points, voxel_m),
        bounds=bounds_of(sure.points),
    )


def sketched(track: Track) -> Track:
    """Return the track with its sketch updated, if it is an object without a shape and its points have changed."""
    if not is_object(track) or track.shape is not None:
        return track
    count, before = len(track.solid), track.sketched_points
    if abs(count - before) <= _SKETCH_GROWTH * before:
        return track
    return replace(track, sketch=sketch(track.solid.points, track.box), sketched_points=count)


def without_views(track: Track, names: Collection[str]) -> Track:
    """Return the track without the views of these names; the best remaining one becomes its best view."""
    coverage = tuple((sector, view) for sector, view in track.coverage if view.name not in names)
    best = track.best_view
    if best is not None and best.name in names:
        best = None
        for _, view in coverage:
            best = better(best, view) if view.score is not None else best
    return replace(track, coverage=coverage, best_view=best)


def is_object(track: Track) -> bool:
    """Return whether a track is an object: confirmed, and not part of the room."""
    return track.phase not in (Phase.TENTATIVE, Phase.ROOM)


def touching(bounds: NDArray[np.float32], tracks: Sequence[Track], slack_m: float = 0.03) -> list[Track]:
    """Return the tracks whose bounds come within `slack_m` of the given ones, in their order."""
    if not tracks:
        return []
    theirs = np.concatenate([track.bounds for track in tracks]).reshape(-1, 2, 3)
    near = ((bounds[0] <= theirs[:, 1] + slack_m) & (theirs[:, 0] <= bounds[1] + slack_m)).all(axis=1)
    return [track for track, is_near in zip(tracks, near, strict=True) if is_near]


def box_of(points: NDArray[np.float32], voxel_m: float) -> OrientedBox:
    """Return the gravity-aligned box of a cloud without outliers; large clouds are subsampled."""
    points = points[:: max(1, len(points) // _BOX_POINTS)]
    return gravity_aligned_box(points[without_outliers(points)], voxel_m)


def as_object(track: Track) -> TrackedObject:
    """Return the public record of a track; its arrays are made of the track's, which may be compressed, when read."""
    solid = track.solid
    item = TrackedObject(
        id=track.id,
        phase=track.phase,
        submap_id=track.submap_id,
        sightings=track.sightings,
        first_seen_ns=track.first_seen_ns,
        last_seen_ns=track.last_seen_ns,
        points_world=_NO_POINTS,
        colors=_NO_COLORS,
        box=track.box,
        feature=_mean_feature(track.views),
        views=track.views,
        best_view=track.best_view,
        shape=track.shape,
        merged_ids=track.merged_ids,
        sketch=track.sketch if track.shape is None else None,
    )
    give_up(item, lambda name: _shown(solid, name), "points_world", "colors", of=(solid,))
    return item


def _shown(solid: Cloud, name: str) -> NDArray[Any]:
    """Return an array of the public record of a cloud: the same points, not a copy; nobody writes to the view."""
    if name == "points_world":
        return array_of(solid, "points").view()
    return np.round(array_of(solid, "colors")).astype(np.uint8)


def _mean_feature(views: tuple[View, ...]) -> NDArray[np.float32] | None:
    features = [view.feature for view in views if view.feature is not None]
    if not features:
        return None
    mean = np.mean(np.stack(features).astype(np.float64), axis=0)
    length = portable.norm(mean)
    return (mean / length).astype(np.float32) if length > 0 else None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Sighting:
    """An observation, its cloud and the track that it was assigned to.

    `is_part`: it shows only a part of the track, and another observation of the keyframe is the match of the track.
    `lies_on`: the share of its points on the track if it was matched by points, else 0. `covered`: other tracks that it
    covers, which means that the keyframe segments them together with the track.
    """

    observation: Observation
    cloud: Cloud
    track_id: int
    is_part: bool
    lies_on: float
    covered: tuple[int, ...]
