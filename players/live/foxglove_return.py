"""The way back over Foxglove's WebSocket: channels of ours, as a client publishes them (`clientPublish`).

A server keeps nothing for those who come late: what is latched is sent again now and then, and when the link is back.
"""

from __future__ import annotations

import struct
import threading
import time
from typing import TYPE_CHECKING, Any

from hickory_stream.base.json_text import dumps

if TYPE_CHECKING:
    from collections.abc import Mapping

_CLIENT_DATA = struct.Struct("<BI")
_LATCHED_AGAIN_S = 5.0


class FoxgloveReturn:
    """Publishes over a connection that comes and goes."""

    def __init__(self) -> None:
        self._takes: bool | None = None
        self._lock = threading.RLock()
        self._connection: Any = None
        self._channels: dict[str, dict[str, Any]] = {}
        self._latched: dict[str, bytes] = {}
        self._sent_s: dict[str, float] = {}

    @property
    def problem(self) -> str:
        """Why nothing is published that was offered, "" where that is no fault of the server's."""
        if self._takes is False and self._channels:
            return "the server takes no messages of ROS 2 (it has no clientPublish): nothing is published"
        return ""

    def attach(self, connection: Any, server: Mapping[str, Any]) -> None:
        """Begin to publish, where the server says that it takes messages."""
        with self._lock:
            encodings = server.get("supportedEncodings") or ("cdr",)
            self._takes = "clientPublish" in server.get("capabilities", ()) and "cdr" in encodings
            if not self._takes:
                return
            self._connection = connection
            self._advertise(list(self._channels.values()))
            for name in self._latched:
                self._put(name, self._latched[name])

    def detach(self) -> None:
        """Publish no more until the connection is back."""
        with self._lock:
            self._connection = None

    def offer(self, name: str, type_name: str, *, definition: str, is_latched: bool) -> None:
        """Announce a topic."""
        with self._lock:
            channel = {
                "id": len(self._channels) + 1,
                "topic": name,
                "encoding": "cdr",
                "schemaName": type_name,
                "schema": definition,
                "schemaEncoding": "ros2msg",
            }
            self._channels[name] = channel
            if is_latched:
                self._latched.setdefault(name, b"")
            self._advertise([channel])

    def send(self, name: str, data: bytes) -> bool:
        """Publish a message, and what is latched and was not sent for a while; False where nobody takes it."""
        with self._lock:
            if name in self._latched:
                self._latched[name] = data
            is_sent = self._put(name, data)
            for other in self._latched if is_sent else ():
                if other != name and time.monotonic() - self._sent_s.get(other, 0.0) > _LATCHED_AGAIN_S:
                    self._put(other, self._latched[other])
            return is_sent

    def _put(self, name: str, data: bytes) -> bool:
        from websockets.exceptions import ConnectionClosed

        if self._connection is None or not data:
            return False
        try:
            self._connection.send(_CLIENT_DATA.pack(1, self._channels[name]["id"]) + data)
        except ConnectionClosed:
            self._connection = None
            return False
        self._sent_s[name] = time.monotonic()
        return True

    def _advertise(self, channels: list[dict[str, Any]]) -> None:
        from websockets.exceptions import ConnectionClosed

        if self._connection is None or not channels:
            return
        try:
            self._connection.send(dumps({"op": "advertise", "channels": channels}))
        except ConnectionClosed:
            self._connection = None
