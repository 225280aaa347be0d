"""The binary files of a map: points as PLY, keys of voxels and other arrays as NPY, read without trust in a header."""

from __future__ import annotations

import io
import math
import re
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_NPY_HEADER = re.compile(
    rb"\x93NUMPY\x01\x00..\{'descr': '(?P<descr>[<|][a-z]\d)', 'fortran_order': False, "
    rb"'shape': \((?P<shape>\d{1,15},(?: \d{1,15})?)\), \} *\n",
    re.DOTALL,
)
_PLY_VERTEX = np.dtype([("xyz", "<f4", 3), ("rgb", "u1", 3)])
_PLY_HEADER = (
    "ply\nformat binary_little_endian 1.0\nelement vertex {count}\n"
    "property float x\nproperty float y\nproperty float z\n"
    "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n"
)


def ply_bytes(points: NDArray[np.float32], colors: NDArray[np.uint8]) -> bytes:
    """Return a binary little-endian PLY of (N, 3) points with (N, 3) colours."""
    vertices = np.empty(len(points), dtype=_PLY_VERTEX)
    vertices["xyz"], vertices["rgb"] = points, colors
    return _PLY_HEADER.format(count=len(points)).encode() + vertices.tobytes()


def ply_arrays(data: bytes) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Return the points (N, 3) and colours (N, 3) of a PLY that `ply_bytes` wrote.

    Raises:
        ValueError: it is another kind of PLY, or shorter than it says.
    """
    header, end, body = data.partition(b"end_header\n")
    count = len(body) // _PLY_VERTEX.itemsize
    if header + end != _PLY_HEADER.format(count=count).encode() or len(body) != count * _PLY_VERTEX.itemsize:
        raise ValueError("not a point file of this map format")
    vertices = np.frombuffer(body, dtype=_PLY_VERTEX)
    if not np.isfinite(vertices["xyz"]).all():
        raise ValueError("a point that is not finite")
    return vertices["xyz"].astype(np.float32), vertices["rgb"].astype(np.uint8)


def npy_bytes(keys: NDArray[np.int64]) -> bytes:
    """Return a .npy file of (N,) keys."""
    buffer = io.BytesIO()
    np.save(buffer, keys.astype("<i8"), allow_pickle=False)
    return buffer.getvalue()


def npy_array(data: bytes, descr: str = "<i8") -> NDArray[Any]:
    """Return the (N,) or (N, n) array of a .npy file, by default the (N,) keys of voxels.

    What the header claims must be there: `numpy.load` would take the memory first.

    Raises:
        ValueError: it is no such file, of numbers of another kind, or shorter or longer than it says.
    """
    header = _NPY_HEADER.match(data)
    if header is None or header["descr"].decode() != descr:
        raise ValueError(f"not an array of {descr} as `numpy.save` writes it")
    shape = [int(length) for length in header["shape"].split(b",") if length.strip()]
    dtype = np.dtype(descr)
    if not 1 <= len(shape) <= 2 or math.prod(shape) * dtype.itemsize != len(data) - header.end():
        raise ValueError(f"an array of shape {shape} in {len(data) - header.end()} bytes")
    array = np.frombuffer(data, dtype, offset=header.end()).reshape(shape)
    return array.astype(dtype.newbyteorder("="))
