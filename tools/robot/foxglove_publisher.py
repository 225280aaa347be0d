"""A robot that runs foxglove_bridge: the server's side of Foxglove's WebSocket, from the protocol's document."""

import base64
import json
import struct
import threading
from collections import defaultdict
from collections.abc import Collection
from contextlib import suppress
from typing import Any

from hickory_stream.base.json_text import dumps
from hickory_stream.sinks.publish_sink import GOAL_TOPIC
from hickory_stream.sinks.ros_messages import GOAL, definition_of
from players.logs.containers import Topic
from players.logs.mcap_records import schema_of
from tools.robot.link import Sending
from tools.robot.publishers import Heard

_CLIENT_DATA = struct.Struct("<BI")
_GOAL = Topic(name=GOAL_TOPIC, type_name=GOAL, definition_format="msg", definition=definition_of(GOAL))


class FoxglovePublisher:
    """Serves channels to any number of clients; `protocols` are those it speaks, the first that a client offers."""

    # `takes`: clients may publish.
    def __init__(
        self, address: str, *, protocols: tuple[str, ...] = ("foxglove.sdk.v1", "foxglove.websocket.v1"),
        takes: bool = True,
    ) -> None:  # fmt: skip
        host, _, port = address.rpartition(":")
        self._host, self._port = host, int(port)
        self._protocols = protocols
        self._capabilities = ["clientPublish"] if takes else []
        self.heard = Heard()
        self._lock = threading.Lock()
        self._channels: dict[str, int] = {}
        self._topics: dict[str, Topic] = {}
        self._heard: defaultdict[str, list[tuple[Any, int]]] = defaultdict(list)
        self._kept: dict[str, list[bytes]] = {}
        self._server: Any = None

    def connect(self, topics: Collection[Topic]) -> None:
        from websockets.sync.server import serve

        topics = [*topics, _GOAL]
        self._channels = {topic.name: i for i, topic in enumerate(topics, start=1)}
        self._topics = {topic.name: topic for topic in topics}
        self._server = serve(
            self._serve, self._host, self._port, subprotocols=list(self._protocols), compression=None, close_timeout=0.2
        )
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def disconnect(self) -> None:
        self._server.shutdown()
        with self._lock:
            connections = {id(c): c for clients in self._heard.values() for c, _ in clients}
            self._heard.clear()
            self._kept.clear()
        for connection in connections.values():
            connection.close()

    def is_heard(self, name: str) -> bool:
        """Return whether a client has asked for a topic; what is kept reaches later ones, too."""
        with self._lock:
            return bool(self._heard[name]) or name.endswith("tf_static")

    def send(self, sending: Sending) -> None:
        from websockets.exceptions import ConnectionClosed

        name = sending.due.topic.name
        with self._lock:
            clients = list(self._heard[name])
            if sending.due.is_latched:
                self._kept.setdefault(name, []).append(sending.data)
        for connection, subscription in clients:
            with suppress(ConnectionClosed):
                connection.send(struct.pack("<BIQ", 1, subscription, sending.at_ns) + sending.data)

    def ask(self, data: bytes) -> None:
        from websockets.exceptions import ConnectionClosed

        with self._lock:
            clients = list(self._heard[GOAL_TOPIC])
        self.heard.ask()
        for connection, subscription in clients:
            with suppress(ConnectionClosed):
                connection.send(struct.pack("<BIQ", 1, subscription, 0) + data)

    def advertisement(self) -> dict[str, Any]:
        return {
            "op": "advertise",
            "channels": [self._channel(number, self._topics[name]) for name, number in self._channels.items()],
        }

    def _channel(self, number: int, topic: Topic) -> dict[str, Any]:
        name, encoding, definition = schema_of(topic)
        schema = base64.b64encode(definition).decode() if encoding == "protobuf" else definition.decode()
        return {
            "id": number, "topic": topic.name, "encoding": topic.wire, "schemaName": name, "schema": schema,
            "schemaEncoding": encoding,
        }  # fmt: skip

    def _serve(self, connection: Any) -> None:
        info = {"name": "fake robot", "capabilities": self._capabilities, "supportedEncodings": ["cdr"]}
        connection.send(dumps({"op": "serverInfo", **info}))
        connection.send(dumps(self.advertisement()))
        names = {number: name for name, number in self._channels.items()}
        theirs: dict[int, str] = {}
        for text in connection:
            if isinstance(text, bytes):
                _, number = _CLIENT_DATA.unpack_from(text)
                self.heard.take(theirs[number], text[_CLIENT_DATA.size :])
                continue
            said = json.loads(text)
            if said["op"] == "advertise":
                theirs |= {channel["id"]: channel["topic"] for channel in said["channels"]}
            if said["op"] != "subscribe":
                continue
            for asked in said["subscriptions"]:
                name = names[asked["channelId"]]
                with self._lock:
                    kept = list(self._kept.get(name, ()))
                    self._heard[name].append((connection, asked["id"]))
                for data in kept:
                    connection.send(struct.pack("<BIQ", 1, asked["id"], 0) + data)
