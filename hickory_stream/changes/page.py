"""HTML page of the changes between two maps: a plan as SVG, and every object with pictures and evidence."""

from __future__ import annotations

import html
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.base.html_page import page, picture
from hickory_stream.changes.records import MapChanges, ObjectChange, Verdict, count_text, evidence_text, sentence
from hickory_stream.map_folder.views import read_crop
from hickory_stream.mapping.entities.rigid_motion import moved_object

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from hickory_stream.map_folder.saved_map import SavedMap
    from hickory_stream.records import TrackedObject


_WIDTH_PX = 900
_MARGIN_M = 0.4
_SIGNS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])


@dataclass(frozen=True, kw_only=True, slots=True)
class Footprint:
    """An object on the plan; the later map's are dashed."""

    item: TrackedObject
    color: str
    is_dashed: bool


def plan_svg(
    footprints: Sequence[Footprint],
    moves: Sequence[tuple[TrackedObject, TrackedObject, str]],
    meanings: Mapping[str, str],
    caption: str,
) -> str:
    """Return the plan from above and its legend, "" without an object; lines join the centres of `moves`.

    `meanings` are colours and what they stand for; those on the plan are in the legend, before `caption`.
    """
    from hickory_stream.pictures.labels import flat_labels

    if not footprints:
        return ""
    corners = np.concatenate([one.item.box.corners_world()[:, :2] for one in footprints])
    low, high = corners.min(axis=0) - _MARGIN_M, corners.max(axis=0) + _MARGIN_M
    scale = _WIDTH_PX / float(high[0] - low[0])

    def at(point: NDArray[np.float64]) -> tuple[float, float]:
        return float((point[0] - low[0]) * scale), float((high[1] - point[1]) * scale)

    height = float(high[1] - low[1]) * scale
    drawn, outlines = [], {}
    for i, one in enumerate(footprints):
        box, color = one.item.box, one.color
        outline = box.center[:2] + (box.half_extents_m[:2] * _SIGNS) @ box.world_from_box[:2, :2].T
        outlines[i] = [np.array([at(corner) for corner in outline])]
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in outlines[i][0])
        dash = ' stroke-dasharray="5 4"' if one.is_dashed else ""
        drawn.append(f'<polygon points="{points}" fill="{color}" fill-opacity=".25" stroke="{color}"{dash}/>')
    for a, b, color in moves:
        (x0, y0), (x1, y1) = at(a.box.center), at(b.box.center)
        drawn.append(
            f'<line x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}" stroke="{color}" stroke-width="2"/>'
        )
    texts = {i: str(one.item.id) for i, one in enumerate(footprints)}
    for label in flat_labels(outlines, (_WIDTH_PX, round(height)), texts):
        x0, y0, x1, y1 = label.box_px
        color = footprints[label.object_id].color
        near = f'x2="{(x0 + x1) / 2}" y2="{(y0 + y1) / 2}"'
        drawn.append(f'<line x1="{label.place_px[0]}" y1="{label.place_px[1]}" {near} stroke="{color}"/>')
        drawn.append(f'<rect x="{x0}" y="{y0}" width="{x1 - x0}" height="{y1 - y0}" rx="2" fill="{color}" {_DARKER}/>')
        middle = f'x="{(x0 + x1) / 2}" y="{y1 - 5}" text-anchor="middle" font-size="12" fill="#fff"'
        drawn.append(f"<text {middle}>{label.text}</text>")
    drawn.append(f'<path d="M12 {height - 18:.0f}v6h{scale:.1f}v-6" fill="none" stroke="#667"/>')
    drawn.append(f'<text x="{18 + scale:.1f}" y="{height - 10:.0f}" font-size="12" fill="#667">1 m</text>')
    on_plan = {one.color for one in footprints}
    legend = "".join(
        f'<span><i style="background:{color}"></i> {html.escape(text)}</span>'
        for color, text in meanings.items()
        if color in on_plan
    )
    drawing = f'<svg viewBox="0 0 {_WIDTH_PX} {height:.0f}">{"".join(drawn)}</svg>'
    return f'{drawing}<p class="legend soft">{legend}<span>{html.escape(caption)}</span></p>'


