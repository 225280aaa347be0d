"""A picture of a map's pose graph from above, and below it residuals and uncertainty over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.graph.trajectories import Ways, ways_of
from hickory_stream.inspection.graph_summary import summary_of, summary_text
from hickory_stream.pictures.drawing import Color, Drawing, Ellipse, Line, Text

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.map_folder.saved_map import SavedMap
    from hickory_stream.records import PoseGraphRecord


BEFORE, AFTER, LOOP, REFUSED = (232, 150, 60), (40, 110, 200), (30, 150, 80), (150, 150, 150)
_INK, _FAINT, _HALO = (60, 64, 72), (222, 225, 230), (176, 200, 236)
_MARGIN_PX, _TITLE_PX, _LEGEND_PX = 40, 30, 24
_STRIP_SHARE = 0.26
_LEAST_TEXT_GAP_PX = 16
_BOW_PX, _BOW_SHARE = 9.0, 0.06


def render_graph(graph: PoseGraphRecord, ways: Ways, size: tuple[int, int]) -> Drawing:
    """Return a drawing of a pose graph; raises `ValueError` below 480 x 360 pixels, or for an empty graph.

    Odometry is orange, the corrected trajectory blue; loops are green with their scores, rejected ones grey and dashed;
    ellipses are two standard deviations.
    """
    width, height = size
    if width < 480 or height < 360:
        raise ValueError(f"a picture of a pose graph has at least 480 x 360 pixels, found {width} x {height}")
    if not graph.nodes:
        raise ValueError("the pose graph is empty")
    drawing = Drawing(width=width, height=height)
    strip_px = round(_STRIP_SHARE * height)
    drawing.add(Text(place_px=(12.0, 20.0), text=_title(graph), color=_INK))
    _draw_legend(drawing)
    _draw_plan(drawing, graph, ways, _TITLE_PX + _LEGEND_PX, height - strip_px)
    _draw_strip(drawing, graph, height - strip_px + 8, height)
    return drawing


def _title(graph: PoseGraphRecord) -> str:
    text = summary_text(summary_of(graph))
    return text[0].upper() + text[1:]


def _draw_legend(drawing: Drawing) -> None:
    x, y = 12.0, float(_TITLE_PX + 12)
    entries: tuple[tuple[str, Color, float], ...] = (
        ("odometry", BEFORE, 0.0),
        ("corrected", AFTER, 0.0),
        ("loop", LOOP, 0.0),
        ("not believed", REFUSED, 4.0),
        ("2 sigma", _HALO, 0.0),
    )
    for name, color, dash_px in entries:
        places = np.array([[x, y - 4], [x + 20, y - 4]])
        drawing.add(Line(places_px=places, color=color, width_px=2.0, dash_px=dash_px))
        drawing.add(Text(place_px=(x + 25, y), text=name, color=_INK))
        x += 44 + 7.2 * len(name)


def _draw_plan(drawing: Drawing, graph: PoseGraphRecord, ways: Ways, top: int, bottom: int) -> None:
    places = {node.submap_id: node.place[:3, 3] for node in graph.nodes}
    everything = np.concatenate([ways.before, ways.after, np.array(list(places.values()))])[:, :2]
    low, high = everything.min(axis=0), everything.max(axis=0)
    span = np.maximum(high - low, 0.5)
    room = np.array([drawing.width - 2 * _MARGIN_PX, bottom - top - _MARGIN_PX])
    scale = float((room / span).min())
    middle_px = np.array([drawing.width / 2, (top + bottom) / 2])

    def at(places_m: NDArray[np.float64]) -> NDArray[np.float64]:
        return (places_m[..., :2] - (low + high) / 2) * (scale, -scale) + middle_px

    for node in graph.nodes:
        drawing.add(
            _ellipse(at(node.place[:3, 3]), 2 * np.sqrt(_axes(node.covariance_xy)[0]) * scale, node.covariance_xy)
        )
    drawing.add(Line(places_px=at(ways.before), color=BEFORE))
    drawing.add(Line(places_px=at(ways.after), color=AFTER, width_px=2.0))
    loops = sorted(graph.loops, key=lambda loop: loop.status == "accepted")
    arcs = [_arc(at(np.array([places[loop.earlier], places[loop.later]]))) for loop in loops]
    for loop, arc in zip(loops, arcs, strict=True):
        is_believed = loop.status == "accepted"
        color = LOOP if is_believed else REFUSED
        drawing.add(Line(places_px=arc, color=color, width_px=2.0, dash_px=0.0 if is_believed else 5.0))
    for node in graph.nodes:
        x, y = (float(value) for value in at(node.place[:3, 3]))
        drawing.add(Ellipse(center_px=(x, y), half_axes_px=(3.0, 3.0), color=AFTER))
    taken: list[NDArray[np.float64]] = []
    # The scores of believed loops first: where two would cover one another, the second is left out.
    for loop, arc in reversed(list(zip(loops, arcs, strict=True))):
        outwards = arc[len(arc) // 2] - (arc[0] + arc[-1]) / 2
        spot = arc[len(arc) // 2] + outwards / np.linalg.norm(outwards) * (20.0, 10.0) + (0.0, 4.0)
        if loop.score is not None and all(np.abs(spot - other).max() > _LEAST_TEXT_GAP_PX for other in taken):
            taken.append(spot)
            color = LOOP if loop.status == "accepted" else REFUSED
            place = (float(spot[0]), float(spot[1]))
            drawing.add(
                Text(place_px=place, text=f"{loop.score:.3g}", color=color, anchor="middle", halo=drawing.background)
            )
    _draw_meters(drawing, scale, bottom)


def _axes(covariance: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the variances (2,) along the axes of an ellipse, the greater first, and the axes as columns."""
    variances, axes = np.linalg.eigh(covariance)
    return np.maximum(variances[::-1], 0.0), axes[:, ::-1]


