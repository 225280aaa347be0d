"""A depth image as a scan: reliable points, thinned out evenly over the image."""

import numpy as np

from hickory_stream.geometry.camera import backproject
from hickory_stream.records import Frame, Scan

_STRIDE_AT_640 = 3
# A less certain return disturbs a registration more than it holds it.
_MAX_SIGMA_M = 0.05


def scan_of_depth(frame: Frame) -> Scan:
    """Return every few pixels of a frame as points in optical axes, without uncertain depth."""
    stride = max(1, round(_STRIDE_AT_640 * frame.camera.width / 640))
    points = backproject(frame.depth_m, frame.camera)[::stride, ::stride]
    sigma_m = frame.sensor.sigma_m(np.ascontiguousarray(points[..., 2]))
    with np.errstate(invalid="ignore"):
        is_sure = np.isfinite(points[..., 2]) & (points[..., 2] > 0) & (sigma_m <= _MAX_SIGMA_M)
    return Scan(stamp_ns=frame.stamp_ns, frame="camera", points=points[is_sure])
