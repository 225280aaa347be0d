"""One report in, everything that is to be logged of it out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hickory_stream.sinks.rerun_blueprint import default_blueprint
from hickory_stream.sinks.rerun_frame import (
    ClassColors,
    FeatureColors,
    Trajectory,
    camera_items,
    color_items,
    depth_items,
    mask_items,
    rejected_items,
)
from hickory_stream.sinks.rerun_items import LogItem, Span
from hickory_stream.sinks.rerun_numbers import Plots, decision_items
from hickory_stream.sinks.rerun_objects import ObjectLayers
from hickory_stream.sinks.rerun_space import structure_items
from hickory_stream.sinks.rerun_views import BestViews

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from hickory_stream.records import FrameReport, MapSnapshot
    from hickory_stream.sinks.rerun_sink import RerunConfig


class RerunScene:
    """Remembers what was logged, so that only changes are."""

    def __init__(self, config: RerunConfig, shapes_folder: Path) -> None:
        self._config = config
        self._layers = ObjectLayers(
            shapes_folder=shapes_folder,
            max_points=config.max_points_per_object,
            cloud_period_ns=round(config.cloud_period_s * 1e9),
        )
        self._views = BestViews(config.jpeg_quality)
        self._plots = Plots()
        self._trajectory = Trajectory()
        self._class_colors = ClassColors()
        self._feature_colors = FeatureColors()
        self._last_snapshot: MapSnapshot | None = None
        self._num_frames = 0

    def items(self, report: FrameReport) -> list[LogItem]:
        """Return the items of one report."""
        items = self._first_items() if self._num_frames == 0 else []
        items += camera_items(report)
        if report.keyframe_index is not None or self._num_frames % self._config.color_every == 0:
            items += color_items(report, self._config.jpeg_quality)
        self._num_frames += 1
        self._trajectory.add(report.world_from_camera)
        if report.keyframe_index is not None:
            items += self._keyframe_items(report)
        return items + self._plots.items(report) + decision_items(report.decisions)

    def finish(self) -> list[LogItem]:
        """Return what was held back: the clouds and the structure as they are at the end."""
        structure = [] if self._last_snapshot is None else structure_items(self._last_snapshot)
        return self._trajectory.items() + self._layers.finish() + structure

    def bounds(self) -> tuple[NDArray[Any], NDArray[Any]] | None:
        """Return the corners of the map; None while it has no objects."""
        return self._layers.bounds()

    def blueprint(self, bounds: tuple[NDArray[Any], NDArray[Any]] | None) -> Any:
        """Return the default arrangement, looking at these corners."""
        return default_blueprint(bounds)

    def _keyframe_items(self, report: FrameReport) -> list[LogItem]:
        items = self._trajectory.items()
        if report.frame is not None:
            items += depth_items(report.frame)
        items += self._class_colors.items(report.object_ids) + mask_items(report) + self._views.items(report)
        items += rejected_items(report) + self._feature_colors.items(report)
        if report.snapshot is not None:
            self._last_snapshot = report.snapshot
            items += self._layers.update(report.snapshot.objects, report.stamp_ns)
            assert report.keyframe_index is not None
            if report.keyframe_index % self._config.structure_every == 0:
                items += structure_items(report.snapshot)
        return items

    def _first_items(self) -> list[LogItem]:
        import rerun as rr

        return [LogItem(path="world", archetypes=(rr.ViewCoordinates.RIGHT_HAND_Z_UP,), span=Span.STATIC)]
