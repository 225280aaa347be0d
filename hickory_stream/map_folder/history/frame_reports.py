"""Reports for sinks: of any frame, of a keyframe with its results, and of the finished map."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry.rigid import compose
from hickory_stream.records import Decision, Frame, FrameReport, MapSnapshot, RawFrame

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.events import Publish
    from hickory_stream.geometry.camera import Camera
    from hickory_stream.journal.step import FramePose
    from hickory_stream.perception.perceive import Perceived


def plain_report(raw: RawFrame, world_from_camera: NDArray[np.float64]) -> FrameReport:
    """Return the report of a frame that is no keyframe, at its pose (4, 4) in the map."""
    return FrameReport(
        index=raw.index,
        stamp_ns=raw.stamp_ns,
        keyframe_index=None,
        camera=raw.camera,
        world_from_camera=world_from_camera,
        color_bytes=raw.color_bytes,
    )


def keyframe_report(
    raw: RawFrame,
    frame: Frame,
    perceived: Perceived,
    published: Publish,
    *,
    keyframe_index: int,
    patches: NDArray[np.float32] | None,
    metrics: tuple[tuple[str, float], ...],
) -> FrameReport:
    """Return the report of a keyframe; the engine's `metrics` come before the core's."""
    return replace(
        plain_report(raw, frame.world_from_camera),
        keyframe_index=keyframe_index,
        frame=frame,
        segmentation=perceived.segmentation,
        observations=perceived.observations,
        object_ids=published.object_ids,
        rejected=perceived.rejected,
        space=perceived.space,
        patches=patches,
        decisions=published.decisions,
        snapshot=published.snapshot,
        metrics=(*metrics, *published.metrics),
    )


def final_report(
    last: FramePose,
    world_from_camera: NDArray[np.float64],
    camera: Camera,
    snapshot: MapSnapshot,
    *,
    keyframe_index: int,
    decisions: tuple[Decision, ...],
) -> FrameReport:
    """Return the report of the finished map: one more keyframe without images, at the pose of the last frame."""
    return FrameReport(
        index=last.index + 1,
        stamp_ns=last.stamp_ns,
        keyframe_index=keyframe_index,
        camera=camera,
        world_from_camera=world_from_camera,
        color_bytes=None,
        decisions=decisions,
        snapshot=snapshot,
    )


def in_map_frame(report: FrameReport, snapshot: MapSnapshot | None) -> FrameReport:
    """Return a report with its pose corrected like the open submap of the snapshot; None: unchanged."""
    if snapshot is None or not snapshot.submaps:
        return report
    world_from_submap = snapshot.submaps[-1].world_from_submap
    if np.array_equal(world_from_submap, np.eye(4)):
        return report
    world_from_camera = compose(world_from_submap, report.world_from_camera)
    frame = None if report.frame is None else replace(report.frame, world_from_camera=world_from_camera)
    return replace(report, world_from_camera=world_from_camera, frame=frame)
