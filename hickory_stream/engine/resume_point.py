"""The state from which an interrupted run resumes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hickory_stream.engine.reading import Position
    from hickory_stream.engine.step import FramePose, OpenJob, Step
    from hickory_stream.mapping.core import MapperCore


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ResumePoint:
    """The state of an interrupted run, from its journal: the core, the last step, and the pending shape jobs."""

    core: MapperCore
    step: Step
    position: Position
    open_jobs: tuple[OpenJob, ...]
    mesh_names: tuple[str, ...]
    last_frame: FramePose
