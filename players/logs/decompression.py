"""Decompression with a limit that is checked before memory is allocated, since a declared size may be wrong."""

import bz2
import mmap
from typing import Any

MAX_UNPACKED_BYTES = 1 << 30
"""The maximum size of a chunk or message: recorders write chunks of some megabytes, larger ones are damaged or
malicious."""


_MAGICS = {b"\x28\xb5\x2f\xfd": "zstd", b"\x04\x22\x4d\x18": "lz4"}


class UnpackError(Exception):
    """Compressed bytes that are damaged, or that declare too large a size; the message says which."""


def release(data: mmap.mmap, start: int, end: int) -> None:
    """Release the pages of a mapped file that were read, since they count as memory of the process."""
    first, last = -(-start // mmap.PAGESIZE) * mmap.PAGESIZE, end // mmap.PAGESIZE * mmap.PAGESIZE
    if last > first and hasattr(mmap, "MADV_DONTNEED"):
        data.madvise(mmap.MADV_DONTNEED, first, last - first)


def unpack(compression: str, data: Any, size: int | None, *, limit: int = MAX_UNPACKED_BYTES) -> Any:
    """Return the unpacked bytes, exactly `size` of them if it is known.

    Raises `UnpackError`: the declared size is over the limit, the bytes are damaged, or they unpack to another size.
    """
    if size is not None and size > limit:
        raise UnpackError(f"claims to unpack to {size} bytes, over the limit of {limit}")
    unpacked = data if compression in ("", "none") else _unpack(compression, data, limit if size is None else size)
    if size is not None and len(unpacked) != size:
        raise UnpackError(f"unpacks to {len(unpacked)} bytes; expected {size}")
    return unpacked


def unpack_message(data: Any) -> Any:
    """Return a CDR message, unpacked if it was compressed on its own: CDR never begins like zstd or LZ4.

    Raises `UnpackError`: the bytes are damaged.
    """
    compression = _MAGICS.get(bytes(data[:4]))
    return data if compression is None else unpack(compression, data, None)


def _unpack(compression: str, data: Any, most: int) -> bytes:
    # At most one byte more than `most`.
    try:
        if compression == "zstd":
            return _zstd(data, most)
        if compression == "lz4":
            from lz4.frame import LZ4FrameDecompressor, decompress, get_frame_info

            # If the frame declares its size, one step suffices; the declared size is checked as well.
            if 0 < get_frame_info(data)["content_size"] <= most:
                return bytes(decompress(data))
            return bytes(LZ4FrameDecompressor().decompress(data, max_length=most + 1))
        if compression == "bz2":
            return bz2.BZ2Decompressor().decompress(data, max_length=most + 1)
    except (RuntimeError, OSError, ValueError, EOFError, MemoryError) as error:
        raise UnpackError(f"is damaged {compression} ({error})") from error
    raise UnpackError(f"is compressed as {compression!r}; known are none, lz4, bz2 and zstd")


def _zstd(data: Any, most: int) -> bytes:
    import zstandard

    try:
        # The library allocates the declared size before it reads the data.
        claimed = zstandard.get_frame_parameters(data).content_size
        if claimed not in (zstandard.CONTENTSIZE_UNKNOWN, zstandard.CONTENTSIZE_ERROR) and claimed > most:
            raise UnpackError(f"claims to unpack to {claimed} bytes; expected at most {most}")
        return bytes(zstandard.ZstdDecompressor().decompress(data, max_output_size=max(most, 1)))
    except zstandard.ZstdError as error:
        raise UnpackError(f"is damaged zstd ({error})") from error
