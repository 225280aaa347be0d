"""A file that another library writes through a pipe, so that disk errors are reported here.

Rerun's own writer continues on a full disk and leaves an unreadable file.
"""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hickory_stream.base.atomic_files import PARTIAL_SUFFIX, sync

_PIECE_BYTES = 1 << 20
_HAS_PIPES = os.name == "posix" and Path("/dev/fd").exists()


class PipedFile:
    """Writes a stream to `path`, and removes the file on a disk error; raises `OSError` on opening."""

    def __init__(self, path: Path, stream: Any) -> None:
        self._path = path
        self._stream = stream
        self._thread: threading.Thread | None = None
        self.num_bytes = 0
        self.error: OSError | None = None
        """Why the disk refused, once it has."""
        self._file = path.open("wb")
        if not _HAS_PIPES:  # the library writes the file itself
            self._file.close()
            stream.save(path)
            return
        read, write = os.pipe()
        try:
            stream.save(f"/dev/fd/{write}")
        finally:
            os.close(write)  # the library has opened it for itself: the pipe ends when it closes that
        self._thread = threading.Thread(target=self._copy, args=(read,), name="rrd", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Write everything; raises `OSError` on a disk error, and removes a file (not a device)."""
        self._stream.disconnect()
        if self._thread is None:
            return
        self._thread.join()
        try:
            self._file.close()
        except OSError as error:
            self.error = self.error or error
        if self.error is not None:
            if self._path.is_file():
                self._path.unlink(missing_ok=True)
            raise self.error

    def _copy(self, read: int) -> None:
        # After a disk error the pipe is drained and its data dropped.
        with os.fdopen(read, "rb", buffering=0) as pipe:
            while data := pipe.read(_PIECE_BYTES):
                self.num_bytes += len(data)
                if self.error is None:
                    try:
                        self._file.write(data)
                        self._file.flush()
                    except OSError as error:
                        self.error = error


@contextmanager
def recorded_to(path: Path, stream: Any) -> Iterator[None]:
    """Record the stream within the block; on failure an earlier file stays. Raises `OSError` on a disk error."""
    is_special = path.exists() and not path.is_file()
    target = path.resolve()
    partial = path if is_special else target.with_name(f".{target.name}{PARTIAL_SUFFIX}")
    piped = PipedFile(partial, stream)
    try:
        yield
    finally:
        piped.close()
    if not is_special:
        sync(partial)
        partial.replace(target)
