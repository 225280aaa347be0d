"""The state from which an interrupted run resumes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from hickory_stream.engine.history.core_replay import Replay, mesh_names
from hickory_stream.engine.history.registration_history import registration_history
from hickory_stream.engine.reading import Position
from hickory_stream.engine.step import StepKind
from hickory_stream.mapping.keyframes import Keyframe

if TYPE_CHECKING:
    from hickory_stream.config import MapperConfig
    from hickory_stream.engine.history.registration_history import RegistrationHistory
    from hickory_stream.engine.journal import Journal
    from hickory_stream.engine.step import FramePose, OpenJob, Step
    from hickory_stream.mapping.core import MapperCore


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ResumePoint:
    """The state of an interrupted run, from its journal: the core, the last step, and the pending shape jobs.

    `registration` is what the registration of keyframes knew; None where none was registered.
    """

    core: MapperCore
    step: Step
    position: Position
    open_jobs: tuple[OpenJob, ...]
    mesh_names: tuple[str, ...]
    last_frame: FramePose
    registration: RegistrationHistory | None = None


def resume_point_of(journal: Journal, config: MapperConfig) -> ResumePoint | None:
    """Return the state from which an interrupted run resumes, None if it had not reached its first keyframe.

    Raises:
        MapFolderError: the journal does not fit this version.
    """
    if len(journal) == 0:
        return None
    last = len(journal) - 1
    replay = Replay(journal, config.mapping, reads_later=True)
    replay.seek(last)
    step = journal.step(last)
    frames = step.frames
    index = last
    while not frames:
        index -= 1
        frames = journal.step(index).frames
    is_keyframe = step.kind is StepKind.KEYFRAME
    return ResumePoint(
        core=replay.core,
        step=step,
        position=Position(
            round_index=step.round_index,
            first_index=step.first_index,
            last_index=frames[-1].index,
            keyframe=Keyframe(stamp_ns=frames[-1].stamp_ns, world_from_camera=frames[-1].world_from_camera)
            if is_keyframe
            else None,
            last_ns=frames[-1].stamp_ns,
        ),
        open_jobs=tuple(replay.open_jobs.values()),
        mesh_names=tuple(sorted(mesh_names(journal))),
        last_frame=frames[-1],
        registration=registration_history(journal, len(journal), num_recent=config.registration.num_recent),
    )
