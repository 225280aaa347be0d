"""Conversion of point clouds (sensor_msgs/PointCloud2) to scans for LiDAR odometry.

The name of the field with a point's time depends on the driver.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import RecordingError
from hickory_stream.records import Scan
from players.messages.records import frame_name, header_stamp_ns

_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""The number types by a PointField's `datatype`."""

_TIMES = ("t", "offset_time", "time", "timestamp", "time_stamp")
"""Names of the time field with Ouster, Livox, Velodyne and Hesai; integers are nanoseconds, floats seconds."""

_LONGEST_SWEEP_S = 10.0
MAX_POINTS = 16_000_000
"""The maximum number of points; a cloud that declares more is damaged or malicious."""


def scan_of(message: Any, stamp_ns: int | None = None) -> Scan:
    """Return the finite points of a message; `stamp_ns` replaces that of its header.

    Raises `RecordingError`: it has no x, y and z, or is shorter than declared.
    """
    fields = {field.name: field for field in message.fields}
    at = f"a cloud of {message.header.frame_id!r}"
    missing = [axis for axis in "xyz" if axis not in fields]
    if missing:
        raise RecordingError(f"{at} has no {', '.join(missing)}; its fields are {', '.join(fields) or 'none'}")
    stamp_ns = header_stamp_ns(message) if stamp_ns is None else stamp_ns
    time_name = next((name for name in _TIMES if name in fields), None)
    names = ["x", "y", "z", *([time_name] if time_name is not None else [])]
    rows = _rows(message, [fields[name] for name in names], at)
    points = np.stack([rows[axis].ravel().astype(np.float32) for axis in "xyz"], axis=1)
    is_finite = np.isfinite(points).all(axis=1)
    times_s = _since(rows[time_name].ravel(), stamp_ns) if time_name is not None else None
    return Scan(
        stamp_ns=stamp_ns,
        frame=frame_name(message.header.frame_id),
        points=points[is_finite],
        times_s=times_s[is_finite] if times_s is not None else None,
    )


def _rows(message: Any, fields: list[Any], at: str) -> NDArray[Any]:
    height, width = int(message.height), int(message.width)
    step, row_step = int(message.point_step), int(message.row_step)
    data = np.ascontiguousarray(message.data, dtype=np.uint8)
    if height * width > MAX_POINTS:
        raise RecordingError(f"{at} claims {height} x {width} points, over the limit of {MAX_POINTS}")
    # Some drivers leave the length of a row at 0 if there is only one row.
    row_step = row_step if height > 1 or row_step >= width * step else width * step
    order = ">" if message.is_bigendian else "<"
    formats = []
    for field in fields:
        if field.datatype not in _TYPES:
            raise RecordingError(f"{at}: field {field.name} is of the unknown type {field.datatype}")
        dtype = np.dtype(order + _TYPES[field.datatype])
        if field.offset + dtype.itemsize > step:
            raise RecordingError(f"{at}: field {field.name} ends at byte {field.offset + dtype.itemsize} of {step}")
        formats.append(dtype)
    needed = row_step * (height - 1) + width * step if height * width else 0
    if row_step < width * step or len(data) < needed:
        raise RecordingError(
            f"{at} has {len(data)} bytes in rows of {row_step}; {height} x {width} points of {step} bytes need {needed}"
        )
    names, offsets = [field.name for field in fields], [int(field.offset) for field in fields]
    kind = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": step})
    return np.ndarray((height, width), dtype=kind, buffer=data.data, strides=(row_step, step))


def _since(values: NDArray[Any], stamp_ns: int) -> NDArray[np.float32] | None:
    # Some drivers leave the field empty: then the values are no times.
    if not len(values):
        return np.zeros(0, dtype=np.float32)
    seconds = values.astype(np.float64) * (1e-9 if np.issubdtype(values.dtype, np.integer) else 1.0)
    if (np.abs(seconds) > _LONGEST_SWEEP_S).any():
        seconds = seconds - stamp_ns / 1e9  # absolute time
    is_sweep = bool((np.abs(seconds) <= _LONGEST_SWEEP_S).all())
    return seconds.astype(np.float32) if is_sweep else None
