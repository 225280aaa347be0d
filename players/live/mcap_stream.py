"""An MCAP stream that is still being written: a pipe, standard input, or a growing file.

A chunk delays its messages until it is whole. A pipe ends with its writer, a growing file at its footer.
The writer waits for the reader: nothing is dropped before it is read.
"""

import os
import select
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from players.live.inbox import MAX_MESSAGE_BYTES, Inbox
from players.live.transport import Health, ThreadedRoute
from players.logs import mcap_records as mcap
from players.logs.decompression import UnpackError

_READ_BYTES = 1 << 18
_MAX_RECORD_BYTES = 4 * MAX_MESSAGE_BYTES
_POLL_S = 0.05


class _NotMcapError(Exception):
    """Bytes that are no MCAP."""


class McapStream(ThreadedRoute):
    """The `LiveSource` of `mcap:PATH` and `-`."""

    kind, thread_name, patience_s = "MCAP stream", "mcap-stream", 2.0

    def __init__(self, uri: str, path: Path | None) -> None:
        super().__init__(uri, f"nothing was written to {path or 'standard input'} yet")
        self._path = path
        self._described = mcap.Described()

    def _run(self, inbox: Inbox) -> None:
        reason = ""
        try:
            for opcode, content in self._records():
                self._health = Health(is_connected=True)
                self._take(inbox, opcode, content)
            self._health = Health(is_connected=False, problem="the stream has ended")
        except (_NotMcapError, UnpackError, OSError) as error:
            reason = f"{self.uri}: {error}"
            self._health = Health(is_connected=False, problem=str(error))
        inbox.close(reason)

    def _take(self, inbox: Inbox, opcode: int, content: memoryview) -> None:
        if opcode == mcap.CHUNK_OP:
            records = memoryview(mcap.unpacked_chunk(content, 0, len(content)))
            for inner, at, length in mcap.records_in(records):
                if inner != mcap.CHUNK_OP:
                    self._take(inbox, inner, records[at : at + length])
        elif opcode in (mcap.SCHEMA, mcap.CHANNEL):
            mcap.learn(self._described, opcode, bytes(content))
            for channel in self._described.channels:
                inbox.announce(mcap.topic_of(self._described, channel, None))
        elif opcode == mcap.MESSAGE_OP and len(content) >= mcap.MESSAGE.size:
            channel = mcap.MESSAGE.unpack_from(content, 0)[0]
            known = self._described.channels.get(channel)
            if known is not None and not self._stopped.is_set():
                inbox.put(known[1], content[mcap.MESSAGE.size :], waits=True)

    def _records(self) -> Iterator[tuple[int, memoryview]]:
        buffer, at = bytearray(), 0
        is_first = True
        for piece in self._pieces():
            buffer += piece
            if is_first:
                if len(buffer) < len(mcap.MAGIC):
                    continue
                if bytes(buffer[: len(mcap.MAGIC)]) != mcap.MAGIC:
                    raise _NotMcapError(f"begins with {bytes(buffer[:8]).hex(' ')}; expected an MCAP stream")
                at, is_first = len(mcap.MAGIC), False
            while at + mcap.HEAD.size <= len(buffer):
                opcode, length = mcap.HEAD.unpack_from(buffer, at)
                if length > _MAX_RECORD_BYTES or not mcap.is_record(opcode, length, length):
                    raise _NotMcapError(f"holds no record (kind {opcode}, {length} bytes); write it again")
                if at + mcap.HEAD.size + length > len(buffer):
                    break
                if opcode == mcap.FOOTER:
                    return
                begin = at + mcap.HEAD.size
                with memoryview(buffer) as view:
                    content = bytes(view[begin : begin + length])
                yield opcode, memoryview(content)
                at = begin + length
            del buffer[:at]
            at = 0

    def _pieces(self) -> Iterator[bytes]:
        if self._path is None:
            yield from self._piped(sys.stdin.fileno())
            return
        is_pipe = not self._path.is_file()
        # A pipe is opened without waiting for its writer, so that it can be given up.
        descriptor = os.open(self._path, os.O_RDONLY | (os.O_NONBLOCK if is_pipe else 0))
        try:
            yield from self._piped(descriptor) if is_pipe else self._grown(descriptor)
        finally:
            os.close(descriptor)

    def _piped(self, descriptor: int) -> Iterator[bytes]:
        has_begun = False
        while not self._stopped.is_set():
            if not select.select([descriptor], [], [], _POLL_S)[0]:
                continue
            piece = os.read(descriptor, _READ_BYTES)
            if piece:
                has_begun = True
                yield piece
            elif has_begun or self._path is None:
                return
            else:
                time.sleep(_POLL_S)  # no writer yet

    def _grown(self, descriptor: int) -> Iterator[bytes]:
        while not self._stopped.is_set():
            piece = os.read(descriptor, _READ_BYTES)
            if piece:
                yield piece
            else:
                time.sleep(_POLL_S)
