"""What every live route has in common: it announces topics, puts messages into an inbox, and says how it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from players.live.inbox import Inbox


@dataclass(frozen=True, kw_only=True, slots=True)
class Health:
    """Whether a route is open, and what the operator should know about it ("" where nothing)."""

    is_connected: bool
    problem: str = ""


class LiveSource(Protocol):
    """A route by which messages arrive. Its threads, if it has any, are its own affair."""

    @property
    def uri(self) -> str:
        """How it was asked for."""
        ...

    @property
    def kind(self) -> str:
        """What it is, in words."""
        ...

    def start(self, inbox: Inbox) -> None:
        """Begin to announce topics; a peer that does not answer yet is tried again and again, and is no error.

        Raises:
            RecordingError: the address can never be one.
        """
        ...

    def subscribe(self, names: Collection[str]) -> None:
        """Ask for the messages of more topics, those before us that are kept for late comers included.

        A route that is sent everything ignores it.
        """
        ...

    def health(self) -> Health:
        """Return how the route is now."""
        ...

    def stop(self) -> None:
        """End it; nothing arrives afterwards."""
        ...


@runtime_checkable
class ReturnLink(Protocol):
    """An ability of a route: it can publish to the robot. `send` may take long, and never raises."""

    def offer(self, name: str, type_name: str, *, definition: str, type_hash: str, is_latched: bool) -> None:
        """Announce a topic (messages are CDR), now and whenever the link comes back; the last latched one is kept."""
        ...

    def send(self, name: str, data: bytes) -> bool:
        """Publish a message of an offered topic; return False where nobody is there to take it."""
        ...

    def listen(self, name: str, hear: Callable[[bytes], None]) -> None:
        """Have what is published under a name handed over as it comes, on a thread of the link's."""
        ...
