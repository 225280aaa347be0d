"""Log items of one frame: camera, colour, depth, masks, 2D boxes and trajectory.

Between keyframes only the pose and the compressed colour are logged; the masks of the last keyframe stay.
"""

from collections.abc import Iterable
from typing import Any

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from hickory_stream.geometry.display import Components, color_of_id, main_components, readable_on_dark, rises
from hickory_stream.records import Frame, FrameReport, Observation
from hickory_stream.sinks.rerun.items import LogItem, Span, Weight
from hickory_stream.sinks.rerun.labels import CAMERA_COLOR, DOUBTED, label_size

CAMERA = "world/camera"
TRAJECTORY = "world/trajectory"
# Class ids of masks: object ids, and this for an observation that went to no object.
_UNASSIGNED = 65535
_MILLIMETRES = 1000.0
_SEGMENT_LENGTH = 64
# More reasons than this on one image hide one another; they show when a box is pointed at.
_MOST_LABELS = 6


def camera_items(report: FrameReport) -> list[LogItem]:
    """Return the camera's pose and pinhole."""
    camera = report.camera
    pose = rr.Transform3D(translation=report.world_from_camera[:3, 3], mat3x3=report.world_from_camera[:3, :3])
    pinhole = rr.Pinhole(
        image_from_camera=camera.K,
        resolution=(camera.width, camera.height),
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=0.35,
        color=CAMERA_COLOR,
    )
    return [LogItem(path=CAMERA, archetypes=(pose, pinhole), span=Span.LASTING)]


def color_items(report: FrameReport, jpeg_quality: int) -> list[LogItem]:
    """Return the compressed colour of the log; a keyframe without one is encoded here."""
    if report.color_bytes is not None:
        image = rr.EncodedImage(contents=report.color_bytes, media_type=_media_type(report.color_bytes))
    elif report.frame is not None:
        image = encoded_jpeg(report.frame.rgb, jpeg_quality)
    else:
        return []
    return [LogItem(path=f"{CAMERA}/color", archetypes=(image,), weight=Weight.HEAVY)]


def depth_items(frame: Frame) -> list[LogItem]:
    """Return the depth as a 16-bit PNG in millimetres, 0 for no return and beyond 65 m."""
    millimetres = np.nan_to_num(frame.depth_m * _MILLIMETRES, nan=0.0, posinf=0.0, neginf=0.0)
    millimetres[(millimetres < 0) | (millimetres > 65535)] = 0.0
    # Run lengths only: depth is noise to a compressor, and a better one takes five times as long.
    quick = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]
    _, png = cv2.imencode(".png", np.rint(millimetres).astype(np.uint16), quick)
    image = rr.EncodedDepthImage(blob=png.tobytes(), media_type="image/png", meter=_MILLIMETRES)
    return [LogItem(path=f"{CAMERA}/depth", archetypes=(image,), weight=Weight.HEAVY)]


def mask_items(report: FrameReport) -> list[LogItem]:
    """Return the observations of a keyframe: a class image whose classes are object ids, and labelled boxes."""
    classes = np.zeros((report.camera.height, report.camera.width), dtype=np.uint16)
    ids = report.object_ids or (None,) * len(report.observations)
    for observation, object_id in zip(report.observations, ids, strict=True):
        x0, y0, x1, y1 = observation.box_px
        classes[y0:y1, x0:x1][observation.mask] = _UNASSIGNED if object_id is None else object_id % _UNASSIGNED
    boxes = rr.Boxes2D(
        array=np.array([o.box_px for o in report.observations], dtype=np.float32).reshape(-1, 4),
        array_format=rr.Box2DFormat.XYXY,
        labels=["" if i is None else str(i) for i in ids],
        colors=[DOUBTED if i is None else color_of_id(i) for i in ids],
        radii=-1.0,
        show_labels=False,
    )
    masks = rr.SegmentationImage(classes, opacity=0.5)
    return [
        LogItem(path=f"{CAMERA}/masks", archetypes=(masks,), weight=Weight.HEAVY),
        LogItem(path=f"{CAMERA}/boxes", archetypes=(boxes,)),
        LogItem(path=f"{CAMERA}/labels", archetypes=(_numbers(report),)),
    ]


def _numbers(report: FrameReport) -> Any:
    largest: dict[int, Observation] = {}
    for observation, object_id in zip(report.observations, report.object_ids, strict=False):
        if object_id is not None:
            best = largest.get(object_id)
            if best is None or observation.mask.sum() > best.mask.sum():
                largest[object_id] = observation
    ids = sorted(largest)
    # The camera's view is a third as high as the one that the sizes are for.
    sizes = 2.1 * report.camera.height * np.array([label_size(str(i)) for i in ids]).reshape(-1, 2)
    centers = np.array([_innermost_px(largest[i]) for i in ids], dtype=np.float64).reshape(-1, 2)
    centers[:, 1] -= rises(centers, sizes)
    # A label hangs below its point.
    return rr.Points2D(
        centers - sizes * (0.0, 0.5),
        radii=-0.1,
        labels=[str(i) for i in ids],
        colors=[readable_on_dark(color_of_id(i)) for i in ids],
        show_labels=True,
    )


