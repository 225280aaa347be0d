"""What follows from the tracks of a state: no part of what is saved, and kept up with the tracks that change."""

from __future__ import annotations

from dataclasses import dataclass, field

from hickory_stream.mapping.room_voxels import RoomVoxels
from hickory_stream.mapping.shape_wishes import ShapeWishes
from hickory_stream.mapping.view_use import ViewUse
from hickory_stream.mapping.warm_tracks import WarmTracks


@dataclass(kw_only=True, slots=True, eq=False)
class Derived:
    """The `room`'s voxels as the submaps have them, the `views` in use, `wishes` for shapes, and the `warm` tracks."""

    room: RoomVoxels = field(default_factory=RoomVoxels)
    views: ViewUse = field(default_factory=ViewUse)
    wishes: ShapeWishes = field(default_factory=ShapeWishes)
    warm: WarmTracks = field(default_factory=WarmTracks)
