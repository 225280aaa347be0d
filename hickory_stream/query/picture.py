"""A picture of an answer: the map with the answers in colour, all others gray, and their best views."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import cv2
import numpy as np

from hickory_stream.map_folder.views import read_crop
from hickory_stream.pictures.render import render_map
from hickory_stream.records import kind_text

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.map_folder.saved_map import SavedMap
    from hickory_stream.query.answers import Answer, Answers
    from hickory_stream.records import TrackedObject

_SIZE = (1600, 800)
_MOST_VIEWS = 6
_TILE_PX, _CAPTION_PX, _MARGIN_PX = 250, 26, 10
_GRAY = 205
_INK = (40, 44, 52)


def draw_answers(saved: SavedMap, answers: Answers) -> NDArray[np.uint8]:
    """Return an (H, 1600, 3) uint8 picture of a map and the answers; raises `MapFolderError` for a view."""
    ids = {answer.id for answer in answers.found}
    objects = tuple(item if item.id in ids else _faded(item) for item in saved.snapshot.objects)
    shown = replace(saved, snapshot=replace(saved.snapshot, objects=objects))
    whole = render_map(shown, {1}, _SIZE)
    by_id = {item.id: item for item in saved.snapshot.objects}
    tiles = [_tile(saved, by_id[answer.id], answer) for answer in answers.found[:_MOST_VIEWS]]
    strip = np.full((_TILE_PX + _CAPTION_PX + 2 * _MARGIN_PX, _SIZE[0], 3), 255, np.uint8)
    for i, tile in enumerate(tiles):
        left = _MARGIN_PX + i * (_TILE_PX + _MARGIN_PX)
        strip[_MARGIN_PX : _MARGIN_PX + len(tile), left : left + _TILE_PX] = tile
    heading = np.full((_CAPTION_PX + _MARGIN_PX, _SIZE[0], 3), 255, np.uint8)
    _write(heading, f"{len(answers.found)} found by {answers.judged_by}: {answers.question}", _MARGIN_PX, 0.6)
    return np.concatenate([heading, whole, strip] if tiles else [heading, whole])


def _faded(item: TrackedObject) -> TrackedObject:
    return replace(item, colors=np.full_like(item.colors, _GRAY))


def _tile(saved: SavedMap, item: TrackedObject, answer: Answer) -> NDArray[np.uint8]:
    tile = np.full((_TILE_PX + _CAPTION_PX, _TILE_PX, 3), 255, np.uint8)
    if item.best_view is not None:
        rgb = read_crop(saved.views, item.best_view.name).rgb
        scale = _TILE_PX / max(rgb.shape[:2])
        size = (max(1, round(rgb.shape[1] * scale)), max(1, round(rgb.shape[0] * scale)))
        small = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
        tile[: size[1], : size[0]] = small
    _write(tile[_TILE_PX:], f"#{answer.id}: {answer.score:.2f}, {kind_text(item.fixture_probability)}", 2, 0.55)
    return tile


def _write(image: NDArray[np.uint8], text: str, left_px: int, size: float) -> None:
    font = cv2.FONT_HERSHEY_SIMPLEX
    cv2.putText(image, text, (left_px, _CAPTION_PX - 6), font, size, _INK, 1, cv2.LINE_AA)
