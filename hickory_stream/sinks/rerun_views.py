"""The best view of every object as a thumbnail; together they make a contact sheet, in the order of appearance.

`SHEET_PX` (width, height) is what is shown at first sight; further rows follow below.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
import rerun as rr

from hickory_stream.geometry.palette import color_of_id
from hickory_stream.sinks.rerun_frame import encoded_jpeg
from hickory_stream.sinks.rerun_items import LogItem, Span, Weight

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.records import Frame, FrameReport, TrackedObject

VIEWS = "views"
_TILE_PX, _GAP_PX, _COLUMNS, _ROWS = 128, 24, 8, 3
SHEET_PX = (_COLUMNS * (_TILE_PX + _GAP_PX), _ROWS * (_TILE_PX + _GAP_PX))
_PADDING = 22


class BestViews:
    """Gives each object a tile; the tile of an object that is gone goes to the next one that comes."""

    def __init__(self, jpeg_quality: int) -> None:
        self._jpeg_quality = jpeg_quality
        self._tiles: dict[int, int] = {}

    def items(self, report: FrameReport) -> list[LogItem]:
        """Return the thumbnails of the objects whose best view is in this very frame, and clear those that are gone."""
        if report.snapshot is None or report.frame is None:
            return []
        present = {o.id for o in report.snapshot.objects}
        gone = sorted(self._tiles.keys() - present)
        for object_id in gone:
            del self._tiles[object_id]
        items = [
            LogItem(path=f"{VIEWS}/{i}", archetypes=(rr.Clear(recursive=True),), span=Span.LASTING, is_clear=True)
            for i in gone
        ]
        for seen in report.snapshot.objects:
            if seen.best_view is not None and seen.best_view.frame_index == report.index:
                items += self._tile_items(seen, report.frame)
        return items

    def _tile_items(self, seen: TrackedObject, frame: Frame) -> list[LogItem]:
        assert seen.best_view is not None
        x0, y0, x1, y1 = seen.best_view.box_px
        corner = self._corner_px(seen.id)
        place = rr.Transform3D(translation=(*corner, 0.0))
        image = encoded_jpeg(_fitted(frame.rgb[y0:y1, x0:x1]), self._jpeg_quality)
        # Not below the image: the viewer moves the box with its parent, but not the box's label.
        label = rr.Boxes2D(
            mins=[corner],
            sizes=[(_TILE_PX, _TILE_PX)],
            colors=color_of_id(seen.id),
            labels=[str(seen.id)],
            show_labels=True,
        )
        path = f"{VIEWS}/{seen.id}"
        return [
            LogItem(path=f"{path}/image", archetypes=(place, image), weight=Weight.HEAVY, span=Span.LASTING),
            LogItem(path=f"{path}/label", archetypes=(label,), span=Span.LASTING),
        ]

    def _corner_px(self, object_id: int) -> tuple[int, int]:
        taken = set(self._tiles.values())
        free = next(i for i in range(len(taken) + 1) if i not in taken)
        tile = self._tiles.setdefault(object_id, free)
        row, column = divmod(tile, _COLUMNS)
        return column * (_TILE_PX + _GAP_PX), row * (_TILE_PX + _GAP_PX)


def _fitted(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return (h, w, 3) colour scaled into the middle of a square tile.

    Images of one entity must keep their size: the viewer takes them for a video and complains otherwise.
    """
    height, width = rgb.shape[:2]
    scale = _TILE_PX / max(height, width)
    size = (max(round(width * scale), 1), max(round(height * scale), 1))
    tile = np.full((_TILE_PX, _TILE_PX, 3), _PADDING, dtype=np.uint8)
    top, left = (_TILE_PX - size[1]) // 2, (_TILE_PX - size[0]) // 2
    tile[top : top + size[1], left : left + size[0]] = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
    return tile
