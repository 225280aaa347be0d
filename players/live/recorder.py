"""Writes every message as it came into an MCAP file: definitions, bytes, times of arrival.

Records are written without chunks: after a kill, the file holds everything up to then.
The recording keeps within a budget of disk, and never slows the map.
"""

import os
import shutil
import threading
import time
from collections import deque
from pathlib import Path
from typing import Any

from hickory_stream.errors import OutputError
from players.logs.containers import LogMessage, Topic
from players.logs.mcap_records import schema_of

DEFAULT_LIMIT_BYTES = 50_000_000_000
_RESERVE_BYTES = 1_000_000_000
_WAITING_BYTES = 256 << 20
_SYNC_S = 5.0


class Recorder:
    """Takes messages from any thread and writes them in its own; `problem` is why it ended early, or ""."""

    def __init__(
        self,
        path: Path,
        uri: str,
        *,
        limit_bytes: int = DEFAULT_LIMIT_BYTES,
        reserve_bytes: int = _RESERVE_BYTES,
        waiting_bytes: int = _WAITING_BYTES,
    ) -> None:
        """Begin the file. Raises `OutputError`: it cannot be written."""
        from mcap.writer import Writer

        self.path = path
        self.problem = ""
        self.num_written = 0
        self.num_not_written = 0
        self._limit_bytes, self._reserve_bytes, self._most_waiting = limit_bytes, reserve_bytes, waiting_bytes
        try:
            self._stream: Any = path.open("wb")
        except OSError as error:
            raise OutputError(f"cannot write the recording {path}: {error.strerror}") from error
        self._writer = Writer(self._stream, use_chunking=False, enable_data_crcs=True)
        self._writer.start(profile="ros2", library="hickory-stream live")
        self._writer.add_metadata("hickory_stream.live", {"uri": uri})
        self._channels: dict[str, int] = {}
        self._changed = threading.Condition()
        self._waiting: deque[tuple[Topic, LogMessage]] = deque()
        self._waiting_bytes = 0
        self._is_over = False
        self._synced_s = time.monotonic()
        self._thread = threading.Thread(target=self._run, name="live-recorder", daemon=True)
        self._thread.start()

    def take(self, topic: Topic, message: LogMessage) -> None:
        """Queue a message for writing; one without time or room is counted."""
        with self._changed:
            if self._is_over or self.problem or self._waiting_bytes + len(message.data) > self._most_waiting:
                self.num_not_written += 1
                return
            self._waiting.append((topic, message))
            self._waiting_bytes += len(message.data)
            self._changed.notify()

    def close(self) -> None:
        """Write the queued messages, and end the file."""
        with self._changed:
            self._is_over = True
            self._changed.notify()
        self._thread.join()
        if self._stream.closed:
            return
        try:
            self._writer.finish()
            self._stream.close()
        except OSError as error:
            self._fail(f"{error.strerror}")

    @property
    def lost(self) -> str:
        """What is missing from the file and why, in one line; "" if nothing is."""
        if not self.num_not_written and not self.problem:
            return ""
        why = self.problem or "the disk was too slow"
        return f"the recording {self.path} lacks {self.num_not_written} messages: {why}"

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._is_over)
                if not self._waiting:
                    return
                topic, message = self._waiting.popleft()
            if self.problem:
                self.num_not_written += 1
            else:
                self._write(topic, message)
            with self._changed:
                self._waiting_bytes -= len(message.data)

    def _write(self, topic: Topic, message: LogMessage) -> None:
        try:
            if not self._has_room(len(message.data)):
                self.num_not_written += 1
                return
            channel = self._channels.get(topic.name)
            if channel is None:
                name, encoding, definition = schema_of(topic)
                schema = self._writer.register_schema(name, encoding, definition)
                channel = self._channels[topic.name] = self._writer.register_channel(topic.name, topic.wire, schema)
            self._writer.add_message(channel, message.log_ns, bytes(message.data), message.log_ns)
            self._stream.flush()
            self.num_written += 1
        except OSError as error:
            self.num_not_written += 1
            self._fail(error.strerror or str(error))

    def _has_room(self, size: int) -> bool:
        # Syncs the disk now and then.
        if self._stream.tell() + size > self._limit_bytes:
            self._fail(f"it has reached its limit of {self._limit_bytes / 1e9:g} GB (--record-limit)")
            return False
        if time.monotonic() - self._synced_s > _SYNC_S:
            os.fsync(self._stream.fileno())
            self._synced_s = time.monotonic()
        if self.num_written % 100 == 0 and shutil.disk_usage(self.path.parent).free < self._reserve_bytes + size:
            self._fail(f"less than {self._reserve_bytes / 1e9:g} GB of the disk are free")
            return False
        return True

    def _fail(self, reason: str) -> None:
        with self._changed:
            self.problem = self.problem or reason
