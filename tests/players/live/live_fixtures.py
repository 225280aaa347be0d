"""A live route that a test writes itself: announces topics, and sends what it is told to."""

from collections import Counter
from dataclasses import dataclass, field
from functools import cache
from players.live.inbox import Inbox
from players.live.transport import Health
from players.logs.containers import Topic
from tests.player_scenes import Messages, make_scene, png_images, scene_messages


@dataclass(frozen=True, kw_only=True)
class Packet:
    """A message as it lies on the wire, and what is known of its topic."""

    topic: Topic
    stamp_ns: int
    data: bytes


def scene_packets(num_frames=6):
    """Return the small scene of the players' tests as packets in the order of time."""
    return list(_packets(num_frames))


@cache
def _packets(num_frames):
    m = Messages(2)
    packets = []
    for entry in scene_messages(m, make_scene(num_frames=num_frames), png_images):
        name = entry.message.__msgtype__
        topic = Topic(
            name=entry.topic, type_name=name, num_messages=None, wire="cdr", definition_format="none", definition=""
        )
        packets.append(
            Packet(topic=topic, stamp_ns=entry.stamp_ns, data=bytes(m.store.serialize_cdr(entry.message, name)))
        )
    return tuple(packets)


@dataclass
class ScriptedRoute:
    """A `LiveSource` without a network; `sent` counts what it put into the inbox, by topic."""

    uri: str = "script://robot"
    kind: str = "script"
    at_start: list[Packet] = field(default_factory=list)
    announced: list[Topic] = field(default_factory=list)
    state: Health = field(default_factory=lambda: Health(is_connected=True))
    sent: Counter[str] = field(default_factory=Counter)
    asked: set[str] = field(default_factory=set)
    inbox: Inbox | None = None

    def start(self, inbox):
        self.inbox = inbox
        for topic in self.announced:
            inbox.announce(topic)
        self.send(self.at_start)

    def send(self, packets):
        for packet in packets:
            self.inbox.announce(packet.topic)
            self.inbox.put(packet.topic.name, packet.data)
            self.sent[packet.topic.name] += 1

    def end(self):
        self.inbox.close()

    def subscribe(self, names):
        self.asked |= set(names)

    def health(self):
        return self.state

    def stop(self):
        self.state = Health(is_connected=False, problem="stopped")
