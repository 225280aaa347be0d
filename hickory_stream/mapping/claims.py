"""What a generated shape claims of space that nobody had seen, held against what a later view sees there.

A generator makes up what is behind an object. Where a keyframe looks there and finds free space, the shape is asked for
again: its views then show that space, so that what is made anew is cut where they saw through it, and judged by them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry.superquadric_surface import display_mesh
from hickory_stream.geometry.voxels import contains, keys_of_points

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.mapping.map_state import MapState
    from hickory_stream.mapping.mapping_config import MappingConfig
    from hickory_stream.mapping.track import Track
    from hickory_stream.records import ObjectShape

# Parts of which less was made up say nothing of the generator.
_MADE_UP = 0.05
# So far from a part's centre to its surface; what is fitted may reach beyond the mesh by less than the rest.
_INWARDS = 0.75


def with_claims_checked(state: MapState, track: Track, free_keys: NDArray[np.int64], config: MappingConfig) -> Track:
    """Return the track, its shape to be asked for again where a keyframe's sorted `free_keys` contradict it.

    Nothing is asked twice: the views must be others than those of the last request.
    """
    shape, asked = track.shape, track.shape_state
    if shape is None or not shape.is_generated or asked.open_ticket is not None or not asked.asked_views:
        return track
    if set(track.names_of_views) == set(asked.asked_views):
        return track
    places = _claimed(shape)
    if len(places) == 0:
        return track
    free = float(contains(free_keys, keys_of_points(places, config.lattice.space_m)).mean())
    if free < config.requests.refuted_share:
        return track
    state.decide("shape", track.id, f"{free:.2f} of its generated shape was seen to be free: to be asked for again")
    # As if nothing had been asked yet, but that there is a shape: all views and all surface count as new.
    again = replace(asked, asked_views=(), asked_points=0, asked_score=0.0)
    return replace(track, shape_state=again)


def _claimed(shape: ObjectShape) -> NDArray[np.float32]:
    """Return (N, 3) places within the parts of a shape of which something was made up.

    An envelope is larger than its object on purpose: it claims nothing.
    """
    if shape.fit_kind == "envelope":
        return np.empty((0, 3), np.float32)
    places = [np.empty((0, 3), np.float32)]
    for i in np.flatnonzero(shape.seen_share < 1 - _MADE_UP):
        center = shape.fitted.world_from_local[i, :3, 3]
        surface, _ = display_mesh(shape.fitted, int(i))
        places.append((center + _INWARDS * (surface - center)).astype(np.float32))
    return np.concatenate(places)
