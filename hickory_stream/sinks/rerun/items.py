"""Log items, independent of the stream that they are written to.

Heavy items may be left out when space or time runs short. Lasting items (a cloud) matter until the next one comes;
others (an image, a plot value) only for their moment.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import timedelta
from enum import Enum, auto
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.records import FrameReport

LOG_TIME, FRAME, KEYFRAME = "log_time", "frame", "keyframe"


class Weight(Enum):
    """Cost of an item."""

    LIGHT = auto()
    HEAVY = auto()


class Span(Enum):
    """Duration of an item: its moment, until its entity is logged again, or always (static)."""

    MOMENT = auto()
    LASTING = auto()
    STATIC = auto()


@dataclass(frozen=True, kw_only=True, slots=True)
class Moment:
    """A place on the three timelines; `keyframe` is None between keyframes."""

    stamp_ns: int
    frame: int
    keyframe: int | None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LogItem:
    """Rerun archetypes for one entity; `is_clear` empties the entity and everything below it."""

    path: str
    archetypes: tuple[Any, ...]
    weight: Weight = Weight.LIGHT
    span: Span = Span.MOMENT
    is_clear: bool = False

    @property
    def key(self) -> tuple[str, str]:
        """What a later item replaces: a pose, for example, leaves the mesh of its entity."""
        return self.path, type(self.archetypes[0]).__name__


def clear_item(path: str) -> LogItem:
    """Return the item that empties an entity and everything below it."""
    import rerun as rr

    return LogItem(path=path, archetypes=(rr.Clear(recursive=True),), span=Span.LASTING, is_clear=True)


def pose_item(path: str, pose: NDArray[np.float64]) -> LogItem:
    """Return the item that places an entity, with what was logged there, at a pose (4, 4) in its parent."""
    import rerun as rr

    placed = rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3])
    return LogItem(path=path, archetypes=(placed,), span=Span.LASTING)


def moment_of(report: FrameReport) -> Moment:
    """Return the moment of a report."""
    return Moment(stamp_ns=report.stamp_ns, frame=report.index, keyframe=report.keyframe_index)


def emit(stream: Any, moment: Moment, items: Iterable[LogItem]) -> None:
    """Log items to a RecordingStream; sets every timeline, since Rerun's time is sticky per thread."""
    stream.reset_time()
    # A float of epoch seconds would lose some 100 ns.
    stream.set_time(LOG_TIME, timestamp=np.datetime64(moment.stamp_ns, "ns"))
    stream.set_time(FRAME, sequence=moment.frame)
    if moment.keyframe is not None:
        stream.set_time(KEYFRAME, sequence=moment.keyframe)
    for item in items:
        stream.log(item.path, *item.archetypes, static=item.span is Span.STATIC)


def new_stream(recording_id: str, *, batch_s: float | None = None) -> Any:
    """Return a RecordingStream without the SDK's timelines; `batch_s` overrides its batching time of 0.2 s."""
    import rerun as rr

    batching = rr.ChunkBatcherConfig()
    if batch_s is not None:
        batching.flush_tick = timedelta(seconds=batch_s)
    stream = rr.RecordingStream(
        "hickory_stream", recording_id=recording_id, send_properties=False, batcher_config=batching
    )
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    return stream
