"""Pictures of objects that a map had at some moment: kept views, else cut out of the journal's keyframe images."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from hickory_stream.errors import MapFolderError
from hickory_stream.journal.reader import Journal
from hickory_stream.map_folder.views import read_crop

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from numpy.typing import NDArray

    from hickory_stream.records import View

_MARGIN_PX = 8


def pictures_of(folder: Path, views: Iterable[View]) -> dict[str, NDArray[np.uint8]]:
    """Return (h, w, 3) pictures of views by their names; left out are those of which a map folder has nothing any more.

    The pixels of a view that no object has any more were removed; the image of its keyframe is in the journal, unless
    `journal.keep_images` was off.
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
