"""Converts a report into all of its log items."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.records import FrameReport, MapSnapshot
from hickory_stream.sinks.rerun.blueprint import default_blueprint
from hickory_stream.sinks.rerun.config import RerunConfig
from hickory_stream.sinks.rerun.frame import (
    ClassColors,
    FeatureColors,
    Trajectory,
    camera_items,
    color_items,
    depth_items,
    mask_items,
    rejected_items,
)
from hickory_stream.sinks.rerun.graph import GraphLines
from hickory_stream.sinks.rerun.items import LogItem, Span
from hickory_stream.sinks.rerun.labels import MEANINGS, ObjectLabels, legend_item
from hickory_stream.sinks.rerun.objects import ObjectLayers
from hickory_stream.sinks.rerun.plots import Plots, decision_items
from hickory_stream.sinks.rerun.structure import Structure
from hickory_stream.sinks.rerun.views import BestViews

# A growing cloud is logged at most this often.
_CLOUD_PERIOD_S = 1.0


class RerunScene:
    """Converts reports, and remembers what was logged."""

    def __init__(self, config: RerunConfig, folder: Path) -> None:
        self._config = config
        period_ns = round(_CLOUD_PERIOD_S * 1e9)
        self._layers = ObjectLayers(
            folder=folder,
            max_points=config.max_points_per_object,
            cloud_period_ns=period_ns,
            texture_px=config.texture_px,
        )
        self._labels = ObjectLabels(period_ns=period_ns)
        self._views = BestViews(config.jpeg_quality)
        self._plots = Plots()
        self._trajectory = Trajectory()
        self._structure = Structure()
        self._graph = GraphLines()
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
        """Return the delayed items: clouds, labels and structure at the end, thumbnails without gaps."""
        structure = [] if self._last_snapshot is None else self._structure.items(self._last_snapshot)
        objects = self._layers.finish() + self._labels.finish()
        return self._trajectory.items() + objects + structure + self._views.finish()

    def corners(self) -> NDArray[np.float64]:
        """Return (N, 3) the corners of the map; none without objects."""
        return self._layers.corners()

    def blueprint(self, corners: NDArray[np.float64], *, is_live: bool) -> Any:
        """Return the default layout with these (N, 3) points in view."""
        return default_blueprint(corners, num_views=self._views.num_tiles, is_live=is_live)

    def _keyframe_items(self, report: FrameReport) -> list[LogItem]:
        items = self._trajectory.items()
        if report.frame is not None:
            items += depth_items(report.frame)
        items += self._views.items(report) + self._feature_colors.items(report)
        if report.frame is not None or report.segmentation is not None:
            # The report after the last frame has none: what was seen last stays.
            items += self._class_colors.items(report.object_ids) + mask_items(report) + rejected_items(report)
        if report.snapshot is not None:
            self._last_snapshot = report.snapshot
            items += self._graph.items(report)
            items += self._layers.update(report.snapshot.objects, report.stamp_ns)
            items += self._labels.update(report.snapshot.objects, report.stamp_ns)
            items += self._structure.grown(report.snapshot, report.space)
        return items

    def _first_items(self) -> list[LogItem]:
        import rerun as rr

        axes = LogItem(path="world", archetypes=(rr.ViewCoordinates.RIGHT_HAND_Z_UP,), span=Span.STATIC)
        return [axes, legend_item(MEANINGS)]
