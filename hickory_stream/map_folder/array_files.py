"""Points, voxel keys and views as files, encoded like the journal's arrays and compressed; no header is trusted."""

import math
import re
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from hickory_stream.journal.record_codec import decode, encode

_NPY_HEADER = re.compile(
    rb"\x93NUMPY\x01\x00..\{'descr': '(?P<descr>[<|][a-z]\d)', 'fortran_order': False, "
    rb"'shape': \((?P<shape>\d{1,15},(?: \d{1,15})?)\), \} *\n",
    re.DOTALL,
)
# Of a large building; a few forged bytes could claim all memory.
_MOST_BYTES = 1 << 27
# Files of objects in view are replaced with every save: the next levels save 1 % of bytes for 1.4 times the time.
_LEVEL = 1
_PLY_VERTEX = np.dtype([("xyz", "<f4", 3), ("rgb", "u1", 3)])
_PLY_HEADER = (
    "ply\nformat binary_little_endian 1.0\nelement vertex {count}\n"
    "property float x\nproperty float y\nproperty float z\n"
    "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n"
)


def ply_bytes(points: NDArray[np.float32], colors: NDArray[np.uint8]) -> bytes:
    """Return a binary little-endian PLY of (N, 3) points with (N, 3) colours, for other programs."""
    vertices = np.empty(len(points), dtype=_PLY_VERTEX)
    vertices["xyz"], vertices["rgb"] = points, colors
    return _PLY_HEADER.format(count=len(points)).encode() + vertices.tobytes()


def points_bytes(points: NDArray[np.float32], colors: NDArray[np.uint8]) -> bytes:
    """Return a file of (N, 3) points with (N, 3) colours, as a frame of zstd."""
    return packed((points, colors))


def points_arrays(data: bytes) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Return points (N, 3) and colours (N, 3) of such a file. Raises `ValueError`: damaged."""
    arrays = unpacked(data)
    if not isinstance(arrays, tuple) or [_kind(array) for array in arrays] != ["float32, 2", "uint8, 2"]:
        raise ValueError("not a file of points")
    points, colors = arrays
    if points.shape[1:] != (3,) or points.shape != colors.shape or not np.isfinite(points).all():
        raise ValueError("not a file of points and their colours, or a point that is not finite")
    return points, colors


def keys_bytes(keys: NDArray[np.int64]) -> bytes:
    """Return a file of (N,) sorted voxel keys, as a frame of zstd."""
    return packed(keys)


def keys_array(data: bytes) -> NDArray[np.int64]:
    """Return the keys (N,) of such a file. Raises `ValueError`: damaged."""
    keys = unpacked(data)
    if _kind(keys) != "int64, 1":
        raise ValueError("not a file of voxels")
    array: NDArray[np.int64] = keys
    return array


def packed(value: Any) -> bytes:
    """Return arrays and what else a journal holds as a frame of zstd with a checksum."""
    return bytes(zstandard.ZstdCompressor(level=_LEVEL, write_checksum=True).compress(encode(value)))


def unpacked(data: bytes) -> Any:
    """Return what `packed` was given. Raises `ValueError`: damaged."""
    try:
        if not 0 <= zstandard.frame_content_size(data) <= _MOST_BYTES:
            raise ValueError("not a file of this map format, or larger than one")
        return decode(zstandard.decompress(data))
    except zstandard.ZstdError as error:
        raise ValueError(f"not a file of this map format: {error}") from error


def _kind(value: Any) -> str:
    return f"{value.dtype}, {value.ndim}" if isinstance(value, np.ndarray) else ""


def npy_array(data: bytes, descr: str = "<i8") -> NDArray[Any]:
    """Return the (N,) or (N, n) array of a .npy file; its size is checked first, unlike in `numpy.load`.

    Raises `ValueError`: it is another kind of file or numbers, or its size differs from its header.
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