def _ellipse(center: NDArray[np.float64], half_px: NDArray[np.float64], covariance: NDArray[np.float64]) -> Ellipse:
    along = _axes(covariance)[1][:, 0]
    return Ellipse(
        center_px=(float(center[0]), float(center[1])),
        half_axes_px=(float(half_px[0]), float(half_px[1])),
        color=_HALO,
        # The picture's y goes down.
        turn_deg=float(np.degrees(np.arctan2(-along[1], along[0]))),
        is_filled=False,
    )


def _arc(ends_px: NDArray[np.float64]) -> NDArray[np.float64]:
    # Bent, since a straight line would lie on the trajectory; (N, 2).
    along = ends_px[1] - ends_px[0]
    length = max(float(np.linalg.norm(along)), 1e-6)
    aside = np.array([-along[1], along[0]]) / length * (_BOW_PX + _BOW_SHARE * length)
    share = np.linspace(0, 1, 17)[:, None]
    return ends_px[0] + share * along + 4 * share * (1 - share) * aside


def _draw_meters(drawing: Drawing, scale: float, bottom: int) -> None:
    length_m = next(
        m for m in (50.0, 20.0, 10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.0) if m * scale < 0.25 * drawing.width
    )
    y = float(bottom - 8)
    ends = np.array([[16.0, y], [16.0 + length_m * scale, y]])
    drawing.add(Line(places_px=ends, color=_INK, width_px=2.0))
    drawing.add(Text(place_px=(float(ends[1, 0]) + 8, y + 4), text=f"{length_m:g} m", color=_INK))


def _draw_strip(drawing: Drawing, graph: PoseGraphRecord, top: int, bottom: int) -> None:
    left, right = 64, drawing.width - 16
    first_ns = graph.nodes[0].stamp_ns
    last_ns = max([graph.nodes[-1].stamp_ns, *(edge.stamp_ns for edge in graph.edges)])
    seconds = max((last_ns - first_ns) / 1e9, 1e-9)
    values = [node.sigma_m for node in graph.nodes] + [loop.residual_m for loop in graph.loops]
    # Wrong loops are metres off, believed ones centimetres: only a logarithm shows both.
    low, high = np.log10(max(min(values), 0.001)), np.log10(max([*values, 0.1]))
    high = max(high, low + 1.0)

    def at(stamp_ns: int, value_m: float) -> tuple[float, float]:
        level = (np.log10(max(value_m, 10**low)) - low) / (high - low)
        x = left + (right - left) * (stamp_ns - first_ns) / 1e9 / seconds
        return float(x), float(bottom - 22 - level * (bottom - top - 40))

    drawing.add(
        Text(place_px=(12.0, top + 10.0), text="residuals of loops (dots) and uncertainty of places (line)", color=_INK)
    )
    for power in range(int(np.ceil(low)), int(np.floor(high)) + 1):
        y = at(first_ns, 10.0**power)[1]
        drawing.add(Line(places_px=np.array([[left, y], [right, y]]), color=_FAINT, width_px=1.0))
        drawing.add(Text(place_px=(left - 6.0, y + 4), text=f"{10.0**power:g} m", color=_INK, anchor="end"))
    for share in (0.0, 0.5, 1.0):
        x = left + share * (right - left)
        anchor = ("start", "middle", "end")[round(2 * share)]
        drawing.add(Text(place_px=(x, bottom - 6.0), text=f"{share * seconds:.0f} s", color=_INK, anchor=anchor))
    line = np.array([at(node.stamp_ns, node.sigma_m) for node in graph.nodes])
    drawing.add(Line(places_px=line, color=_HALO, width_px=2.0))
    # Loops that their search refused were never compared with a solution.
    for loop in (loop for loop in graph.loops if loop.residual_m > 0):
        color = LOOP if loop.status == "accepted" else REFUSED
        drawing.add(Ellipse(center_px=at(loop.stamp_ns, loop.residual_m), half_axes_px=(4.0, 4.0), color=color))


def recorded_ways(saved: SavedMap) -> Ways | None:
    """Return a map's trajectories from its journal, None without a graph; without a journal only submap positions."""
    from hickory_stream.journal.format import JOURNAL
    from hickory_stream.journal.reader import Journal

    graph = saved.snapshot.graph
    if graph is None or not graph.nodes:
        return None
    stamps_ns = [node.stamp_ns for node in graph.nodes]
    places = [node.uncorrected[:3, 3] for node in graph.nodes]
    if (saved.folder / JOURNAL).exists():
        with Journal(saved.folder) as journal:
            frames = [frame for i in range(len(journal)) for frame in journal.step(i).frames]
        known = [frame for frame in frames if frame.stamp_ns <= saved.snapshot.stamp_ns]
        if known:
            stamps_ns = [frame.stamp_ns for frame in known]
            places = [frame.world_from_camera[:3, 3] for frame in known]
    return ways_of(graph, stamps_ns, np.array(places))
