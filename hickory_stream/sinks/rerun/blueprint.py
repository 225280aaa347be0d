"""Default layout of the viewer: all four layers, the camera, the plots and the decisions."""

from typing import Any

import numpy as np
import rerun.blueprint as rrb
from numpy.typing import NDArray

from hickory_stream.sinks.rerun.eye import MAIN_ASPECT, SIDE_ASPECT, WHOLE_ASPECT, eye_on
from hickory_stream.sinks.rerun.frame import CAMERA, TRAJECTORY
from hickory_stream.sinks.rerun.graph import GRAPH
from hickory_stream.sinks.rerun.items import KEYFRAME
from hickory_stream.sinks.rerun.labels import BACKGROUND, LABELS, LEGEND
from hickory_stream.sinks.rerun.objects import FILLED, FITTED_LAYER, INFLATED_LAYER, MESH_LAYER, POINTS_LAYER
from hickory_stream.sinks.rerun.plots import DECISIONS, OBJECT_DECISIONS, PLOTS
from hickory_stream.sinks.rerun.structure import FLOOR, WALLS
from hickory_stream.sinks.rerun.views import VIEWS, sheet_px

ROBOT = "robot"
"""The entity that says how a live route and its topics are."""


def default_blueprint(corners: NDArray[np.float64], *, num_views: int, is_live: bool = False) -> rrb.Blueprint:
    """Return the layout with (N, 3) points in view and `num_views` thumbnails; `is_live` adds the robot's topics."""
    width_px, height_px = sheet_px(num_views)
    layers = _map_view("Layers 1 and 2: points, boxes, meshes", [POINTS_LAYER, MESH_LAYER], corners, MAIN_ASPECT)
    superquadrics = rrb.Vertical(
        _map_view("Layer 3: superquadrics", [FITTED_LAYER], corners),
        _map_view("Layer 4: inflated, over the meshes", [INFLATED_LAYER, MESH_LAYER], corners),
    )
    images = rrb.Vertical(
        rrb.Tabs(
            _camera_view("Camera", ["color", "masks", "boxes", "labels"]),
            _camera_view("Rejected masks", ["color", "rejected/masks", "rejected/boxes"]),
            _camera_view("Features", ["features"]),
            _camera_view("Depth", ["depth"]),
        ),
        rrb.Tabs(
            rrb.Spatial2DView(
                origin=VIEWS,
                name="Best views",
                background=BACKGROUND,
                visual_bounds=rrb.VisualBounds2D(x_range=(0, width_px), y_range=(0, height_px)),
            ),
            _plot("Score S", "score"),
            _plot("S: variance", "variance"),
            _plot("S: area", "area"),
            _plot("S: depth", "depth"),
            _plot("Stage times [s]", "time"),
            _plot("Objects by phase", "objects"),
            _plot("Queues", "queue"),
            _plot("Pose graph", "graph"),
        ),
    )
    robot = [rrb.TextDocumentView(origin=ROBOT, name="Robot")] if is_live else []
    important = _log(DECISIONS, "Merges, drops, splits, confirmations", ["WARN", "INFO"])
    others = (_log(DECISIONS, "All decisions, with scores of views"), _log(OBJECT_DECISIONS, "Decisions by object"))
    # Nearly as wide as the window: a list of candidates is one long line.
    below = rrb.Horizontal(rrb.Tabs(important, *others, *robot), legend_view(), column_shares=[14, 6])
    above = rrb.Horizontal(layers, superquadrics, images, column_shares=[10, 4, 6])
    return arranged(rrb.Vertical(above, below, row_shares=[4, 1]), timeline=KEYFRAME, play_state="following")


def one_map(name: str, corners: NDArray[np.float64], *, timeline: str) -> rrb.Blueprint:
    """Return the layout of a single view with (N, 3) points in it, on its own timeline."""
    return arranged(_over_legend(scene_view(name, ["/world/**"], corners, WHOLE_ASPECT)), timeline=timeline)


def side_by_side(views: dict[str, tuple[list[str], NDArray[np.float64]]]) -> rrb.Blueprint:
    """Return the layout of still views side by side: by name, the entities and (N, 3) points in view."""
    aspect = WHOLE_ASPECT if len(views) == 1 else SIDE_ASPECT
    shown = [scene_view(name, paths, corners, aspect) for name, (paths, corners) in views.items()]
    return arranged(_over_legend(*shown), state="hidden")


def arranged(content: Any, *, state: str = "collapsed", **time: Any) -> rrb.Blueprint:
    """Return a layout without side panels; `state` and `time` are arguments of the time panel."""
    return rrb.Blueprint(
        content,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state=state, **time),
        auto_views=False,
    )


def _over_legend(*views: rrb.Spatial3DView) -> rrb.Vertical:
    return rrb.Vertical(rrb.Horizontal(*views), legend_view(), row_shares=[10, 1])


def scene_view(
    name: str, paths: list[str], corners: NDArray[np.float64], aspect: float, **more: Any
) -> rrb.Spatial3DView:
    """Return a view of entities with (N, 3) points in it, in a place of `aspect`; `more` are other arguments."""
    return rrb.Spatial3DView(
        origin="world",
        name=name,
        contents=[f"+ {path}" for path in paths],
        background=BACKGROUND,
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=eye_on(corners, aspect).controls() if len(corners) else None,
        **more,
    )


def _map_view(
    name: str, layers: list[str], corners: NDArray[np.float64], aspect: float = SIDE_ASPECT
) -> rrb.Spatial3DView:
    shown = [*layers, FLOOR, WALLS]
    if aspect != MAIN_ASPECT:
        return scene_view(name, [f"{path}/**" for path in shown], corners, aspect)
    shown += [TRAJECTORY, GRAPH, LABELS, FILLED]
    hidden = {FILLED: rrb.EntityBehavior(visible=False)}
    # The images are left out: they would hang in the room at the camera and hide what is behind them.
    return scene_view(name, [CAMERA, *(f"{path}/**" for path in shown)], corners, aspect, overrides=hidden)


def _camera_view(name: str, images: list[str]) -> rrb.Spatial2DView:
    return rrb.Spatial2DView(
        origin=CAMERA, name=name, contents=[f"+ {CAMERA}/{image}" for image in images], background=BACKGROUND
    )


def _plot(name: str, group: str) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=f"{PLOTS}/{group}", name=name, plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop)
    )


def legend_view() -> rrb.Spatial2DView:
    """Return the view of the legend (`labels.legend_item`)."""
    return rrb.Spatial2DView(origin=LEGEND, name="Legend", background=BACKGROUND)


def _log(origin: str, name: str, levels: list[str] | None = None) -> rrb.TextLogView:
    columns = rrb.TextLogColumns(timeline_columns=[KEYFRAME], text_log_columns=["loglevel", "body"])
    # The SDK complains about rows without anything in them.
    rows = None if levels is None else rrb.TextLogRows(filter_by_log_level=levels)
    return rrb.TextLogView(origin=origin, name=name, columns=columns, rows=rows)
