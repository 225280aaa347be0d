"""Odometry of a depth camera: its depth is registered as a scan, from the motion that its colour shows.

Depth slides along walls and floors, and colour shows nothing of bare ones: both count by their information. A frame
that fits neither way is tried against earlier keyframes before it is lost.
"""

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.rigid import compose, invert
from hickory_stream.ports import NotRegistered, Registered
from hickory_stream.poses.choose import make_odometry
from hickory_stream.poses.depth_scan import scan_of_depth
from hickory_stream.poses.odometry_config import MethodName
from hickory_stream.poses.visual_motion import Sighting, VisualMotion, features_of
from hickory_stream.poses.voxel_map_odometry import VoxelMapOdometry
from hickory_stream.records import Frame


class CameraOdometry:
    """The odometry of frames by a method; KISS-ICP takes their depth alone."""

    def __init__(self, method: MethodName | None = None) -> None:
        self._by_depth = make_odometry("depth", method)
        self._by_color = VisualMotion()
        self._last: NDArray[np.float64] | None = None

    @property
    def name(self) -> str:
        """The name of the method."""
        return self._by_depth.name

    def register(self, frame: Frame, last_from_frame: NDArray[np.float64] | None = None) -> Registered | NotRegistered:
        """Return the pose of a frame; `last_from_frame` (4, 4): its motion since the last registered one, if known."""
        by_depth, scan = self._by_depth, scan_of_depth(frame)
        if not isinstance(by_depth, VoxelMapOdometry):
            return by_depth.register(scan, last_from_frame)
        features = features_of(frame)
        sighting = self._by_color.sighted(features)
        found = by_depth.register(scan, *self._motion(sighting, last_from_frame))
        if isinstance(found, NotRegistered) and (sighting is None or sighting.is_tracked):
            again = self._by_color.found(features)
            found = found if again is None else by_depth.register(scan, *self._motion(again, None))
        if isinstance(found, Registered):
            self._last = found.start_from_sensor
            self._by_color.placed(features, found.start_from_sensor)
        return found

    def _motion(
        self, sighting: Sighting | None, known: NDArray[np.float64] | None
    ) -> tuple[NDArray[np.float64] | None, NDArray[np.float64] | None]:
        # A place in the map needs the surface's consent: things look alike.
        if sighting is None or self._last is None:
            return known, None
        measured = sighting.information if sighting.is_tracked else None
        return compose(invert(self._last), sighting.start_from_camera), measured
