"""Foxglove's WebSocket, as `foxglove_bridge` and the Foxglove SDK serve it; definitions come with channels.

Frames: JSON with an `op`, or binary: opcode, subscription, server time, bytes.
Our own channels are published as a client does (`clientPublish`). Servers keep nothing: latched messages are repeated.
"""

import base64
import binascii
import json
import re
import struct
import threading
import time
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from typing import Any

from hickory_stream.base.json_text import dumps
from hickory_stream.errors import RecordingError
from players.live.inbox import MAX_MESSAGE_BYTES, MAX_TOPICS, Inbox
from players.live.transport import Health, ThreadedRoute
from players.logs.containers import Topic
from players.logs.mcap_records import make_topic

_CLIENT_DATA = struct.Struct("<BI")
_LATCHED_AGAIN_S = 5.0


class FoxgloveReturn:
    """Publishes over a connection that may drop."""

    def __init__(self) -> None:
        self._takes: bool | None = None
        self._lock = threading.RLock()
        self._connection: Any = None
        self._channels: dict[str, dict[str, Any]] = {}
        self._latched: dict[str, bytes] = {}
        self._sent_s: dict[str, float] = {}

    @property
    def problem(self) -> str:
        """Why offered topics are not published, "" if the server is not at fault."""
        if self._takes is False and self._channels:
            return "the server takes no messages of ROS 2 (it has no clientPublish): nothing is published"
        return ""

    def attach(self, connection: Any, server: Mapping[str, Any]) -> None:
        """Begin to publish if the server accepts messages."""
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
        """Stop publishing until the connection is back."""
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
        """Publish a message, and latched messages that are due; False if no server accepts them."""
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


SUBPROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
"""What the SDK and newer bridges speak, and what older bridges do."""

_PORT = 8765
_AGAIN_S = 0.5
_OPEN_S = 3.0
_ADDRESS = re.compile(r"foxglove://(?P<host>\[[^]]+\]|[^:/]*)(?::(?P<port>\d+))?/?")
_MESSAGE_DATA = struct.Struct("<BIQ")
_SCHEMA_ENCODINGS = {"cdr": "ros2msg", "ros1": "ros1msg", "protobuf": "protobuf", "json": "jsonschema"}
_NOTE_LETTERS = 200


class _OtherProtocolError(Exception):
    """A WebSocket that chose none of the subprotocols."""


