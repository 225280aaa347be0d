"""Writes the journal of a run: one chunk a step, and a checkpoint now and then; `format` describes it.

Free memory is returned to the system: the C library would keep the memory of one checkpoint for the next.
"""

import ctypes
import hashlib
import os
import time
import weakref
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.atomic_files import PARTIAL_SUFFIX, disk_errors, sync
from hickory_stream.base.confined import open_new, open_to_change, open_within
from hickory_stream.events import FrameObserved
from hickory_stream.journal import mcap_file
from hickory_stream.journal.checkpoints import KEPT_RECORDS, Packer
from hickory_stream.journal.format import ARRAYS, CHANNELS, CHECKPOINT, COLOR, JOURNAL, KNOWN, STEP, TOLD
from hickory_stream.journal.packed_frames import packed_frame
from hickory_stream.journal.reader import Journal, StoredPart, packed_array
from hickory_stream.journal.record_codec import encode
from hickory_stream.journal.snapshot_records import SnapshotRecords
from hickory_stream.journal.step import Checkpoint, JournalEntry
from hickory_stream.mapping.entities.track import Track
from hickory_stream.records import MapSnapshot


def give_back_free() -> None:
    """Return empty pages of the heap to the system; only with glibc."""
    # Windows has no library of the process itself.
    with suppress(OSError, TypeError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


class JournalWriter:
    """Appends to the journal of a map folder; not thread-safe.

    `continued` holds the steps to begin with. If the file has no others, it is continued in place; else they are
    copied, the old file is replaced at the end, and unread parts are read from the copy. Parts of the checkpoint that
    was read last are not written again.

    Raises `MapFolderError`: the disk refused; also from each method.
    """

    def __init__(self, folder: Path, *, flush_s: float, continued: Journal | None = None) -> None:
        self._path = folder / JOURNAL
        self._flush_s = flush_s
        parts = [] if continued is None else continued.parts
        self._parts = _Parts(parts)
        self._packer = Packer(part.part for part in parts if isinstance(part.part, Track))
        self._known = SnapshotRecords()
        self._num_chunks = 0
        self._messages: list[mcap_file.FileMessage] = []
        self._synced_s = time.monotonic()
        with disk_errors(self._path):
            self._file = self._opened(None if continued is None or continued.num_chunks == 0 else continued)
        if continued is not None:
            self._num_chunks = continued.num_chunks

    def append(self, entry: JournalEntry, color: bytes | None = None, known: MapSnapshot | None = None) -> None:
        """Add a step; `color` is the compressed image of its keyframe, `known` the map after it."""
        stamp_ns = entry.step.stamp_ns
        with disk_errors(self._path):
            if known is not None:
                for message in self._known.messages(known, self._num_chunks):
                    self._add(KNOWN, stamp_ns, message)
                self._end_chunk()
            # The first message identifies the chunk.
            self._add(STEP, stamp_ns, encode(entry.step))
            for event in entry.events:
                stored = packed_frame(event) if isinstance(event, FrameObserved) else event
                self._add(CHANNELS[type(event).__name__], stamp_ns, encode(stored))
            if entry.told is not None:
                self._add(TOLD, stamp_ns, encode(entry.told))
            if color is not None:
                self._add(COLOR, stamp_ns, color)
            self._end_chunk()

    def checkpoint(self, checkpoint: Checkpoint, stamp_ns: int) -> None:
        """Add the state after the last step; unchanged parts refer to the checkpoint before."""
        with disk_errors(self._path):
            self._parts.begin(self._num_chunks)
            document = encode(replace(checkpoint, core=self._packer.packed(checkpoint.core)), self._parts)
            arrays, records = self._parts.end()
            for channel, messages in ((ARRAYS, (b"", *arrays)), (CHECKPOINT, (document, *records))):
                for message in messages:
                    self._add(channel, stamp_ns, message)
                self._end_chunk()
        del arrays, records, messages, document
        give_back_free()

    def sync(self) -> None:
        """Wait until everything has reached the disk."""
        with disk_errors(self._path):
            self._file.flush()
            os.fsync(self._file.fileno())
            self._synced_s = time.monotonic()

    def close(self) -> None:
        """Write the summary that completes the MCAP file, and close it."""
        if self._file.closed:
            return
        with disk_errors(self._path):
            try:
                mcap_file.end_file(self._file)
                self.sync()
                sync(self._path.parent)
            finally:
                self._file.close()

    def abandon(self) -> None:
        """Close the file as after a kill."""
        with suppress(OSError):  # the disk refused before
            self._file.close()

    def _opened(self, continued: Journal | None) -> BinaryIO:
        index = b"" if continued is None else mcap_file.index_of(continued.last_records())
        if continued is not None and continued.is_whole:
            file = open_to_change(self._path)
            try:
                if mcap_file.go_on_in(file, continued.num_bytes, index):
                    os.fsync(file.fileno())
                    return file
            except BaseException:
                file.close()
                raise
            file.close()
        partial = self._path.with_name(f".{JOURNAL}{PARTIAL_SUFFIX}")
        file = os.fdopen(open_new(partial), "w+b")
        try:
            if continued is None:
                mcap_file.begin_file(file)
            else:
                with open_within(self._path.parent, JOURNAL) as before:
                    mcap_file.copy_start(before, file, continued.num_bytes, index)
            file.flush()
            os.fsync(file.fileno())
            partial.replace(self._path)
            if continued is not None:
                continued.read_copy()
        except BaseException:
            file.close()
            partial.unlink(missing_ok=True)
            raise
        return file

    def _add(self, channel: int, stamp_ns: int, data: bytes) -> None:
        self._messages.append(mcap_file.FileMessage(channel, max(0, stamp_ns), data))

    def _end_chunk(self) -> None:
        messages, self._messages = self._messages, []
        mcap_file.write_chunk(self._file, messages, self._num_chunks)
        self._file.flush()
        self._num_chunks += 1
        if time.monotonic() - self._synced_s >= self._flush_s:
            self.sync()


class _Stored:
    # An array is not held: those of a track may be compressed while it stays the same. Read again it is another array
    # of the same `content` (None: unknown, or of a record).
    def __init__(self, part: object) -> None:
        self.key = id(part)
        self._part: Callable[[], object] = weakref.ref(part) if isinstance(part, np.ndarray) else lambda: part
        self.place = (0, 0)
        self.content: bytes | None = None
        self.uses: list[_Stored] = []
        self.used_in = -1

    def is_of(self, part: object) -> bool:
        return self._part() is part


class _Parts:
    # (chunk, number in the chunk) of the parts of earlier checkpoints, by identity: parts are immutable. Arrays of
    # equal content are stored once.
    def __init__(self, parts: Sequence[StoredPart] = ()) -> None:
        stored = {part.place: _Stored(part.part) for part in parts}
        for part in parts:
            stored[part.place].place = part.place
            stored[part.place].uses = [stored[place] for place in part.references if place in stored]
        self._places: dict[int, _Stored] = {each.key: each for each in stored.values()}
        self._used: dict[int, _Stored] = {}
        self._contents: dict[bytes, tuple[int, int]] = {}
        self._used_contents: dict[bytes, tuple[int, int]] = {}
        self._users: list[_Stored] = []
        self._arrays: list[bytes] = []
        self._records: list[bytes] = []
        self._chunk = 0

    def begin(self, chunk: int) -> None:
        self._chunk, self._arrays, self._records, self._used, self._used_contents = chunk, [], [], {}, {}

    def is_part(self, record: object) -> bool:
        return isinstance(record, KEPT_RECORDS)

    def put(self, part: object, encoded: Callable[[], bytes]) -> tuple[int, int]:
        stored = self._used.get(id(part)) or self._places.get(id(part))
        if stored is None or not stored.is_of(part):
            stored = _Stored(part)
            if isinstance(part, np.ndarray):
                stored.content = _content_of(part)
                stored.place = self._place_of(stored.content, encoded)
            else:
                self._users.append(stored)
                self._records.append(encoded())
                self._users.pop()
                stored.place = (self._chunk + 1, len(self._records))
        self._use(stored)
        if self._users:
            self._users[-1].uses.append(stored)
        return stored.place

    def _place_of(self, content: bytes, encoded: Callable[[], bytes]) -> tuple[int, int]:
        known = self._used_contents.get(content) or self._contents.get(content)
        if known is not None:
            return known
        self._arrays.append(packed_array(encoded()))
        return self._chunk, len(self._arrays)

    def _use(self, stored: _Stored) -> None:
        if stored.used_in != self._chunk:
            stored.used_in = self._chunk
            # A freed array's identity may be another one's by now.
            if not stored.is_of(None):
                self._used[stored.key] = stored
            if stored.content is not None:
                self._used_contents[stored.content] = stored.place
            for other in stored.uses:
                self._use(other)

    def end(self) -> tuple[list[bytes], list[bytes]]:
        # Unused parts are forgotten, so that their arrays are freed.
        self._places, self._contents = self._used, self._used_contents
        new = (self._arrays, self._records)
        self._arrays, self._records = [], []
        return new


def _content_of(array: NDArray[Any]) -> bytes:
    # Processors have instructions for it: it takes half the time of BLAKE2.
    digest = hashlib.sha256(f"{array.dtype.str} {array.shape} ".encode())
    digest.update(np.ascontiguousarray(array).data)
    return digest.digest()
