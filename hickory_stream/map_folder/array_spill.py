"""Arrays of distant places in a file of the map folder, read when the robot returns.

The file has no name: its space is free again however the process ends. It is written by calls, which fail properly on
a full disk, and read through a mapping.
"""

import logging
import mmap
import tempfile
import weakref
from collections import deque
from collections.abc import Callable
from pathlib import Path
from threading import Lock
from typing import BinaryIO, cast

from hickory_stream.geometry.lazy_arrays import in_memory

logger = logging.getLogger(__name__)

_LEAST_BYTES = 1024
"""What is smaller takes hardly less memory where it is not."""
_ROOMS_OF = 8
"""Rooms of so many sizes between one power of two and the next: at most a ninth of one is left empty."""


class FarArrays:
    """Keeps compressed arrays in a file of a folder; in memory if writing fails."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._file: BinaryIO | None = None
        self._mapped: mmap.mmap | None = None
        self._num_bytes = 0
        self._empty: dict[int, list[int]] = {}
        # A garbage collection may let go of some at any time: it takes no lock.
        self._let_go: deque[tuple[int, int]] = deque()
        self._is_refused = False
        self._lock = Lock()

    @property
    def num_bytes(self) -> int:
        """Size of the file."""
        return self._num_bytes

    def keep(self, data: bytes) -> Callable[[], bytes]:
        """Write bytes, and return their reader; their room is free when the reader is."""
        if len(data) < _LEAST_BYTES or self._is_refused:
            return in_memory(data)
        with self._lock:
            while self._let_go:
                size, at = self._let_go.popleft()
                self._empty.setdefault(size, []).append(at)
            size = _room_for(len(data))
            rooms = self._empty.get(size)
            at = rooms[-1] if rooms else self._num_bytes
            try:
                self._write(at, data, size)
            except OSError as error:
                self._is_refused = True
                logger.warning(
                    "what is far away stays in memory from now on: no more of it can be written to %s (%s); "
                    "make room there for a map larger than memory",
                    self._folder,
                    error.strerror or error,
                )
                return in_memory(data)
            if rooms:
                rooms.pop()
            self._num_bytes = max(self._num_bytes, at + size)
        return _Room(self, at, len(data))

    def read(self, at: int, length: int) -> bytes:
        """Return bytes of the file."""
        with self._lock:
            assert self._file is not None
            if self._mapped is None or len(self._mapped) < at + length:
                self._mapped = mmap.mmap(self._file.fileno(), self._num_bytes, access=mmap.ACCESS_READ)
            return self._mapped[at : at + length]

    def let_go(self, at: int, length: int) -> None:
        """Free a room."""
        self._let_go.append((_room_for(length), at))

    def _write(self, at: int, data: bytes, size: int) -> None:
        # The whole room is written: a file is mapped no further than it reaches.
        if self._file is None:
            self._file = cast("BinaryIO", tempfile.TemporaryFile(dir=self._folder, buffering=0))
            weakref.finalize(self, self._file.close)
        self._file.seek(at)
        left = memoryview(data + bytes(size - len(data)))
        while left:
            left = left[self._file.write(left) :]


class _Room:
    # Reads a room, which is freed with this object.
    __slots__ = ("_at", "_file", "_length")

    def __init__(self, file: FarArrays, at: int, length: int) -> None:
        self._file = file
        self._at = at
        self._length = length

    def __call__(self) -> bytes:
        return self._file.read(self._at, self._length)

    def __del__(self) -> None:
        self._file.let_go(self._at, self._length)


def _room_for(length: int) -> int:
    step = max(1, (1 << (length - 1).bit_length() - 1) // _ROOMS_OF)
    return -(-length // step) * step
