"""What is kept of a keyframe's images: cut-outs around observations, and the colour image, compressed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.ports import Crop

if TYPE_CHECKING:
    from hickory_stream.config import JournalConfig
    from hickory_stream.records import Frame, Observation, RawFrame


def crop_of(frame: Frame, observation: Observation, margin: float) -> Crop:
    """Return the cut-out of a frame around an observation, with `margin` of its box more on every side."""
    x0, y0, x1, y1 = observation.box_px
    dx, dy = round((x1 - x0) * margin) + 2, round((y1 - y0) * margin) + 2
    left, top = max(0, x0 - dx), max(0, y0 - dy)
    right, bottom = min(frame.camera.width, x1 + dx), min(frame.camera.height, y1 + dy)
    mask = np.zeros((bottom - top, right - left), dtype=bool)
    mask[y0 - top : y1 - top, x0 - left : x1 - left] = observation.mask
    return Crop(
        rgb=frame.rgb[top:bottom, left:right],
        depth_m=frame.depth_m[top:bottom, left:right],
        mask=mask,
        camera=frame.camera.cropped(left, top, right, bottom),
        world_from_camera=frame.world_from_camera,
        sensor=frame.sensor,
    )


def color_of(raw: RawFrame, frame: Frame, config: JournalConfig) -> bytes | None:
    """Return the compressed image of a keyframe: the log's own, else a JPEG; None where none are to be kept."""
    if not config.keep_images:
        return None
    if raw.color_bytes is not None:
        return raw.color_bytes
    import cv2

    quality = [cv2.IMWRITE_JPEG_QUALITY, config.jpeg_quality]
    encoded: bytes = cv2.imencode(".jpg", frame.rgb[..., ::-1], quality)[1].tobytes()
    return encoded
