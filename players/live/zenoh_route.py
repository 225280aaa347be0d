"""ROS 2 over Zenoh: a client of zenoh-bridge-ros2dds or rmw_zenoh.

A client neither listens nor scouts: it connects to the named address, or to this machine.
"""

import re
import struct
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Collection
from typing import Any

from hickory_stream.base.json_text import dumps
from hickory_stream.errors import RecordingError
from players.live import zenoh_keys
from players.live.inbox import Inbox
from players.live.transport import Health, ThreadedRoute
from players.live.zenoh_return import ZenohReturn
from players.logs.containers import Topic

_PORT = 7447
_AGAIN_S = 0.5
_OPEN_MS = 3000
_TOKENLESS_S = 3.0
_ADDRESS = re.compile(r"zenoh://(?P<host>\[[^]]+\]|[^:/]*)(?::(?P<port>\d+))?(?:/(?P<namespace>.*))?")
_JOINED_S = 2.0
_ATTACHMENT = struct.Struct("<qqB16s")


class ZenohRoute(ThreadedRoute):
    """The `LiveSource` of `zenoh://HOST[:PORT][/NAMESPACE]`."""

    kind, thread_name, patience_s = "ROS 2 over Zenoh", "zenoh-connect", 12.0

    def __init__(self, uri: str) -> None:
        """Parse the address. Raises `RecordingError`: it is none."""
        found = _ADDRESS.fullmatch(uri)
        if found is None or not 0 < int(found["port"] or _PORT) < 65536:
            raise RecordingError(
                f"found {uri}, expected zenoh://HOST[:{_PORT}][/NAMESPACE]; without a HOST, this machine"
            )
        super().__init__(uri, "")
        self._peer = f"{found['host'] or '127.0.0.1'}:{found['port'] or _PORT}"
        self._namespace = (found["namespace"] or "").strip("/")
        self._inbox: Inbox | None = None
        self._session: Any = None
        self._problem = f"{self._peer} was not reached yet"
        self._lock = threading.RLock()
        self._publications: dict[str, zenoh_keys.Publication] = {}
        self._tokens: defaultdict[str, set[str]] = defaultdict(set)
        self._other_types: dict[str, str] = {}
        self._wanted: set[str] = set()
        self._declared: dict[str, list[Any]] = {}
        self._watching: list[Any] = []
        self._listening: list[Any] = []
        self._sequences: dict[tuple[str, bytes], int] = {}
        self._return = ZenohReturn(self._namespace)

    def start(self, inbox: Inbox) -> None:
        """Connect in a separate thread, with retries; Zenoh itself reconnects later."""
        self._inbox = inbox
        super().start(inbox)

    def subscribe(self, names: Collection[str]) -> None:
        """Subscribe to topics, with earlier messages of latched ones."""
        with self._lock:
            self._wanted |= set(names)
            self._declare_wanted()

    def health(self) -> Health:
        """Return whether a router or a peer is connected, and problems of topics."""
        session = self._session
        if session is None:
            return Health(is_connected=False, problem=self._problem)
        if not (session.info.routers_zid() or session.info.peers_zid()):
            return Health(is_connected=False, problem=f"the connection to {self._peer} is lost; it is tried again")
        with self._lock:
            notes = [f"{name} is published as {other}, too" for name, other in sorted(self._other_types.items())]
            if not self._publications:
                where = f" in the namespace {self._namespace}" if self._namespace else ""
                notes.append(f"nobody there publishes a ROS topic{where}: is the bridge's or rmw_zenoh's domain right?")
        return Health(is_connected=True, problem="; ".join(notes))

    def stop(self) -> None:
        """Close the session."""
        super().stop()
        session, self._session = self._session, None
        if session is not None:
            self._problem = "closed"
            with self._lock:
                declared = [
                    *self._watching,
                    *self._listening,
                    *(one for made in self._declared.values() for one in made),
                ]
                self._watching, self._listening, self._declared = [], [], {}
            callers = _callback_threads()
            for one in declared:
                one.undeclare()
            self._return.detach()
            session.close()
            # A daemon thread that ends while Python does aborts the process: Rust is on its stack.
            ends_s = time.monotonic() + _JOINED_S
            for thread in callers:
                thread.join(max(0.0, ends_s - time.monotonic()))

    def offer(self, name: str, type_name: str, *, definition: str, type_hash: str, is_latched: bool) -> None:
        """Announce a topic of ours; ROS 2 over Zenoh sends no definitions."""
        del definition
        self._return.offer(name, type_name, type_hash=type_hash, is_latched=is_latched)

    def send(self, name: str, data: bytes) -> bool:
        """Publish a message of an offered topic; False while the robot is away or nobody listens."""
        return self._return.send(name, data)

    def listen(self, name: str, hear: Callable[[bytes], None]) -> None:
        """Call `hear` with each message of a topic."""
        self._return.listen(name, hear)

    def _run(self, inbox: Inbox) -> None:
        import zenoh

        zenoh.init_log_from_env_or("off")
        config = zenoh.Config()
        for key, value in (
            ("mode", "client"),
            ("connect/endpoints", [f"tcp/{self._peer}"]),
            ("listen/endpoints", []),
            ("scouting/multicast/enabled", False),
            ("scouting/gossip/enabled", False),
            # What is latched of ours is kept under its time.
            ("timestamping/enabled", True),
            ("transport/unicast/open_timeout", _OPEN_MS),
            ("connect/retry", {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 1.5}),
        ):
            config.insert_json5(key, dumps(value))
        while not self._stopped.is_set():
            try:
                session = zenoh.open(config)
            except zenoh.ZError:
                self._problem = f"{self._peer} does not answer as a Zenoh router or bridge (tcp, usually port {_PORT})"
                self._stopped.wait(_AGAIN_S)
                continue
            with self._lock:
                self._session = session
                liveliness = session.liveliness()
            self._watching = [
                liveliness.declare_subscriber(tokens, self._on_token, history=True) for tokens in zenoh_keys.TOKENS
            ]
            if not self._stopped.wait(_TOKENLESS_S):
                self._listen_to_keys()
            return

    def _listen_to_keys(self) -> None:
        with self._lock:
            if not self._publications and not self._wanted:
                self._listening = [
                    self._session.declare_subscriber(keys, self._on_key) for keys in zenoh_keys.HASHED_KEYS
                ]

    def _on_token(self, sample: Any) -> None:
        import zenoh

        token = str(sample.key_expr)
        if self._session is not None and str(self._session.zid()) in token.split("/"):
            return  # one of ours
        publication = zenoh_keys.publication_of_token(token)
        if publication is None:
            return
        name = zenoh_keys.within(publication, self._namespace)
        if name is None:
            return
        assert self._inbox is not None
        if sample.kind == zenoh.SampleKind.DELETE:
            with self._lock:
                self._tokens[name].discard(token)
                is_gone = not self._tokens[name]
            if is_gone:
                self._inbox.withdraw(name)
            return
        with self._lock:
            self._tokens[name].add(token)
        self._learn(name, publication)

    def _on_key(self, sample: Any) -> None:
        publication = zenoh_keys.publication_of_key(str(sample.key_expr))
        name = zenoh_keys.within(publication, self._namespace) if publication is not None else None
        if publication is not None and name is not None:
            self._learn(name, publication)

    def _learn(self, name: str, publication: zenoh_keys.Publication) -> None:
        assert self._inbox is not None
        with self._lock:
            known = self._publications.setdefault(name, publication)
            if known.type_name != publication.type_name:
                self._other_types[name] = publication.type_name
                return
        self._inbox.announce(Topic(name=name, type_name=publication.type_name))
        with self._lock:
            self._declare_wanted()
            session = self._session
        if session is not None:
            self._return.attach(session, publication)

    def _declare_wanted(self) -> None:
        # Called with the lock.
        if self._session is None or not self._wanted:
            return
        import zenoh

        for subscriber in self._listening:
            subscriber.undeclare()
        self._listening = []
        for name in sorted(self._wanted & self._publications.keys() - self._declared.keys()):
            publication = self._publications[name]
            self._declared[name] = declared = []

            def take(sample: Any, name: str = name) -> None:
                self._take(name, sample)

            if publication.is_latched:
                history = zenoh.ext.HistoryConfig(detect_late_publishers=True)
                declared.append(
                    zenoh.ext.declare_advanced_subscriber(self._session, publication.key, take, history=history)
                )
                self._ask_cache(publication, name)
            else:
                declared.append(self._session.declare_subscriber(publication.key, take))
            token = zenoh_keys.own_token(publication, str(self._session.zid()), len(self._declared), "MS")
            if token is not None:
                declared.append(self._session.liveliness().declare_token(token))

    def _ask_cache(self, publication: zenoh_keys.Publication, name: str) -> None:
        # Bridges before 1.5 have no advanced publishers, but answer queries.
        if publication.layout != "bridge":
            return

        def answered(reply: Any) -> None:
            if reply.ok is not None:
                self._take(name, reply.ok)

        self._session.get(f"@/*/@ros2_pub_cache/{publication.key}?_anyke", answered)

    def _take(self, name: str, sample: Any) -> None:
        assert self._inbox is not None
        publication = self._publications[name]
        if publication.layout == "rmw":
            found = zenoh_keys.publication_of_key(str(sample.key_expr))
            if found is not None and found.type_name != publication.type_name:
                self._inbox.refuse(name, "other_type")
                return
            self._count_lost(name, sample.attachment)
        self._inbox.put(name, sample.payload.to_bytes())

    def _count_lost(self, name: str, attachment: Any) -> None:
        # A late message fills a gap in the sequence numbers of rmw_zenoh.
        if attachment is None or len(data := attachment.to_bytes()) != _ATTACHMENT.size:
            return
        sequence, _, _, publisher = _ATTACHMENT.unpack(data)
        assert self._inbox is not None
        with self._lock:
            last = self._sequences.get((name, publisher))
            self._sequences[name, publisher] = sequence if last is None else max(last, sequence)
        if last is not None and sequence > last + 1:
            self._inbox.lost(name, sequence - last - 1)
        elif last is not None and sequence < last:
            self._inbox.found(name)


def _callback_threads() -> list[threading.Thread]:
    # Zenoh (1.10) calls from one thread a subscriber, a daemon if a daemon declared the subscriber, as here. They end
    # once nothing is declared, and nothing else joins them.
    own = threading.current_thread()
    return [
        thread
        for thread in threading.enumerate()
        if thread.daemon and "pyo3-closure" in thread.name and thread is not own
    ]
