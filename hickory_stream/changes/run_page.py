"""HTML page of the changes between two moments of a run: a plan, and every change with its pictures."""

from __future__ import annotations

import html
from typing import TYPE_CHECKING

import cv2
import numpy as np

from hickory_stream.base.html_page import page, picture
from hickory_stream.changes.page import COLORS, STYLE, Footprint, plan_svg
from hickory_stream.changes.records import Verdict
from hickory_stream.errors import MapFolderError
from hickory_stream.journal.reader import Journal
from hickory_stream.map_folder.views import read_crop

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from hickory_stream.map_folder.history.time_travel import Change
    from hickory_stream.records import MapSnapshot, TrackedObject, View


_MARGIN_PX = 8


def pictures_of(folder: Path, views: Iterable[View]) -> dict[str, NDArray[np.uint8]]:
    """Return (h, w, 3) pictures of views by name; views without a picture in the map folder are left out.

    The pixels of unused views were removed; the journal has the keyframe images, unless `journal.keep_images` was off.
    """
    found: dict[str, NDArray[np.uint8]] = {}
    removed = []
    for view in views:
        try:
            found[view.name] = read_crop(folder / "views", view.name).rgb
        except MapFolderError:
            removed.append(view)
    if removed:
        try:
            with Journal(folder) as journal:
                cut = {view.name: _cut_out(journal, view) for view in removed}
        except MapFolderError:
            return found
        found |= {name: rgb for name, rgb in cut.items() if rgb is not None}
    return found


def _cut_out(journal: Journal, view: View) -> NDArray[np.uint8] | None:
    steps = np.flatnonzero(journal.stamps_ns == view.stamp_ns)
    color = journal.color(int(steps[0])) if len(steps) else None
    image = None if color is None else cv2.imdecode(np.frombuffer(color, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        return None
    x0, y0, x1, y1 = view.box_px
    part = image[max(0, y0 - _MARGIN_PX) : y1 + _MARGIN_PX, max(0, x0 - _MARGIN_PX) : x1 + _MARGIN_PX]
    return np.ascontiguousarray(part[..., ::-1]) if part.size else None


_PICTURE_PX = 150
_OTHER = "#5d6b82"
_SAID = {"gone": Verdict.GONE, "new": Verdict.NEW, "moved": Verdict.MOVED}


def run_page(title: str, before: MapSnapshot, after: MapSnapshot, listed: Sequence[Change], folder: Path) -> str:
    """Return the page as one HTML file; the map's `folder` has the pictures."""
    a, b = ({item.id: item for item in each.objects} for each in (before, after))
    parts = [f"<h1>{html.escape(title)}</h1>", _plan(a, b, listed)]
    shown = [item for one in listed for item in _both(one, a, b)]
    pictures = pictures_of(folder, [item.best_view for item in shown if item.best_view is not None])
    kinds = sorted({one.kind for one in listed}, key=lambda kind: (kind not in _SAID, kind))
    for kind in kinds:
        rows = [one for one in listed if one.kind == kind]
        parts.append(f"<h2>{html.escape(kind)}: {len(rows)}</h2>")
        parts += [_card(one, _both(one, a, b), pictures) for one in rows]
    if not listed:
        parts.append("<p>Nothing has changed.</p>")
    return page("What changed", "\n".join(parts), STYLE)


def _plan(a: Mapping[int, TrackedObject], b: Mapping[int, TrackedObject], listed: Sequence[Change]) -> str:
    # Unchanged objects are grey, removed ones solid, added ones dashed.
    changed = {one.object_id for one in listed if one.kind in _SAID} | {one.was for one in listed}
    still = COLORS[Verdict.STILL_THERE]
    footprints = [Footprint(item=item, color=still, is_dashed=False) for item in b.values() if item.id not in changed]
    moves = []
    for one in listed:
        if one.kind not in _SAID:
            continue
        color = COLORS[_SAID[one.kind]]
        was, is_now = a.get(one.object_id if one.was is None else one.was), b.get(one.object_id)
        if was is not None and one.kind != "new":
            footprints.append(Footprint(item=was, color=color, is_dashed=False))
        if is_now is not None and one.kind != "gone":
            footprints.append(Footprint(item=is_now, color=color, is_dashed=True))
        if was is not None and is_now is not None and one.kind == "moved":
            moves.append((was, is_now, color))
    meanings = {still: "neither gone, new nor moved", **{COLORS[verdict]: kind for kind, verdict in _SAID.items()}}
    caption = "solid: at the first moment; dashed: at the second; a line: the way moved"
    return plan_svg(footprints, moves, meanings, caption)


def _both(one: Change, a: Mapping[int, TrackedObject], b: Mapping[int, TrackedObject]) -> list[TrackedObject]:
    was = a.get(one.object_id if one.was is None else one.was)
    return [item for item in (was, b.get(one.object_id)) if item is not None]


def _card(one: Change, items: Sequence[TrackedObject], pictures: Mapping[str, NDArray[np.uint8]]) -> str:
    views = {item.best_view.name: item.id for item in items if item.best_view is not None}
    shown = "".join(picture(pictures[name], f"#{i}", _PICTURE_PX) for name, i in views.items() if name in pictures)
    color = COLORS[_SAID[one.kind]] if one.kind in _SAID else _OTHER
    tag = f'<span class="tag" style="background:{color}">{html.escape(one.kind)}</span>'
    sure = "" if one.probability is None else f", probability {one.probability:.2f}"
    return (
        f'<div class="card">{shown}<div>{tag} <b>#{one.object_id}{sure}</b>'
        f'<div class="soft">{html.escape(one.text)}</div></div></div>'
    )
