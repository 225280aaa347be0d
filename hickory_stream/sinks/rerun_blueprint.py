"""The default arrangement of the viewer: all four layers, the camera, the plots and the decisions on one screen."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import rerun.blueprint as rrb

from hickory_stream.sinks.rerun_frame import CAMERA, TRAJECTORY
from hickory_stream.sinks.rerun_items import KEYFRAME
from hickory_stream.sinks.rerun_numbers import DECISIONS, PLOTS
from hickory_stream.sinks.rerun_objects import FITTED_LAYER, INFLATED_LAYER, MESH_LAYER, POINTS_LAYER
from hickory_stream.sinks.rerun_space import FLOOR
from hickory_stream.sinks.rerun_views import SHEET_PX, VIEWS

if TYPE_CHECKING:
    from numpy.typing import NDArray

_BACKGROUND = (22, 25, 31)
# From above and a corner of the room: steep enough that objects do not hide one another.
_EYE_DIRECTION = np.array([-0.62, -0.85, 0.95]) / np.linalg.norm([-0.62, -0.85, 0.95])


def default_blueprint(bounds: tuple[NDArray[np.float64], NDArray[np.float64]] | None) -> rrb.Blueprint:
    """Return the arrangement; with the map's `bounds` (lowest, highest corner) the eyes look at all of it."""
    eye = None if bounds is None else _eye(*bounds)
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                _map_view("Layers 1 and 2: points, boxes, meshes", [POINTS_LAYER, MESH_LAYER], eye, is_main=True),
                rrb.Horizontal(
                    _map_view("Layer 3: superquadrics", [FITTED_LAYER], eye),
                    _map_view("Layer 4: inflated, over the meshes", [INFLATED_LAYER, MESH_LAYER], eye),
                ),
                row_shares=[5, 3],
            ),
            rrb.Vertical(
                rrb.Tabs(
                    _camera_view("Camera", ["color", "masks", "boxes"]),
                    _camera_view("Rejected masks", ["color", "rejected/masks", "rejected/boxes"]),
                    _camera_view("Features", ["features"]),
                    _camera_view("Depth", ["depth"]),
                ),
                rrb.Tabs(
                    rrb.Spatial2DView(
                        origin=VIEWS,
                        name="Best views",
                        background=_BACKGROUND,
                        visual_bounds=rrb.VisualBounds2D(x_range=(-16, SHEET_PX[0]), y_range=(-16, SHEET_PX[1])),
                    ),
                    _plot("Score S", "score"),
                    _plot("S: variance", "variance"),
                    _plot("S: area", "area"),
                    _plot("S: depth", "depth"),
                    _plot("Stage times [s]", "time"),
                    _plot("Objects by phase", "objects"),
                    _plot("Queues", "queue"),
                ),
                rrb.TextLogView(
                    origin=DECISIONS,
                    name="Decisions",
                    columns=rrb.TextLogColumns(timeline_columns=[KEYFRAME], text_log_columns=["loglevel", "body"]),
                ),
                row_shares=[4, 4, 3],
            ),
            column_shares=[5, 3],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=KEYFRAME, play_state="following"),
        auto_views=False,
    )


def _map_view(
    name: str, layers: list[str], eye: rrb.EyeControls3D | None, *, is_main: bool = False
) -> rrb.Spatial3DView:
    extras = [f"+ {FLOOR}/**"]
    if is_main:
        # The images are left out: they would hang in the room at the camera and hide what is behind them.
        extras += [f"+ {TRAJECTORY}/**", f"+ {CAMERA}"]
    return rrb.Spatial3DView(
        origin="world",
        name=name,
        contents=[f"+ {layer}/**" for layer in layers] + extras,
        background=_BACKGROUND,
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=eye,
    )


def _camera_view(name: str, images: list[str]) -> rrb.Spatial2DView:
    return rrb.Spatial2DView(
        origin=CAMERA, name=name, contents=[f"+ {CAMERA}/{image}" for image in images], background=_BACKGROUND
    )


def _plot(name: str, group: str) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=f"{PLOTS}/{group}", name=name, plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop)
    )


def _eye(low: NDArray[np.float64], high: NDArray[np.float64]) -> rrb.EyeControls3D:
    middle = (low + high) / 2
    distance = 0.95 * float(np.linalg.norm(high - low)) + 0.5
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=middle + distance * _EYE_DIRECTION,
        look_target=middle,
        eye_up=(0.0, 0.0, 1.0),
    )
