"""A track: the immutable state of one object in the core; and a sighting: one observation of a track."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry import portable
from hickory_stream.geometry.bounds import bounds_of
from hickory_stream.geometry.boxes import OrientedBox, faced_box
from hickory_stream.geometry.flush import flush_heights
from hickory_stream.geometry.lattice import on_steps
from hickory_stream.geometry.lazy_arrays import give_up
from hickory_stream.geometry.sketch import sketch
from hickory_stream.geometry.superquadric import Superquadrics
from hickory_stream.geometry.voxels import without_outliers
from hickory_stream.mapping.entities.cloud import Cloud, array_of, fuse, solid_part
from hickory_stream.mapping.entities.views import better
from hickory_stream.records import ObjectKind, ObjectShape, Observation, Phase, TrackedObject, View

_BOX_POINTS = 10_000
_NO_POINTS, _NO_COLORS = np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8)
# The sketch, a preliminary superquadric, is fitted again when the number of solid points changed by this share.
_SKETCH_GROWTH = 0.3


@dataclass(frozen=True, kw_only=True, slots=True)
class ShapeState:
    """The state of a track's shape jobs: the open ticket, and the inputs of the last request."""

    open_ticket: int | None = None
    asked_clock_ns: int = 0
    asked_points: int = 0
    asked_views: tuple[str, ...] = ()
    asked_score: float = 0.0
    #: the last request replaced an open job
    is_replacement: bool = False
    failures: int = 0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Track:
    """One object as the core holds it."""

    id: int
    phase: Phase
    sightings: int
    first_seen_ns: int
    last_seen_ns: int
    #: time of the core's own clock, which a jump of the stamps does not change
    seen_clock_ns: int
    cloud: Cloud
    #: the cloud without voxels that are likely to be noise; it gives `box` and `bounds`
    solid: Cloud
    box: OrientedBox
    #: least and greatest coordinates (2, 3), for a fast test whether two objects can touch
    bounds: NDArray[np.float32]
    #: the kept views by viewing sector
    coverage: tuple[tuple[int, View], ...] = ()
    best_view: View | None = None
    shape: ObjectShape | None = None
    shape_state: ShapeState = ShapeState()
    merged_ids: tuple[int, ...] = ()
    #: how long keyframes have seen through the object's place since it was last seen
    seen_through_ns: int = 0
    #: it was split off another track, and must not be merged back as a part
    is_promoted: bool = False
    #: the submap in which it was first seen
    submap_id: int = 0
    #: the submap in which it was last seen
    seen_in: int = 0
    #: superquadric fitted to `sketched_points` points; None while tentative and once it has a shape
    sketch: Superquadrics | None = None
    sketched_points: int = 0
    #: evidence for its existence: how long it was observed (`lifecycle.counted_ns`)
    observed_ns: int = 0
    kind: ObjectKind = ObjectKind.OBJECT
    fixture_probability: float = 0.0
    #: numbers of its solid points and of its sightings when its kind was judged last
    judged_points: int = 0
    judged_sightings: int = 0
    #: more likely than not it is attached to the room; a fixture that is not is one by its size
    is_attached: bool = False

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
    observed_ns: int = 0,
    voxel_m: float,
) -> Track:
    """Return a new track of a cloud."""
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
        observed_ns=observed_ns,
    )


def grown(track: Track, seen: Cloud, sightings: int, voxel_m: float) -> Track:
    """Return the track with a cloud fused into its own; `sightings` is the new total."""
    return with_cloud(track, fuse(track.cloud, seen), sightings, voxel_m)


def with_cloud(track: Track, cloud: Cloud, sightings: int, voxel_m: float) -> Track:
    """Return the track with another cloud; `sightings` is the new total."""
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
    """Return whether a track is confirmed: an object, or a fixture."""
    return track.phase is not Phase.TENTATIVE


def touching(bounds: NDArray[np.float32], tracks: Sequence[Track], slack_m: float = 0.03) -> list[Track]:
    """Return the tracks whose bounds come within `slack_m` of the given ones, in their order."""
    if not tracks:
        return []
    theirs = np.concatenate([track.bounds for track in tracks]).reshape(-1, 2, 3)
    near = ((bounds[0] <= theirs[:, 1] + slack_m) & (theirs[:, 0] <= bounds[1] + slack_m)).all(axis=1)
    return [track for track, is_near in zip(tracks, near, strict=True) if is_near]


def box_of(points: NDArray[Any], voxel_m: float) -> OrientedBox:
    """Return the upright box of a cloud without outliers, along its sides; large clouds are subsampled."""
    points = points[:: max(1, len(points) // _BOX_POINTS)]
    return faced_box(points[without_outliers(points)], voxel_m)


def settled(solid: Cloud, voxel_m: float) -> tuple[NDArray[np.float32], OrientedBox] | None:
    """Return the points and the box of a cloud that is flush with the plane behind it, without its depth's noise."""
    *summed, total = solid.behind
    share = portable.norm(summed[:3])
    # Two planes at right angles, each in half of the views by their information, would reach this share.
    if not 2 * share * share > total * total:
        return None
    x, y, z, offset = (value / share for value in summed)
    normal, points = np.array([x, y, z]), solid.points.astype(np.float64)
    feet = points - (portable.matmul(points, normal[:, None]) - offset) * normal
    width = 2 * float(np.sort(box_of(feet, voxel_m).half_extents_m)[1])
    heights_m = flush_heights(points, solid.weights, solid.hits / solid.weights, (x, y, z, offset), width)
    if heights_m is None:
        return None
    fronts = feet + heights_m[:, None] * normal
    return on_steps(fronts), box_of(np.concatenate([fronts, feet]), voxel_m / 2)


def as_object(track: Track, voxel_m: float) -> TrackedObject:
    """Return the public record of a track; its arrays are read from the track, perhaps compressed, on first use."""
    solid = track.solid
    flush = settled(solid, voxel_m)
    item = TrackedObject(
        id=track.id,
        phase=track.phase,
        submap_id=track.submap_id,
        sightings=track.sightings,
        first_seen_ns=track.first_seen_ns,
        last_seen_ns=track.last_seen_ns,
        points_world=_NO_POINTS,
        colors=_NO_COLORS,
        box=track.box if flush is None else flush[1],
        feature=_mean_feature(track.views),
        views=track.views,
        best_view=track.best_view,
        shape=track.shape,
        merged_ids=track.merged_ids,
        sketch=track.sketch if track.shape is None else None,
        kind=track.kind,
        fixture_probability=track.fixture_probability,
    )
    own_m = None if flush is None else voxel_m
    give_up(item, lambda name: _shown(solid, name, own_m), "points_world", "colors", of=(solid,))
    return item


def _shown(solid: Cloud, name: str, flush_m: float | None) -> NDArray[Any]:
    # The same points, not a copy: nobody writes to the view.
    if name == "points_world":
        flush = None if flush_m is None else settled(solid, flush_m)
        return array_of(solid, "points").view() if flush is None else flush[0]
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
    """An observation, its cloud and its track."""

    observation: Observation
    cloud: Cloud
    track_id: int
    #: it shows only a part of the track, which another observation of the keyframe matches
    is_part: bool
    #: share of its points on the track if it was matched by points, else 0
    lies_on: float
    #: other tracks that it covers: the keyframe segments them together with the track
    covered: tuple[int, ...]
