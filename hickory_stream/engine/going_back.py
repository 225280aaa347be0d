"""Going back in a log that is being played: the map as it was known then, from the run's own journal.

What has happened since stays in the journal, so that it can be looked at; the step after it says which steps the core
went on from. Numbers of objects and jobs are not given out twice.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from hickory_stream.engine.history import Replay
from hickory_stream.engine.journal import Journal
from hickory_stream.engine.time_travel import step_at
from hickory_stream.events import ShapeFailed, ShapeReady

if TYPE_CHECKING:
    from hickory_stream.engine.session import MapFolder
    from hickory_stream.engine.step import OpenJob
    from hickory_stream.mapping.core import MapperCore
    from hickory_stream.mapping.mapping_config import MappingConfig

Answer = ShapeReady | ShapeFailed


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class WentBack:
    """The core to go on with.

    `num_steps` are those of the journal that it has gone through. `open_jobs` waited for their results then; `answers`
    are those that came since, by their tickets. `lost_views` are the views whose pixels have been removed since; the
    core knows them no more. `unused_views` are those that only what has happened since had kept.
    """

    core: MapperCore
    num_steps: int
    open_jobs: tuple[OpenJob, ...]
    answers: dict[int, Answer]
    lost_views: tuple[str, ...]
    unused_views: tuple[str, ...]


def known_before(folder: MapFolder, config: MappingConfig, stamp_ns: int, now: MapperCore) -> WentBack:
    """Return the core as it was before a stamp, with the numbers that `now` would give out next.

    Raises:
        MapFolderError: the journal is damaged.
    """
    with Journal(folder.path) as journal:
        index = step_at(journal.stamps_ns, stamp_ns - 1)
        replay = Replay(journal, config)
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
    names = replay.core.view_names()
    lost = folder.keep_views(names)
    return WentBack(
        core=replay.core.going_on_after(now, lost),
        num_steps=replay.num_steps,
        open_jobs=tuple(replay.open_jobs.values()),
        answers=answers,
        lost_views=tuple(sorted(lost)),
        unused_views=tuple(sorted(now.view_names() - names)),
    )
