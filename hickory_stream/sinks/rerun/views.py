"""Contact sheet of the best views, a thumbnail with id and phase per object in the order of appearance.

The caption is a picture: a label of the viewer keeps its size and would cover the next row.
"""

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
        self._captions: dict[int, str] = {}

    @property
    def num_tiles(self) -> int:
        """Number of thumbnails."""
        return len(self._tiles)

    def items(self, report: FrameReport) -> list[LogItem]:
        """Return new best views and captions that changed, and clear those of removed objects."""
        if report.snapshot is None:
            return []
        present = {o.id for o in report.snapshot.objects}
        gone = sorted(self._tiles.keys() - present)
        for object_id in gone:
            del self._tiles[object_id], self._captions[object_id]
        items = [clear_item(f"{VIEWS}/{i}") for i in gone]
        seen = [o for o in report.snapshot.objects if o.best_view and o.best_view.frame_index == report.index]
        rgb = _rgb_of(report) if seen else None
        if rgb is not None:
            items += [item for o in seen for item in self._tile_items(o, rgb)]
        for shown in report.snapshot.objects:
            text = f"#{shown.id} {shown.phase}"
            if shown.id in self._tiles and self._captions.get(shown.id) != text:
                self._captions[shown.id] = text
                items.append(self._caption_item(shown.id, text))
        return items

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
        image = encoded_jpeg(_tile(rgb[y0:y1, x0:x1]), self._jpeg_quality)
        edge = rr.Boxes2D(mins=[(0, 0)], sizes=[(_TILE_PX, _TILE_PX + _STRIP_PX)], colors=color_of_id(seen.id))
        path = f"{VIEWS}/{seen.id}"
        return [
            self._place_item(seen.id),
            LogItem(path=f"{path}/image", archetypes=(image,), weight=Weight.HEAVY, span=Span.LASTING),
            LogItem(path=f"{path}/edge", archetypes=(edge,), span=Span.LASTING),
        ]

    def _caption_item(self, object_id: int, text: str) -> LogItem:
        image = np.full((_STRIP_PX, _TILE_PX, 3), _PADDING, dtype=np.uint8)
        (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.6, 1)
        place = ((_TILE_PX - width) // 2, (_STRIP_PX + height) // 2)
        color = readable_on_dark(color_of_id(object_id))
        cv2.putText(image, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.6, color, 1, cv2.LINE_AA)
        below = rr.Transform3D(translation=(0.0, _TILE_PX, 0.0))
        path = f"{VIEWS}/{object_id}/caption"
        return LogItem(path=path, archetypes=(below, encoded_jpeg(image, self._jpeg_quality)), span=Span.LASTING)

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


def _tile(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    # Images of one entity keep their size: the viewer takes them for a video and complains otherwise.
    height, width = rgb.shape[:2]
    scale = _TILE_PX / max(height, width)
    size = (max(round(width * scale), 1), max(round(height * scale), 1))
    tile = np.full((_TILE_PX, _TILE_PX, 3), _PADDING, dtype=np.uint8)
    top, left = (_TILE_PX - size[1]) // 2, (_TILE_PX - size[0]) // 2
    tile[top : top + size[1], left : left + size[0]] = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
    return tile
