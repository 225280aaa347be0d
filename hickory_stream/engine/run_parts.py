"""The input of a run, as one record."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from hickory_stream.config import MapperConfig
    from hickory_stream.engine.history.resume_point import ResumePoint
    from hickory_stream.engine.journal_writer import JournalWriter
    from hickory_stream.engine.map_folder import MapFolder
    from hickory_stream.engine.modes import Mode
    from hickory_stream.engine.run_progress import Progress
    from hickory_stream.engine.sink_threads import SinkThread
    from hickory_stream.engine.workers import ShapeWorkers
    from hickory_stream.mapping.core import MapperCore
    from hickory_stream.ports import FeatureExtractor, Segmenter, Source
    from hickory_stream.records import MapSnapshot


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RunParts:
    """The source, the components that map it, the destination of the map, and the receivers of snapshots and progress.

    `resumes` is the state of an interrupted run that this one continues, with its core. `rehearse` has
    perception and core process a made-up scene before the first frame is read, which then takes no longer than others.
    """

    config: MapperConfig
    mode: Mode
    source: Source
    core: MapperCore
    segmenter: Segmenter
    extractor: FeatureExtractor
    workers: ShapeWorkers
    folder: MapFolder
    journal: JournalWriter
    sinks: Sequence[SinkThread]
    publish: Callable[[MapSnapshot], None]
    progress: Callable[[Progress], None]
    resumes: ResumePoint | None = None
    rehearse: Callable[[], None] | None = None
