"""Messages of a robot's process to its fleet, beside the maps."""

from dataclasses import dataclass
from typing import TypeAlias

from hickory_stream.engine.modes import Progress
from hickory_stream.fleet.growth import GrownMap

Message: TypeAlias = "Opened | Moved | GrownMap | Ended"


@dataclass(frozen=True, kw_only=True, slots=True)
class Opened:
    """The played streams, one a line."""

    text: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class Moved:
    """Progress of the robot's run."""

    progress: Progress


@dataclass(frozen=True, kw_only=True, slots=True)
class Ended:
    """End of a robot's run."""

    is_finished: bool
    was_stopped: bool = False
    #: why there is no complete map, "" for a finished one
    reason: str = ""
    digest: str | None = None
    #: stamp of the first frame; `end_ns` of the last
    start_ns: int | None = None
    end_ns: int | None = None
    #: losses
    notes: tuple[str, ...] = ()
