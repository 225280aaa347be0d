"""What the process of a robot sends to its fleet, beside the maps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from hickory_stream.engine.modes import Progress
    from hickory_stream.fleet.growth import GrownMap

    Message: TypeAlias = "Opened | Moved | GrownMap | Ended"


@dataclass(frozen=True, kw_only=True, slots=True)
class Opened:
    """What is played, in a line for each stream."""

    text: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class Moved:
    """How far the robot's run is."""

    progress: Progress


@dataclass(frozen=True, kw_only=True, slots=True)
class Ended:
    """How a robot's run ended.

    `reason` says why there is no map, or none to its end, "" where it is finished; `digest` is the map's. `start_ns`
    and `end_ns` are the stamps of the first and the last frame that was seen. `notes` say what was lost.
    """

    is_finished: bool
    was_stopped: bool = False
    reason: str = ""
    digest: str | None = None
    start_ns: int | None = None
    end_ns: int | None = None
    notes: tuple[str, ...] = ()