class FoxgloveRoute(ThreadedRoute):
    """The `LiveSource` of `foxglove://HOST[:PORT]`."""

    kind, thread_name, patience_s = "Foxglove WebSocket", "foxglove", 5.0

    def __init__(self, uri: str) -> None:
        """Parse the address. Raises `RecordingError`: it is none."""
        found = _ADDRESS.fullmatch(uri)
        if found is None or not 0 < int(found["port"] or _PORT) < 65536:
            raise RecordingError(f"found {uri}, expected foxglove://HOST[:{_PORT}]; without a HOST, this machine")
        super().__init__(uri, "")
        self._peer = f"{found['host'] or '127.0.0.1'}:{found['port'] or _PORT}"
        self._lock = threading.RLock()
        self._connection: Any = None
        self._problem = f"{self._peer} was not reached yet"
        self._note = ""
        self._topics: dict[str, Topic] = {}
        self._other_types: dict[str, str] = {}
        self._channels: dict[int, str] = {}
        self._wanted: set[str] = set()
        self._subscribed: dict[int, int] = {}
        self._return = FoxgloveReturn()
        self._heard: dict[str, Callable[[bytes], None]] = {}

    def subscribe(self, names: Collection[str]) -> None:
        """Subscribe to the channels of topics."""
        with self._lock:
            self._wanted |= set(names)
            self._ask()

    def health(self) -> Health:
        """Return whether the server is connected, and its warnings."""
        if self._connection is None:
            return Health(is_connected=False, problem=self._problem)
        with self._lock:
            notes = [f"{name} is published as {other}, too" for name, other in sorted(self._other_types.items())]
        notes += [note for note in (self._note, self._return.problem) if note]
        return Health(is_connected=True, problem="; ".join(notes))

    def stop(self) -> None:
        """Close the connection."""
        self._stopped.set()
        connection = self._connection
        if connection is not None:
            connection.close()
        super().stop()

    def offer(self, name: str, type_name: str, *, definition: str, type_hash: str, is_latched: bool) -> None:
        """Announce a topic of ours."""
        del type_hash
        self._return.offer(name, type_name, definition=definition, is_latched=is_latched)

    def send(self, name: str, data: bytes) -> bool:
        """Publish a message of an offered topic; False while the server is away or accepts none."""
        return self._return.send(name, data)

    def listen(self, name: str, hear: Callable[[bytes], None]) -> None:
        """Call `hear` with each message of a topic."""
        with self._lock:
            self._heard[name] = hear
            self._wanted.add(name)
            self._ask()

    def _run(self, inbox: Inbox) -> None:
        from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidMessage

        while not self._stopped.is_set():
            try:
                self._talk(inbox)
                self._problem = f"the connection to {self._peer} is lost; it is tried again"
            except ConnectionClosed as error:
                reason = error.sent.reason if error.sent is not None else ""
                why = f" ({reason})" if reason else ""
                self._problem = f"the connection to {self._peer} is lost{why}; it is tried again"
            except (_OtherProtocolError, InvalidHandshake, InvalidMessage, EOFError):
                self._problem = f"{self._peer} does not speak Foxglove's WebSocket protocol"
            except OSError as error:
                self._problem = f"{self._peer} does not answer ({error.strerror or 'no answer in time'})"
            self._return.detach()
            with self._lock:
                self._connection = None
                gone, self._channels = set(self._channels.values()), {}
                self._subscribed.clear()
            for name in gone:
                inbox.withdraw(name)
            self._stopped.wait(_AGAIN_S)

    def _talk(self, inbox: Inbox) -> None:
        from websockets.exceptions import ConnectionClosedOK
        from websockets.sync.client import connect
        from websockets.typing import Subprotocol

        with connect(
            f"ws://{self._peer}",
            subprotocols=[Subprotocol(name) for name in SUBPROTOCOLS],
            compression=None,
            proxy=None,
            open_timeout=_OPEN_S,
            close_timeout=1.0,
            max_size=MAX_MESSAGE_BYTES + _MESSAGE_DATA.size,
        ) as connection:
            if connection.subprotocol not in SUBPROTOCOLS:
                raise _OtherProtocolError
            with self._lock:
                self._connection = connection
            with suppress(ConnectionClosedOK):
                while not self._stopped.is_set():
                    # A message of one frame, as servers send them, is not copied.
                    parts: list[Any] = list(connection.recv_streaming())
                    if isinstance(parts[0], str):
                        self._hear(inbox, "".join(parts))
                    else:
                        self._take(inbox, memoryview(parts[0] if len(parts) == 1 else b"".join(parts)).toreadonly())

    def _hear(self, inbox: Inbox, text: str) -> None:
        try:
            said = json.loads(text)
            match said["op"]:
                case "advertise":
                    for channel in said["channels"]:
                        self._advertised(inbox, channel)
                    with self._lock:
                        self._ask()
                case "unadvertise":
                    self._unadvertised(inbox, said["channelIds"])
                case "serverInfo":
                    self._return.attach(self._connection, said)
                case "status" if said.get("level", 0) >= 1:
                    self._note = f"the server says: {said.get('message', '')}"[:_NOTE_LETTERS]
        except (ValueError, KeyError, TypeError, AttributeError, binascii.Error):
            self._note = f"the server has sent no message of the protocol: {text[:40]!r}"

    def _advertised(self, inbox: Inbox, channel: Mapping[str, Any]) -> None:
        encoding = str(channel["encoding"])
        schema_encoding = channel.get("schemaEncoding") or _SCHEMA_ENCODINGS.get(encoding, "")
        schema = str(channel["schema"])
        definition = base64.b64decode(schema) if schema_encoding == "protobuf" else schema.encode()
        topic = make_topic(
            str(channel["topic"]), encoding, str(channel["schemaName"]), schema_encoding, definition, num_messages=None
        )
        with self._lock:
            known = self._topics.get(topic.name, topic)
            if known.type_name != topic.type_name or known.wire != topic.wire:
                self._other_types[topic.name] = topic.type_name
                return
            if len(self._channels) >= MAX_TOPICS:
                return
            self._topics[topic.name] = topic
            self._channels[int(channel["id"])] = topic.name
        inbox.announce(topic)

    def _unadvertised(self, inbox: Inbox, ids: list[int]) -> None:
        with self._lock:
            gone = {name for i in ids if (name := self._channels.pop(i, None)) is not None}
            for i in ids:
                self._subscribed.pop(i, None)
            left = set(self._channels.values())
        for name in gone - left:
            inbox.withdraw(name)

    def _ask(self) -> None:
        # Called with the lock. A subscription has its channel's number.
        if self._connection is None:
            return
        wanted = [i for i, name in self._channels.items() if name in self._wanted and i not in self._subscribed]
        if not wanted:
            return
        from websockets.exceptions import ConnectionClosed

        self._subscribed |= {i: i for i in wanted}
        asked = {"op": "subscribe", "subscriptions": [{"id": i, "channelId": i} for i in wanted]}
        try:
            self._connection.send(dumps(asked))
        except ConnectionClosed:
            return  # the receiving thread connects again, and asks again

    def _take(self, inbox: Inbox, frame: memoryview) -> None:
        if len(frame) < _MESSAGE_DATA.size or frame[0] != 1:
            return  # the time, or an answer to what was not asked
        _, subscription, _ = _MESSAGE_DATA.unpack_from(frame)
        name = self._channels.get(subscription)
        if name in self._heard:
            self._heard[name](bytes(frame[_MESSAGE_DATA.size :]))
        elif name is not None:
            inbox.put(name, frame[_MESSAGE_DATA.size :])