COLORS = {
    Verdict.STILL_THERE: "#9aa3b5",
    Verdict.MOVED: "#1c62c4",
    Verdict.GONE: "#c0392b",
    Verdict.NEW: "#188c54",
    Verdict.EXCHANGED: "#8e44ad",
    Verdict.NOT_SEEN_AGAIN: "#c98a1b",
    Verdict.NOT_SEEN_BEFORE: "#c98a1b",
}
_PICTURE_PX = 150
# White text is to be read on each of the colours.
_DARKER = 'style="filter:brightness(.72)"'
STYLE = """
svg { background: var(--card); border: 1px solid var(--line); width: 100%; height: auto; }
.card { display: flex; gap: .9rem; background: var(--card); border: 1px solid var(--line); padding: .6rem;
  margin: .5rem 0; }
.card img { width: 120px; height: 120px; object-fit: contain; background: var(--back); }
.bar { display: flex; height: 9px; width: 260px; margin-top: .4rem; } .bar i { display: block; height: 9px; }
.legend { display: flex; gap: .2rem 1.4rem; flex-wrap: wrap; }
.legend i { display: inline-block; width: .8rem; height: .8rem; }
.tag { color: #fff; padding: 0 .45rem; border-radius: 3px; }
"""


def changes_page(first: SavedMap, second: SavedMap, found: MapChanges) -> str:
    """Return the page as one HTML file; raises `MapFolderError` for a view."""
    a = {item.id: item for item in first.snapshot.objects}
    b = {item.id: item for item in second.snapshot.objects}
    placed_b = {i: moved_object(item, found.a_from_b) for i, item in b.items()}
    names = [html.escape(str(saved.folder)) for saved in (first, second)]
    parts = [
        f"<h1>From {names[0]} to {names[1]}</h1>",
        f"<p>{html.escape(count_text(found))}</p>",
        _plan(found, a, placed_b),
    ]
    for verdict in (*(one for one in Verdict if one is not Verdict.STILL_THERE), Verdict.STILL_THERE):
        rows = [change for change in found.changes if change.verdict is verdict]
        if rows:
            parts.append(f"<h2>{verdict}: {len(rows)}</h2>")
            parts += [_card(change, first, second, a, b) for change in rows]
    return page("What changed", "\n".join(parts), STYLE)


def _card(
    change: ObjectChange,
    first: SavedMap,
    second: SavedMap,
    a: Mapping[int, TrackedObject],
    b: Mapping[int, TrackedObject],
) -> str:
    pictures = ""
    if change.id_a is not None:
        pictures += _picture(first, a[change.id_a])
    if change.id_b is not None:
        pictures += _picture(second, b[change.id_b])
    evidence = change.evidence
    bar = "".join(
        f'<i style="width:{100 * share:.1f}%;background:{color}"></i>'
        for share, color in (
            (evidence.free, "#6db6e8"),
            (evidence.objects, "#b5744a"),
            (evidence.structure, "#7a6a5a"),
            (evidence.unseen, "#cfd3db"),
        )
    )
    tag = f'<span class="tag" style="background:{COLORS[change.verdict]}">{change.verdict}</span>'
    return (
        f'<div class="card">{pictures}<div>{tag} <b>{html.escape(sentence(change))}</b>'
        f'<div class="soft">{html.escape(evidence_text(change))}</div><div class="bar">{bar}</div></div></div>'
    )


def _picture(saved: SavedMap, item: TrackedObject) -> str:
    if item.best_view is None:
        return ""
    return picture(read_crop(saved.views, item.best_view.name).rgb, f"#{item.id}", _PICTURE_PX)


def _plan(found: MapChanges, a: Mapping[int, TrackedObject], b: Mapping[int, TrackedObject]) -> str:
    footprints, moves = [], []
    for change in reversed(found.changes):
        color = COLORS[change.verdict]
        one, other = a.get(change.id_a or -1), b.get(change.id_b or -1)
        if one is not None:
            footprints.append(Footprint(item=one, color=color, is_dashed=False))
        # What is still there is drawn once.
        if other is not None and not (change.verdict is Verdict.STILL_THERE and one is not None):
            footprints.append(Footprint(item=other, color=color, is_dashed=True))
        if change.verdict is Verdict.MOVED and one is not None and other is not None:
            moves.append((one, other, color))
    meanings = {color: " or ".join(v for v in Verdict if COLORS[v] == color) for color in COLORS.values()}
    return plan_svg(footprints, moves, meanings, "solid: the first map; dashed: the second; a line: the way moved")
