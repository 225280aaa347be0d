"""The way back over Zenoh: our topics in the robot's layout, and its messages for us."""

import struct
import threading
import time
import uuid
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from players.live.zenoh_keys import Publication, own_token, publication_like, publishing_key

_ATTACHMENT = struct.Struct("<qqB16s")


@dataclass(frozen=True, kw_only=True, slots=True)
class _Offer:
    type_name: str
    type_hash: str
    is_latched: bool


class ZenohReturn:
    """Publishes and listens once the layout of the robot's topics is known."""

    def __init__(self, namespace: str) -> None:
        self._namespace = namespace
        self._lock = threading.RLock()
        self._session: Any = None
        self._like: Publication | None = None
        self._offers: dict[str, _Offer] = {}
        self._publishers: dict[str, Any] = {}
        self._listeners: dict[str, Callable[[bytes], None]] = {}
        self._declared: dict[str, Any] = {}
        self._tokens: list[Any] = []
        self._sent: Counter[str] = Counter()
        self._gid = uuid.uuid4().bytes

    def attach(self, session: Any, like: Publication) -> None:
        """Begin to publish in the layout of `like`."""
        with self._lock:
            if self._like is None:
                self._session, self._like = session, like
                self._declare()

    def detach(self) -> None:
        """Stop publishing, before the session is closed."""
        with self._lock:
            self._session = self._like = None
            declared = [*self._publishers.values(), *self._declared.values(), *self._tokens]
            self._publishers.clear()
            self._declared.clear()
            self._tokens.clear()
        for one in declared:
            one.undeclare()

    def offer(self, name: str, type_name: str, *, type_hash: str, is_latched: bool) -> None:
        """Announce a topic."""
        with self._lock:
            self._offers[name] = _Offer(type_name=type_name, type_hash=type_hash, is_latched=is_latched)
            self._declare()

    def listen(self, name: str, hear: Callable[[bytes], None]) -> None:
        """Call `hear` with each message of a topic."""
        with self._lock:
            self._listeners[name] = hear
            self._declare()

    def send(self, name: str, data: bytes) -> bool:
        """Publish a message; False while no robot is there."""
        import zenoh

        with self._lock:
            publisher, session, like = self._publishers.get(name), self._session, self._like
            is_latched = name in self._offers and self._offers[name].is_latched
            self._sent[name] += publisher is not None
            number = self._sent[name]
        if publisher is None or session is None or like is None:
            return False
        try:
            if not (session.info.routers_zid() or session.info.peers_zid()):
                return False
            attachment = _ATTACHMENT.pack(number, time.time_ns(), 16, self._gid) if like.layout == "rmw" else None
            publisher.put(data, attachment=attachment)
            return is_latched or like.layout == "bridge" or bool(publisher.matching_status.matching)
        except zenoh.ZError:
            return False

    def _declare(self) -> None:
        # Called with the lock.
        if self._session is None or self._like is None:
            return
        import zenoh

        for name, offer in self._offers.items():
            if name in self._publishers:
                continue
            ours = self._ours(name, offer)
            key = publishing_key(ours)
            block, elsewhere = zenoh.CongestionControl.BLOCK, zenoh.Locality.REMOTE
            if offer.is_latched:
                self._publishers[name] = zenoh.ext.declare_advanced_publisher(
                    self._session,
                    key,
                    congestion_control=block,
                    allowed_destination=elsewhere,
                    cache=zenoh.ext.CacheConfig(max_samples=1),
                    publisher_detection=True,
                )
            else:
                self._publishers[name] = self._session.declare_publisher(
                    key, congestion_control=block, allowed_destination=elsewhere
                )
            self._announce(ours, "MP")
        for name, hear in self._listeners.items():
            if name not in self._declared:
                key = self._ours(name, _Offer(type_name="", type_hash="", is_latched=False)).key
                self._declared[name] = self._session.declare_subscriber(key, partial(_hand_over, hear))

    def _announce(self, ours: Publication, kind: Any) -> None:
        # Our own entities are numbered apart from those of the subscriptions.
        token = own_token(ours, str(self._session.zid()), 1000 + len(self._tokens), kind)
        if token is not None:
            self._tokens.append(self._session.liveliness().declare_token(token))

    def _ours(self, name: str, offer: _Offer) -> Publication:
        assert self._like is not None
        named = {"namespace": self._namespace, "type_hash": offer.type_hash}
        return publication_like(self._like, name, offer.type_name, **named, is_latched=offer.is_latched)


def _hand_over(hear: Callable[[bytes], None], sample: Any) -> None:
    hear(sample.payload.to_bytes())