def _innermost_px(observation: Observation) -> tuple[float, float]:
    within = cv2.distanceTransform(np.pad(observation.mask, 1).astype(np.uint8), cv2.DIST_L2, 3)
    _, _, _, (x, y) = cv2.minMaxLoc(within)
    return observation.box_px[0] + x - 0.5, observation.box_px[1] + y - 0.5


def rejected_items(report: FrameReport) -> list[LogItem]:
    """Return the rejected masks of a keyframe: their pixels, and boxes with the reasons."""
    image = np.zeros((report.camera.height, report.camera.width), dtype=np.uint16)
    for rejected in report.rejected:
        x0, y0, x1, y1 = rejected.box_px
        if rejected.mask is not None:
            image[y0:y1, x0:x1][rejected.mask] = _UNASSIGNED
    boxes = rr.Boxes2D(
        array=np.array([r.box_px for r in report.rejected], dtype=np.float32).reshape(-1, 4),
        array_format=rr.Box2DFormat.XYXY,
        labels=[r.reason for r in report.rejected],
        colors=[DOUBTED] * len(report.rejected),
        radii=-1.0,
        show_labels=len(report.rejected) <= _MOST_LABELS,
    )
    return [
        LogItem(
            path=f"{CAMERA}/rejected/masks", archetypes=(rr.SegmentationImage(image, opacity=0.6),), weight=Weight.HEAVY
        ),
        LogItem(path=f"{CAMERA}/rejected/boxes", archetypes=(boxes,)),
    ]


class FeatureColors:
    """Patch features as colour: three principal components, found in the first frame and kept."""

    def __init__(self) -> None:
        self._components: Components | None = None

    def items(self, report: FrameReport) -> list[LogItem]:
        """Return the features of a keyframe as an image; nothing if it has none."""
        if report.patches is None or report.patches.size == 0:
            return []
        if self._components is None or self._components.dim != report.patches.shape[2]:
            self._components = main_components(report.patches)
        small = self._components.colors(report.patches)
        size = (report.camera.width, report.camera.height)
        image = encoded_jpeg(cv2.resize(small, size, interpolation=cv2.INTER_NEAREST), 80)
        return [LogItem(path=f"{CAMERA}/features", archetypes=(image,), weight=Weight.HEAVY)]


class ClassColors:
    """Colours of the masks by object id."""

    def __init__(self) -> None:
        self._known: set[int] = set()

    def items(self, object_ids: Iterable[int | None]) -> list[LogItem]:
        """Return the annotations of all ids so far if one of these is new."""
        new = {i % _UNASSIGNED for i in object_ids if i is not None} - self._known
        if not new and self._known:
            return []
        self._known |= new | {0}
        classes = [(i, str(i), color_of_id(i)) for i in sorted(self._known - {0})]
        context = rr.AnnotationContext([(0, "no object", (0, 0, 0, 0)), *classes, (_UNASSIGNED, "rejected", DOUBTED)])
        return [LogItem(path=CAMERA, archetypes=(context,), span=Span.STATIC)]


class Trajectory:
    """Trajectory of the camera in pieces: only the last piece is logged again, so that the cost stays linear."""

    def __init__(self) -> None:
        self._piece = 0
        self._points: list[NDArray[np.float64]] = []
        self._ended: list[LogItem] = []

    def add(self, world_from_camera: NDArray[np.float64]) -> None:
        """Add the camera's next pose."""
        if len(self._points) == _SEGMENT_LENGTH:
            self._ended.append(self._piece_item())
            self._points = self._points[-1:]
            self._piece += 1
        self._points.append(world_from_camera[:3, 3])

    def items(self) -> list[LogItem]:
        """Return the pieces that grew since the last call."""
        grown, self._ended = [*self._ended, self._piece_item()], []
        return grown

    def _piece_item(self) -> LogItem:
        line = rr.LineStrips3D([np.array(self._points)], colors=CAMERA_COLOR, radii=-1.5)
        return LogItem(path=f"{TRAJECTORY}/{self._piece:04d}", archetypes=(line,), span=Span.LASTING)


def encoded_jpeg(rgb: NDArray[np.uint8], quality: int) -> Any:
    """Return (H, W, 3) colour as a JPEG archetype."""
    _, jpeg = cv2.imencode(".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return rr.EncodedImage(contents=jpeg.tobytes(), media_type="image/jpeg")


def _media_type(data: bytes) -> str | None:
    if data.startswith(b"\xff\xd8"):
        return "image/jpeg"
    return "image/png" if data.startswith(b"\x89PNG") else None
