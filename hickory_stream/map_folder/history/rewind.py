"""Rewind of a playback: the core's state at an earlier stamp, from the run's own journal.

Later steps stay in the journal for inspection; the next step records where the core continues. Ids are not reused.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from hickory_stream.events import ShapeFailed, ShapeReady
from hickory_stream.journal.reader import Journal
from hickory_stream.map_folder.history.core_replay import Replay
from hickory_stream.map_folder.history.registration_history import RegistrationHistory, registration_history
from hickory_stream.map_folder.history.time_travel import step_at
from hickory_stream.poses.keyframe_registration import NUM_RECENT

if TYPE_CHECKING:
    from hickory_stream.config import MapperConfig
    from hickory_stream.journal.step import OpenJob
    from hickory_stream.map_folder.writer import MapFolder
    from hickory_stream.mapping.core import MapperCore

Answer = ShapeReady | ShapeFailed


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Rewound:
    """The restored core."""

    core: MapperCore
    #: Journal steps in its state.
    num_steps: int
    #: Shape jobs that were pending then.
    open_jobs: tuple[OpenJob, ...]
    #: Results of these jobs since then, by ticket.
    answers: dict[int, Answer]
    #: Views of that state whose pixels were deleted since; the core is without them.
    lost_views: tuple[str, ...]
    #: Views that only later steps had kept.
    unused_views: tuple[str, ...]
    #: None without registered keyframes.
    registration: RegistrationHistory | None = None


def rewound_to(folder: MapFolder, config: MapperConfig, stamp_ns: int, now: MapperCore) -> Rewound:
    """Return the core before a stamp; its next ids are those of the core `now`.

    Raises `MapFolderError`: a damaged journal.
    """
    with Journal(folder.path) as journal:
        index = step_at(journal.stamps_ns, stamp_ns - 1)
        replay = Replay(journal, config.mapping)
        if index is not None:
            replay.seek(index)
        wanted = set(replay.open_jobs)
        answers = {}
        for later in range(replay.num_steps, len(journal)):
            for kind in ("ShapeReady", "ShapeFailed") if wanted else ():
                for event in journal.events(later, kind):
                    assert isinstance(event, ShapeReady | ShapeFailed)
                    if event.ticket in wanted:
                        answers[event.ticket] = event
        registration = registration_history(journal, replay.num_steps, num_recent=NUM_RECENT)
    names = replay.core.view_names()
    lost = folder.keep_views(names)
    return Rewound(
        core=replay.core.going_on_after(now, lost),
        num_steps=replay.num_steps,
        open_jobs=tuple(replay.open_jobs.values()),
        answers=answers,
        lost_views=tuple(sorted(lost)),
        unused_views=tuple(sorted(now.view_names() - names)),
        registration=registration,
    )
