"""Contact sheet of the best views, a thumbnail per object in the order of appearance.

The number is drawn into the thumbnail: a label of the viewer keeps its size and would cover the next row.
"""

from __future__ import annotations

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from hickory_stream.geometry.display import color_of_id, readable_on_dark
from hickory_stream.records import FrameReport, TrackedObject
from hickory_stream.sinks.rerun.frame import encoded_jpeg
from hickory_stream.sinks.rerun.items import LogItem, Span, Weight, clear_item

VIEWS = "views"
_TILE_PX, _STRIP_PX, _GAP_PX = 128, 30, 12
_WIDTH_PX, _HEIGHT_PX = _TILE_PX + _GAP_PX, _TILE_PX + _STRIP_PX + _GAP_PX
_COLUMNS, _FIRST_ROWS = 7, 3
_PADDING = 22


def sheet_px(num_tiles: int) -> tuple[int, int]:
    """Return (width, height) of a sheet with this number of thumbnails."""
    rows = max(-(-num_tiles // _COLUMNS), _FIRST_ROWS)
    return _COLUMNS * _WIDTH_PX, rows * _HEIGHT_PX


class BestViews:
    """Assigns a tile to each object; new objects reuse the tiles of removed ones."""

    def __init__(self, jpeg_quality: int) -> None:
        self._jpeg_quality = jpeg_quality
        self._tiles: dict[int, int] = {}

    @property
    def num_tiles(self) -> int:
        """Number of thumbnails."""
        return len(self._tiles)

    def items(self, report: FrameReport) -> list[LogItem]:
        """Return the thumbnails of objects whose best view is this frame, and clear those of removed objects."""
        if report.snapshot is None:
            return []
        present = {o.id for o in report.snapshot.objects}
        gone = sorted(self._tiles.keys() - present)
        for object_id in gone:
            del self._tiles[object_id]
        items = [clear_item(f"{VIEWS}/{i}") for i in gone]
        seen = [o for o in report.snapshot.objects if o.best_view and o.best_view.frame_index == report.index]
        rgb = _rgb_of(report) if seen else None
        return items if rgb is None else items + [item for o in seen for item in self._tile_items(o, rgb)]

    def finish(self) -> list[LogItem]:
        """Return all thumbnails without gaps, by object id."""
        moved = {object_id: i for i, object_id in enumerate(sorted(self._tiles)) if self._tiles[object_id] != i}
        self._tiles |= moved
        return [self._place_item(object_id) for object_id in moved]

    def _tile_items(self, seen: TrackedObject, rgb: NDArray[np.uint8]) -> list[LogItem]:
        assert seen.best_view is not None
        x0, y0, x1, y1 = seen.best_view.box_px
        taken = set(self._tiles.values())
        self._tiles.setdefault(seen.id, next(i for i in range(len(taken) + 1) if i not in taken))
        image = encoded_jpeg(_tile(rgb[y0:y1, x0:x1], seen.id), self._jpeg_quality)
        edge = rr.Boxes2D(mins=[(0, 0)], sizes=[(_TILE_PX, _TILE_PX + _STRIP_PX)], colors=color_of_id(seen.id))
        path = f"{VIEWS}/{seen.id}"
        return [
            self._place_item(seen.id),
            LogItem(path=f"{path}/image", archetypes=(image,), weight=Weight.HEAVY, span=Span.LASTING),
            LogItem(path=f"{path}/edge", archetypes=(edge,), span=Span.LASTING),
        ]

    def _place_item(self, object_id: int) -> LogItem:
        row, column = divmod(self._tiles[object_id], _COLUMNS)
        corner = (column * _WIDTH_PX + _GAP_PX / 2, row * _HEIGHT_PX + _GAP_PX / 2, 0.0)
        return LogItem(path=f"{VIEWS}/{object_id}", archetypes=(rr.Transform3D(translation=corner),), span=Span.LASTING)


def _rgb_of(report: FrameReport) -> NDArray[np.uint8] | None:
    if report.frame is not None:
        return report.frame.rgb
    if report.color_bytes is None:
        return None
    bgr = cv2.imdecode(np.frombuffer(report.color_bytes, np.uint8), cv2.IMREAD_COLOR)
    if bgr is None or bgr.shape[:2] != (report.camera.height, report.camera.width):
        return None
    return np.asarray(bgr[..., ::-1], dtype=np.uint8)


def _tile(rgb: NDArray[np.uint8], object_id: int) -> NDArray[np.uint8]:
    # Images of one entity keep their size: the viewer takes them for a video and complains otherwise.
    height, width = rgb.shape[:2]
    scale = _TILE_PX / max(height, width)
    size = (max(round(width * scale), 1), max(round(height * scale), 1))
    tile = np.full((_TILE_PX + _STRIP_PX, _TILE_PX, 3), _PADDING, dtype=np.uint8)
    top, left = (_TILE_PX - size[1]) // 2, (_TILE_PX - size[0]) // 2
    tile[top : top + size[1], left : left + size[0]] = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
    text, font, thickness = str(object_id), cv2.FONT_HERSHEY_SIMPLEX, 2
    text_size, _ = cv2.getTextSize(text, font, 0.8, thickness)
    place = ((_TILE_PX - text_size[0]) // 2, _TILE_PX + (_STRIP_PX + text_size[1]) // 2)
    color = readable_on_dark(color_of_id(object_id))
    cv2.putText(tile, text, place, font, 0.8, color, thickness, cv2.LINE_AA)
    return tile
