"""The pose graph on the timeline: trajectory before and after, submaps, loops, residuals and uncertainty."""

from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from hickory_stream.geometry.rigid import compose, invert
from hickory_stream.graph.trajectories import ways_of
from hickory_stream.records import EdgeStatus, FrameReport, GraphEdge, PoseGraphRecord
from hickory_stream.sinks.rerun.items import LogItem, Span
from hickory_stream.sinks.rerun.labels import AFTER, BEFORE, DOUBTED, LOOP
from hickory_stream.sinks.rerun.plots import PLOTS

GRAPH = "world/graph"
_NODE = (176, 200, 236)
_WIDTH, _NODE_PX = -1.5, -4.0
# Lines have no dashes in Rerun: a loop that is not believed is drawn as so many pieces with gaps.
_DASHES = 12
_MOST_SCORES = 6
"""More loops than that show their scores where one points at them: their labels would hide the objects."""
_STATUSES: tuple[EdgeStatus, ...] = ("accepted", "rejected", "withdrawn")


class GraphLines:
    """Logs the pose graph when it changes, with the camera's position at each keyframe."""

    def __init__(self) -> None:
        self._stamps_ns: list[int] = []
        self._places: list[NDArray[np.float64]] = []
        self._logged: PoseGraphRecord | None = None

    def items(self, report: FrameReport) -> list[LogItem]:
        """Return the items of a keyframe; nothing while the graph is missing or unchanged."""
        snapshot = report.snapshot
        if snapshot is None or not snapshot.submaps:
            return []
        # The report's pose is corrected as the open submap is.
        raw = compose(invert(snapshot.submaps[-1].world_from_submap), report.world_from_camera)
        self._stamps_ns.append(report.stamp_ns)
        self._places.append(raw[:3, 3])
        graph = snapshot.graph
        if graph is None or not graph.nodes or graph is self._logged:
            return []
        items = [] if self._logged is not None else _curves()
        self._logged = graph
        ways = ways_of(graph, self._stamps_ns, np.array(self._places))
        lines = [
            _item("before", rr.LineStrips3D([ways.before], colors=BEFORE, radii=_WIDTH)),
            _item("after", rr.LineStrips3D([ways.after], colors=AFTER, radii=_WIDTH)),
            _item("submaps", _nodes(graph)),
            *(_item(f"loops/{status}", _loops(graph, status)) for status in _STATUSES),
        ]
        return items + lines + _numbers(graph)


def _item(name: str, archetype: Any) -> LogItem:
    return LogItem(path=f"{GRAPH}/{name}", archetypes=(archetype,), span=Span.LASTING)


def _nodes(graph: PoseGraphRecord) -> rr.Points3D:
    return rr.Points3D(
        [node.place[:3, 3] for node in graph.nodes],
        radii=_NODE_PX,
        colors=_NODE,
        labels=[f"submap {node.submap_id}: {node.sigma_m:.2f} m" for node in graph.nodes],
        show_labels=False,
    )


def _loops(graph: PoseGraphRecord, status: EdgeStatus) -> rr.LineStrips3D:
    places = {node.submap_id: node.place[:3, 3] for node in graph.nodes}
    strips: list[NDArray[np.float64]] = []
    labels: list[str] = []
    for loop in graph.loops:
        if loop.status == status:
            ends = np.array([places[loop.earlier], places[loop.later]])
            pieces = [ends] if status == "accepted" else _dashes(ends)
            strips += pieces
            labels += [_label(loop), *[""] * (len(pieces) - 1)]
    color = LOOP if status == "accepted" else DOUBTED
    is_told = status == "accepted" and len(labels) <= _MOST_SCORES
    return rr.LineStrips3D(strips, colors=color, radii=_WIDTH, labels=labels, show_labels=is_told)


def _dashes(ends: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    marks = np.linspace(0, 1, 2 * _DASHES)[:, None]
    return list((ends[0] + marks * (ends[1] - ends[0])).reshape(_DASHES, 2, 3))


def _label(loop: GraphEdge) -> str:
    score = "" if loop.score is None else f"{loop.score:.3g}"
    return f"{score} {loop.reason}".strip()


def _numbers(graph: PoseGraphRecord) -> list[LogItem]:
    # Residuals of accepted loops, uncertainty, and displacement of moved submaps.
    believed = [loop for loop in graph.loops if loop.status == "accepted"]
    moves = [float(np.linalg.norm(node.place[:3, 3] - node.uncorrected[:3, 3])) for node in graph.nodes]
    values = {
        "uncertainty_m": graph.nodes[-1].sigma_m,
        "moved_m": moves[-1],
        "loops": float(len(believed)),
        "not_believed": float(len(graph.loops) - len(believed)),
    }
    if believed:
        values["residual_m"] = max(loop.residual_m for loop in believed)
        values["residual_rad"] = max(loop.residual_rad for loop in believed)
    return [LogItem(path=f"{PLOTS}/graph/{name}", archetypes=(rr.Scalars(value),)) for name, value in values.items()]


def _curves() -> list[LogItem]:
    names = {
        "uncertainty_m": "uncertainty of the open submap [m]",
        "moved_m": "the open submap moved [m]",
        "loops": "loops that are believed",
        "not_believed": "loops that are not",
        "residual_m": "largest residual of a loop [m]",
        "residual_rad": "largest residual of a loop [rad]",
    }
    return [
        LogItem(path=f"{PLOTS}/graph/{name}", archetypes=(rr.SeriesLines(names=text, widths=1.5),), span=Span.STATIC)
        for name, text in names.items()
    ]
