"""A step of a run: the events that are committed together, and where the run then stood.

A step is whole or absent in the journal. A step of kind CLOSING was committed ahead of its time because the run was
stopped: it belongs to the map that was saved, not to the one that `resume` continues.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

from hickory_stream.geometry.arrays import freeze

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from numpy.typing import NDArray

    from hickory_stream.events import Event
    from hickory_stream.geometry.camera import Camera
    from hickory_stream.records import Decision


class StepKind(StrEnum):
    """What a step ends with: a keyframe, the end of the source or a shape after it, or a stop."""

    KEYFRAME = "keyframe"
    ENDED = "ended"
    CLOSING = "closing"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FramePose:
    """The raw pose of a frame, as the source gave it; kept for every frame, whatever is corrected later."""

    index: int
    stamp_ns: int
    world_from_camera: NDArray[np.float64]

    def __post_init__(self) -> None:
        freeze(self, "world_from_camera", "f8", (4, 4))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Step:
    """One entry of the journal.

    `frames` are those that were read since the last step, the keyframe among them last; `round_index` and `first_index`
    the round of the log and the index of its first frame, `first_ns` the stamp of the first of all. `num_frames`,
    `num_keyframes` and the `counts` are totals.
    `metrics` are the numbers of the report, e.g. seconds per stage. `camera` is that of the frames. `goes_back_to`: the
    log was sought back in, and the core is that of so many steps again, without the `lost_views`; then came the events.
    `num_seeks` is how often somebody sought so far, back or ahead.
    """

    kind: StepKind
    stamp_ns: int
    camera: Camera
    frames: tuple[FramePose, ...]
    round_index: int
    first_index: int
    first_ns: int
    num_frames: int
    num_keyframes: int
    counts: Mapping[str, int]
    shape_counts: Mapping[str, int]
    metrics: tuple[tuple[str, float], ...] = ()
    goes_back_to: int | None = None
    lost_views: tuple[str, ...] = ()
    num_seeks: int = 0


@dataclass(frozen=True, kw_only=True, slots=True)
class OpenJob:
    """A shape job whose result is still to be committed."""

    ticket: int
    object_id: int
    due_ns: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Told:
    """What the core said of a step: its decisions, and the submap that was open then.

    The events alone decide the map; this is for people who ask why, without going through the run again, and as it was
    decided then, whatever a later version would decide.
    """

    decisions: tuple[Decision, ...]
    submap_id: int


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class JournalEntry:
    """A step with its events, in the order in which the core was given them; `told` is None in older journals."""

    step: Step
    events: tuple[Event, ...]
    told: Told | None = None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Checkpoint:
    """The state of the core after a step, by the names of its fields, and the jobs that are open then."""

    core: Mapping[str, object]
    open_jobs: tuple[OpenJob, ...]
