"""Poses of frame reports: from the odometry's world to the map's, by the correction of the open submap."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry.rigid import compose

if TYPE_CHECKING:
    from hickory_stream.records import FrameReport, MapSnapshot


def in_map_frame(report: FrameReport, snapshot: MapSnapshot | None) -> FrameReport:
    """Return a report with its camera pose corrected as the open submap of the snapshot; None: as it is."""
    if snapshot is None or not snapshot.submaps:
        return report
    world_from_submap = snapshot.submaps[-1].world_from_submap
    if np.array_equal(world_from_submap, np.eye(4)):
        return report
    world_from_camera = compose(world_from_submap, report.world_from_camera)
    frame = None if report.frame is None else replace(report.frame, world_from_camera=world_from_camera)
    return replace(report, world_from_camera=world_from_camera, frame=frame)
