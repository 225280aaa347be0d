"""Interface of live routes: they announce topics, put messages into an inbox, and report their health."""

import threading
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from players.live.inbox import Inbox


@dataclass(frozen=True, kw_only=True, slots=True)
class Health:
    """Whether a route is connected, and a problem for the operator, or ""."""

    is_connected: bool
    problem: str = ""


class LiveSource(Protocol):
    """A route by which messages arrive; its threads are its own."""

    @property
    def uri(self) -> str:
        """The address."""

    @property
    def kind(self) -> str:
        """The kind of route, in words."""

    def start(self, inbox: Inbox) -> None:
        """Begin to announce topics; an absent peer is retried. Raises `RecordingError`: the address is impossible."""

    def subscribe(self, names: Collection[str]) -> None:
        """Subscribe to more topics, latched messages included; a route that receives everything ignores it."""

    def health(self) -> Health:
        """Return the current health."""

    def stop(self) -> None:
        """Close the route; nothing arrives afterwards."""


class ThreadedRoute:
    """A `LiveSource` that receives in one thread, `_run(inbox)`, until it is stopped; all topics come unasked."""

    #: Of the thread, and how long `stop` waits for its end.
    thread_name, patience_s = "", 10.0

    def __init__(self, uri: str, problem: str) -> None:
        self.uri = uri
        self._stopped = threading.Event()
        self._thread: threading.Thread | None = None
        self._health = Health(is_connected=False, problem=problem)

    def start(self, inbox: Inbox) -> None:
        """Receive in a separate thread."""
        self._thread = threading.Thread(target=self._run, args=(inbox,), name=self.thread_name, daemon=True)
        self._thread.start()

    def subscribe(self, names: Collection[str]) -> None:
        """Do nothing: everything is sent."""

    def health(self) -> Health:
        """Return the current health."""
        return self._health

    def stop(self) -> None:
        """Close the route."""
        self._stopped.set()
        if self._thread is not None:
            self._thread.join(self.patience_s)

    def _run(self, inbox: Inbox) -> None:
        raise NotImplementedError


@runtime_checkable
class ReturnLink(Protocol):
    """A route that can publish to the robot; `send` may take long, and never raises."""

    def offer(self, name: str, type_name: str, *, definition: str, type_hash: str, is_latched: bool) -> None:
        """Announce a topic (messages are CDR) whenever the link is up; the last latched message is kept."""

    def send(self, name: str, data: bytes) -> bool:
        """Publish a message of an offered topic; return False if nobody receives it."""

    def listen(self, name: str, hear: Callable[[bytes], None]) -> None:
        """Call `hear`, on a thread of the link, with each message of a topic."""
