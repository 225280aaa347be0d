"""A track in another frame, and whether two tracks that lie at one place are the same object."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from hickory_stream.geometry.boxes import box_iou, intersection_volume_m3
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.superquadric import moved
from hickory_stream.mapping.cloud import moved_cloud, share_near
from hickory_stream.mapping.existence import Existence
from hickory_stream.mapping.moved import moved_box, moved_shape, moved_view
from hickory_stream.mapping.track import with_cloud
from hickory_stream.mapping.views import sector_of

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from hickory_stream.mapping.mapping_config import MappingConfig
    from hickory_stream.mapping.track import Track


def moved_track(track: Track, new_from_old: NDArray[np.float64], voxel_m: float) -> Track:
    """Return a track in another frame, its cloud on the lattice there; `new_from_old` (4, 4) is rigid."""
    views = {view.name: moved_view(view, new_from_old) for view in track.views}
    known = track.existence
    there = replace(
        with_cloud(track, moved_cloud(track.cloud, new_from_old, voxel_m), track.sightings, voxel_m),
        best_view=None if track.best_view is None else views[track.best_view.name],
        shape=None if track.shape is None else moved_shape(track.shape, new_from_old),
        sketch=None if track.sketch is None else moved(track.sketch, new_from_old),
        existence=Existence(evidence=known.evidence, places=apply(new_from_old, known.places)),
    )
    kept = [views[view.name] for _, view in track.coverage]
    sectors = {sector_of(view, there.box.center): view for view in kept}
    return replace(there, coverage=tuple(sorted(sectors.items())))


def sameness(a: Track, b: Track, a_from_b: NDArray[np.float64], config: MappingConfig) -> float:
    """Return how surely two tracks at one place are the same object: 1 to 2 by boxes, up to 1 by points, 0 not."""
    associate_config = config.associate
    there = moved_box(b.box, a_from_b)
    iou = box_iou(a.box, there)
    if iou >= associate_config.min_iou:
        return 1.0 + iou
    a_is_small = a.box.volume_m3 < b.box.volume_m3
    least = min(a.box.volume_m3, b.box.volume_m3)
    if intersection_volume_m3(a.box, there) < associate_config.min_lies_on * least:
        return 0.0
    own = moved_cloud(b.solid, a_from_b, config.lattice.points_m)
    share = share_near(a.solid.keys, own) if a_is_small else share_near(own.keys, a.cloud)
    return share if share >= associate_config.min_lies_on else 0.0
