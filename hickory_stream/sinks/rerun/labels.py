"""Legend, and labels above the objects, joined to them by a line, without overlap in the initial view.

The viewer draws a label below its point and over everything else, so the points have to be apart.
"""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from hickory_stream.geometry.display import color_of_id, readable_on_dark, rises
from hickory_stream.pictures.legend import FIXTURE, FIXTURE_TEXT, GENERATED, GENERATED_TEXT, Color, legend_of
from hickory_stream.records import Phase, TrackedObject
from hickory_stream.sinks.rerun.eye import MAIN_ASPECT, Eye, eye_on
from hickory_stream.sinks.rerun.items import LogItem, Span, clear_item

LABELS, LEGEND = "world/labels", "legend"
CAMERA_COLOR, BEFORE, AFTER, LOOP = (255, 214, 90), (232, 150, 60), (90, 170, 255), (70, 210, 120)
DOUBTED, FLOOR_COLOR, WALLS_COLOR = (150, 150, 150), (112, 118, 130), (62, 70, 84)
MEANINGS = (
    ("an object has one colour in all views, faded unless active", color_of_id(1)),
    (FIXTURE_TEXT, FIXTURE),
    (GENERATED_TEXT, GENERATED),
    ("camera, its path", CAMERA_COLOR),
    ("path of odometry", BEFORE),
    ("corrected path", AFTER),
    ("loop", LOOP),
    ("rejected loop or mask", DOUBTED),
    ("floor", FLOOR_COLOR),
    ("walls", WALLS_COLOR),
)
_LEGEND_PX, WIDE_LEGEND_PX = 560, 1400
BACKGROUND = (22, 25, 31)
# Of a label, as shares of the height of the main view: 24 pixels of 670.
_HEIGHT, _WIDTH, _WIDTH_PER_LETTER = 0.036, 0.015, 0.012
_GAP = 0.01
# A label that would move by less stays where it is.
_STILL_M = 0.02


class ObjectLabels:
    """Places the numbers of objects, and returns the items that keep them apart.

    Updates once per `period_ns` unless objects are new; `finish` catches up. Tentative tracks have no label.
    """

    def __init__(self, *, period_ns: int) -> None:
        self._period_ns = period_ns
        self._objects: tuple[TrackedObject, ...] = ()
        self._shown: dict[int, NDArray[np.float64]] = {}
        self._shown_ns = 0

    def update(self, objects: tuple[TrackedObject, ...], stamp_ns: int) -> list[LogItem]:
        """Return the items that show these objects."""
        self._objects = tuple(o for o in objects if o.phase is not Phase.TENTATIVE)
        ids = {o.id for o in self._objects}
        gone = sorted(self._shown.keys() - ids)
        for object_id in gone:
            del self._shown[object_id]
        items = [clear_item(f"{LABELS}/{i}") for i in gone]
        # A log that starts over has stamps before the last one: abs() lets it through.
        if ids == self._shown.keys() and abs(stamp_ns - self._shown_ns) < self._period_ns:
            return items
        self._shown_ns = stamp_ns
        return items + self.finish()

    def finish(self) -> list[LogItem]:
        """Return the labels that are out of date."""
        if not self._objects:
            return []
        eye = eye_on(np.concatenate([o.box.corners_world() for o in self._objects]), MAIN_ASPECT)
        tops = np.array([_top_of(o) for o in self._objects])
        threads = label_threads(tops, [str(o.id) for o in self._objects], eye)
        items = []
        for seen, thread in zip(self._objects, threads, strict=True):
            if seen.id in self._shown and np.abs(thread - self._shown[seen.id]).max() < _STILL_M:
                continue
            self._shown[seen.id] = thread
            items.append(
                label_item(
                    f"{LABELS}/{seen.id}", thread, str(seen.id), color_of_id(seen.id, is_fixture=seen.is_fixture)
                )
            )
        return items


def label_size(text: str) -> tuple[float, float]:
    """Return width and height of a label as fractions of the height of a typical view."""
    return _WIDTH + _WIDTH_PER_LETTER * len(text), _HEIGHT


def label_threads(tops: NDArray[np.float64], texts: Sequence[str], eye: Eye) -> NDArray[np.float64]:
    """Return (N, 3, 3) for labels above (N, 3) points: the point, start and end of its label, without overlap."""
    if len(tops) == 0:
        return np.empty((0, 3, 3))
    seen = eye.project(tops)
    below = _GAP + rises(seen, np.array([label_size(text) for text in texts]))
    up = eye.heights_m(tops, np.stack([np.zeros(len(tops)), below, below + _HEIGHT], axis=1))
    return np.asarray(tops[:, None] + up[..., None] * np.array([0.0, 0.0, 1.0]))


def label_item(path: str, thread: NDArray[np.float64], text: str, color: tuple[int, int, int]) -> LogItem:
    """Return a label and its thread from `label_threads`."""
    color = readable_on_dark(color)
    point = rr.Points3D(thread[2:], radii=-0.1, colors=color, labels=text, show_labels=True)
    line = rr.LineStrips3D([thread[:2]], radii=-0.5, colors=color)
    return LogItem(path=path, archetypes=(point, line), span=Span.LASTING)


def label_items(
    path: str, boxes: Mapping[int, NDArray[np.float64]], texts: Mapping[int, str], colors: Mapping[int, Color], eye: Eye
) -> list[LogItem]:
    """Return labels above boxes, by id the (8, 3) corners of each, for a map that stays as it is."""
    tops = np.array([[*box.mean(axis=0)[:2], box[:, 2].max()] for box in boxes.values()]).reshape(-1, 3)
    threads = label_threads(tops, [texts[i] for i in boxes], eye)
    return [label_item(f"{path}/{i}", threads[k], texts[i], colors[i]) for k, i in enumerate(boxes)]


def legend_item(entries: Sequence[tuple[str, Color]], width_px: int = _LEGEND_PX) -> LogItem:
    """Return a legend as a picture on a dark ground, which stays."""
    # As wide as its view, which would enlarge a smaller one.
    picture = legend_of(entries, width_px, ink=(225, 228, 234), ground=BACKGROUND)
    _, png = cv2.imencode(".png", picture[..., ::-1])
    image = rr.EncodedImage(contents=png.tobytes(), media_type="image/png")
    return LogItem(path=LEGEND, archetypes=(image,), span=Span.STATIC)


def _top_of(seen: TrackedObject) -> NDArray[np.float64]:
    corners = seen.box.corners_world()
    return np.array([*seen.box.center[:2], corners[:, 2].max()])
