"""ROS 2 over DDS, by Cyclone; peers and interface are named.

Without an interface only this machine is asked; there is no multicast.
"""

import re
import threading
from collections.abc import Callable, Collection
from typing import Any
from urllib.parse import parse_qs

from hickory_stream.errors import RecordingError
from players.live import dds_domain as dds
from players.live.inbox import Inbox
from players.live.transport import Health, ThreadedRoute
from players.logs.containers import Topic

_ADDRESS = re.compile(r"dds://(?P<domain>\d{0,3})/?(?:\?(?P<query>.*))?")
_MOST_DOMAINS = 232
_LOOPBACK = "127.0.0.1"
_WAIT_MS = 50
_AGAIN_S = 1.0
KNOWN = "dds://[DOMAIN][?interface=NAME&peer=HOST&peer=HOST]"


class DdsRoute(ThreadedRoute):
    """The `LiveSource` of `dds:`."""

    thread_name = "dds"

    def __init__(self, uri: str) -> None:
        """Parse the address. Raises `RecordingError`: it is none, or Cyclone DDS is not installed."""
        found = _ADDRESS.fullmatch(uri)
        asked = parse_qs(found["query"] or "", keep_blank_values=True) if found is not None else {}
        domain = int(found["domain"] or 0) if found is not None else -1
        peers, interfaces = asked.get("peer", []), asked.get("interface", [])
        is_known = set(asked) <= {"peer", "interface"} and len(interfaces) <= 1 and all([*peers, *interfaces])
        if not 0 <= domain <= _MOST_DOMAINS or not is_known:
            raise RecordingError(f"found {uri}, expected {KNOWN}, with a DOMAIN of 0 to {_MOST_DOMAINS}")
        if interfaces and not peers:
            raise RecordingError(f"{uri} names an interface and no peer: name the robot, e.g. &peer=192.168.123.161")
        dds.check_installed()
        super().__init__(uri, "")
        self._domain = domain
        self._interface = interfaces[0] if interfaces else _LOOPBACK
        self._peers = tuple(peers or (_LOOPBACK,))
        self.kind = f"ROS 2 over DDS, domain {domain}, interface {self._interface}, peers {', '.join(self._peers)}"
        self._lock = threading.RLock()
        self._problem = "the domain was not joined yet"
        self._writers_of: dict[str, tuple[str, str]] = {}
        self._types: dict[str, tuple[str, bool, bool]] = {}
        self._other_types: dict[str, str] = {}
        self._wanted: set[str] = set()
        self._readers: dict[str, Any] = {}
        self._conditions: list[Any] = []
        self._offers: dict[str, tuple[str, bool]] = {}
        self._writers: dict[str, Any] = {}
        self._listeners: dict[str, Callable[[bytes], None]] = {}

    def subscribe(self, names: Collection[str]) -> None:
        """Subscribe to topics with the QoS of their publishers."""
        with self._lock:
            self._wanted |= set(names)

    def health(self) -> Health:
        """Return whether the domain has a publisher, and problems of topics."""
        with self._lock:
            if not self._writers_of:
                return Health(is_connected=False, problem=self._problem)
            notes = [f"{name} is published as {other}, too" for name, other in sorted(self._other_types.items())]
        return Health(is_connected=True, problem="; ".join(notes))

    def offer(self, name: str, type_name: str, *, definition: str, type_hash: str, is_latched: bool) -> None:
        """Announce a topic of ours: reliable, and latched for late subscribers if asked."""
        del definition, type_hash
        with self._lock:
            self._offers[name] = (type_name, is_latched)

    def send(self, name: str, data: bytes) -> bool:
        """Publish a message of an offered topic; False if nobody subscribes and the topic is not latched."""
        with self._lock:
            writer = self._writers.get(name)
            if writer is None:
                return False
            is_heard = self._offers[name][1] or bool(writer.get_matched_subscriptions())
            return dds.write(writer, data) and is_heard

    def listen(self, name: str, hear: Callable[[bytes], None]) -> None:
        """Call `hear` with each message of a topic."""
        with self._lock:
            self._listeners[name] = hear
            self._wanted.add(name)

    def _run(self, inbox: Inbox) -> None:
        from cyclonedds.core import DDSException

        while not self._stopped.is_set():
            try:
                self._receive(inbox)
            except DDSException as error:
                self._problem = f"Cyclone DDS cannot use the interface {self._interface} ({error.msg})"
            self._stopped.wait(_AGAIN_S)

    def _receive(self, inbox: Inbox) -> None:
        from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
        from cyclonedds.core import WaitSet
        from cyclonedds.util import duration

        domain, member = dds.participant(self._domain, dds.settings(self._interface, self._peers))
        self._problem = f"nobody publishes in domain {self._domain}: {', '.join(self._peers)} over {self._interface}"
        publications = BuiltinDataReader(member, BuiltinTopicDcpsPublication)
        waiting = WaitSet(member)
        own = str(member.guid)[:23]
        try:
            while not self._stopped.is_set():
                for endpoint in publications.take(100):
                    self._endpoint(inbox, endpoint, own)
                self._declare(member, waiting)
                waiting.wait(duration(milliseconds=_WAIT_MS))
                with self._lock:
                    readers = list(self._readers.items())
                for name, reader in readers:
                    for data in dds.taken(reader):
                        if name in self._listeners:
                            self._listeners[name](data)
                        else:
                            inbox.put(name, data)
        finally:
            with self._lock:
                self._conditions.clear()
                self._readers.clear()
                self._writers.clear()
                gone, self._writers_of = {name for name, _ in self._writers_of.values()}, {}
            for name in gone:
                inbox.withdraw(name)
            del publications, waiting, member, domain

    def _endpoint(self, inbox: Inbox, endpoint: Any, own: str) -> None:
        from cyclonedds.core import InstanceState

        key = str(endpoint.key)
        if endpoint.sample_info.instance_state != InstanceState.Alive:
            with self._lock:
                name, _ = self._writers_of.pop(key, ("", ""))
                is_gone = name and name not in {other for other, _ in self._writers_of.values()}
            if is_gone:
                inbox.withdraw(name)
            return
        type_name = dds.ros_type(endpoint.type_name)
        if not endpoint.topic_name.startswith("rt/") or type_name is None or key.startswith(own):
            return
        name = endpoint.topic_name.removeprefix("rt")
        is_reliable, is_latched = _offered(endpoint.qos)
        with self._lock:
            self._writers_of[key] = (name, type_name)
            known, _, _ = self._types.setdefault(name, (type_name, is_reliable, is_latched))
            if known != type_name:
                self._other_types[name] = type_name
                return
        if name not in self._listeners:
            inbox.announce(Topic(name=name, type_name=type_name))

    def _declare(self, member: Any, waiting: Any) -> None:
        from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState
        from cyclonedds.pub import DataWriter
        from cyclonedds.sub import DataReader

        with self._lock:
            for name in sorted(self._wanted & self._types.keys() - self._readers.keys()):
                type_name, is_reliable, is_latched = self._types[name]
                kind = dds.qos(is_reliable=is_reliable, is_latched=is_latched)
                reader = self._readers[name] = DataReader(member, dds.topic_of(member, name, type_name), qos=kind)
                condition = ReadCondition(reader, SampleState.Any | ViewState.Any | InstanceState.Any)
                waiting.attach(condition)
                self._conditions.append(condition)
            for name, (type_name, is_latched) in self._offers.items():
                if name not in self._writers:
                    kind = dds.qos(is_reliable=True, is_latched=is_latched, depth=1 if is_latched else 10)
                    self._writers[name] = DataWriter(member, dds.topic_of(member, name, type_name), qos=kind)


def _offered(kind: Any) -> tuple[bool, bool]:
    from cyclonedds.core import Policy

    return (
        isinstance(kind[Policy.Reliability], Policy.Reliability.Reliable),
        kind[Policy.Durability] == Policy.Durability.TransientLocal,
    )
