"""Replay of a recorded run to sinks, from the map folder alone.

A map folder has no depth: a keyframe shows its image, masks, decisions and the map.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hickory_stream.events import FrameObserved, KeyframeRegistered
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import compose
from hickory_stream.journal.reader import Journal
from hickory_stream.journal.step import FramePose, StepKind
from hickory_stream.map_folder.history.core_replay import Replay, Replayed
from hickory_stream.map_folder.history.frame_reports import final_report, in_map_frame
from hickory_stream.map_folder.history.recorded_config import recorded_config
from hickory_stream.ports import Sink
from hickory_stream.records import Decision, FrameReport, MapSnapshot, Segmentation


def replay(path: Path, sinks: Sequence[Sink] = ()) -> MapSnapshot:
    """Return the map of a journal's events; `sinks` receive every step, and are closed.

    Raises `MapFolderError`: there is no map or no journal, or it is damaged or of another version.
    """
    config = recorded_config(path)
    try:
        with Journal(path) as journal:
            again = Replay(journal, config.mapping)
            shown = _show(again, journal, sinks)
            snapshot = again.snapshot()
            if shown.last is not None and shown.camera is not None:
                pose = compose(shown.map_from_odometry, shown.last.world_from_camera)
                final = final_report(
                    shown.last,
                    pose,
                    shown.camera,
                    snapshot,
                    keyframe_index=shown.num_keyframes,
                    decisions=tuple(shown.unreported),
                )
                for sink in sinks:
                    sink.show(in_map_frame(final, snapshot))
    finally:
        for sink in sinks:
            sink.close()
    return snapshot


def show_until_resumed(path: Path, sinks: Sequence[Sink]) -> None:
    """Show sinks the steps of an interrupted run that `resume` continues; the sinks stay open.

    Raises `MapFolderError`: there is no map or no journal, or it is damaged or of another version.
    """
    config = recorded_config(path)
    with Journal(path) as journal:
        journal.cut_to_resumable()
        _show(Replay(journal, config.mapping), journal, sinks)


@dataclass(slots=True)
class _Shown:
    last: FramePose | None = None
    camera: Camera | None = None
    num_keyframes: int = 0
    #: decisions of steps that are no keyframe, such as the end of the log
    unreported: list[Decision] = field(default_factory=list)
    map_from_odometry: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))


def _show(again: Replay, journal: Journal, sinks: Sequence[Sink]) -> _Shown:
    shown = _Shown()
    newest: MapSnapshot | None = None
    for replayed in again.steps(len(journal)):
        step = replayed.entry.step
        shown.camera = step.camera
        shown.last = step.frames[-1] if step.frames else shown.last
        for sink in sinks:
            for report in _reports(replayed, journal, shown.num_keyframes, shown.map_from_odometry):
                sink.show(in_map_frame(report, report.snapshot or newest))
        for event in replayed.entry.events:
            if isinstance(event, KeyframeRegistered):
                shown.map_from_odometry = event.map_from_odometry
        if replayed.published is not None:
            newest = replayed.published.snapshot
            if step.kind is not StepKind.KEYFRAME:
                shown.unreported += replayed.published.decisions
        shown.num_keyframes = step.num_keyframes
    return shown


def _reports(
    replayed: Replayed, journal: Journal, keyframe_index: int, map_from_odometry: NDArray[np.float64]
) -> list[FrameReport]:
    step, published = replayed.entry.step, replayed.published
    observed = next((event for event in replayed.entry.events if isinstance(event, FrameObserved)), None)
    is_keyframe = step.kind is StepKind.KEYFRAME and observed is not None and published is not None
    reports = []
    for frame in step.frames:
        report = FrameReport(
            index=frame.index,
            stamp_ns=frame.stamp_ns,
            keyframe_index=None,
            camera=step.camera,
            world_from_camera=compose(map_from_odometry, frame.world_from_camera),
            color_bytes=None,
        )
        if is_keyframe and observed is not None and published is not None and frame.index == observed.frame_index:
            report = replace(
                report,
                keyframe_index=keyframe_index,
                world_from_camera=observed.world_from_camera,
                color_bytes=journal.color(replayed.index),
                segmentation=_segmentation(observed, step.camera),
                observations=observed.observations,
                object_ids=published.object_ids,
                rejected=observed.rejected,
                space=observed.space,
                decisions=published.decisions,
                snapshot=published.snapshot,
                metrics=(*step.metrics, *published.metrics),
            )
        reports.append(report)
    return reports


def _segmentation(observed: FrameObserved, camera: Camera) -> Segmentation:
    # Which pixels were structure is not recorded.
    instances = np.zeros((camera.height, camera.width), dtype=np.int32)
    for observation in observed.observations:
        x0, y0, x1, y1 = observation.box_px
        instances[y0:y1, x0:x1][observation.mask] = observation.index + 1
    return Segmentation(instances=instances, structure=np.zeros(instances.shape, dtype=bool))
