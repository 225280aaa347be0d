"""A step of a run: events that are committed together, and the position of the run.

A step is whole or absent in the journal. A step of kind CLOSING was committed early because the run was stopped: it
belongs to the saved map, not to the one that `resume` continues.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from hickory_stream.events import Event
from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.camera import Camera
from hickory_stream.records import Decision


class StepKind(StrEnum):
    """The end of a step: a keyframe, the end of the source or a shape after it, or a stop."""

    KEYFRAME = "keyframe"
    ENDED = "ended"
    CLOSING = "closing"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FramePose:
    """The raw pose of a frame, as the source gave it; kept for every frame."""

    index: int
    stamp_ns: int
    world_from_camera: NDArray[np.float64]

    def __post_init__(self) -> None:
        freeze(self, "world_from_camera", "f8", (4, 4))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Step:
    """One entry of the journal; `num_frames`, `num_keyframes` and `counts` are totals."""

    kind: StepKind
    stamp_ns: int
    camera: Camera
    #: Read since the last step, the keyframe last.
    frames: tuple[FramePose, ...]
    round_index: int
    #: Index of the first frame of this round of the log.
    first_index: int
    #: Stamp of the first frame of all.
    first_ns: int
    num_frames: int
    num_keyframes: int
    counts: Mapping[str, int]
    shape_counts: Mapping[str, int]
    #: Numbers of the report, e.g. seconds per stage.
    metrics: tuple[tuple[str, float], ...] = ()
    #: After a seek back, the core is as after so many steps, without the `lost_views`; then come the events.
    goes_back_to: int | None = None
    lost_views: tuple[str, ...] = ()
    #: Seeks so far, back or ahead.
    num_seeks: int = 0


@dataclass(frozen=True, kw_only=True, slots=True)
class OpenJob:
    """A shape job whose result is not committed yet."""

    ticket: int
    object_id: int
    due_ns: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Told:
    """The core's decisions of a step, and the submap that was open then.

    Events alone decide the map; decisions serve people who ask why, without a replay, as this version decided.
    """

    decisions: tuple[Decision, ...]
    submap_id: int


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class JournalEntry:
    """A step with its events in order."""

    step: Step
    events: tuple[Event, ...]
    #: None where nothing was published.
    told: Told | None = None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Checkpoint:
    """The state of the core after a step, by field, and the open jobs."""

    core: Mapping[str, object]
    open_jobs: tuple[OpenJob, ...]
