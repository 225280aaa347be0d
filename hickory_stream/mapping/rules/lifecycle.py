"""The life cycle of a track, as a table that the core executes and the documentation prints.

A row says: in these phases, if this event occurs and all guards hold, the track changes to that phase, or ends, with
these effects. The first matching row applies. `steps.ageing` implements guards and effects, by the core's own clock.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from hickory_stream.base.ranges import Ranged, number
from hickory_stream.mapping.entities.track import Track
from hickory_stream.records import DropCause, Phase

# Errors of a segmenter repeat from frame to frame: how long a track was observed says whether it is an object, and the
# number of its sightings nothing beyond that (rates of 917 tracks at 4, 2 and 1.3 keyframes a second). Time without a
# sighting counts up to this.
LONGEST_NS = 1_000_000_000


@dataclass(frozen=True, kw_only=True, slots=True)
class LifecycleConfig(Ranged):
    """The thresholds of the table and of its guards."""

    #: A track that was observed for this long is confirmed. Time counts less where a view leaves its outline open.
    confirm_s: float = number(1.0, 0, 1e9, "s")
    #: How long an unconfirmed track is kept, so that a second visit can confirm it.
    tentative_s: float = number(60.0, 0, 1e9, "s")
    #: A confirmed track that was not seen for this long becomes dormant.
    dormant_s: float = number(4.0, 0, 1e9, "s")
    #: A confirmed track that was not seen for this long is archived.
    archive_s: float = number(60.0, 0, 1e9, "s")
    #: A track is dropped once keyframes have seen through its place for this long since it was last seen.
    phantom_s: float = number(1.0, 0, 1e9, "s")


class LifeEvent(StrEnum):
    """What happens to a track."""

    BORN = "an observation matches no track"
    SPLIT_OFF = "it was seen apart from another track often enough"
    TAKES_IN = "another track is merged into it"
    JUDGED = "a keyframe: comparison with the observed space"
    AGED = "a keyframe: time has passed"
    SOURCE_ENDED = "the source has ended"


class Guard(StrEnum):
    """A condition on a track."""

    SEEN_THROUGH = "not observed, and the keyframe observed free space at its position"
    PHANTOM = "keyframes observed free space at its position for `phantom_s`"
    SURE = "observed for `confirm_s`"
    UNCONFIRMED = "not seen for `tentative_s`"
    DOUBTED = "a keyframe observed free space at its position"
    UNSEEN = "not seen for `dormant_s`"
    LONG_UNSEEN = "not seen for `archive_s`"
    KNOWN_HERE = "seen since the last pose jump"
    UNSUPPORTED = "nothing supports it, and it touches another track"
    OTHER_SEEN_MORE = "the other was seen in more keyframes"


class TrackEffect(StrEnum):
    """What else is done when a row applies."""

    DOUBT = "the time for which it was observed decreases"
    DROP = "it is removed, its shape job cancelled"
    MERGE = "it is merged into the other track, its shape job cancelled"


class End(StrEnum):
    """How a track ends."""

    DROPPED = "(dropped)"
    MERGED = "(merged)"


class Other(StrEnum):
    """A next phase that is determined by another track."""

    ITS_PHASE = "that of the other"


CONFIRMED = (Phase.ACTIVE, Phase.DORMANT, Phase.ARCHIVED)
ANY = tuple(Phase)


@dataclass(frozen=True, slots=True)
class Transition:
    """A row of the table."""

    #: None: the track does not exist yet
    phases: tuple[Phase, ...] | None
    event: LifeEvent
    guards: tuple[Guard, ...]
    #: None: the phase does not change
    to: Phase | End | Other | None
    effects: tuple[TrackEffect, ...] = ()
    cause: DropCause | None = None


def _life_cycle() -> tuple[Transition, ...]:
    e, g, tentative, active = LifeEvent, Guard, (Phase.TENTATIVE,), (Phase.ACTIVE,)
    drop, merge = (TrackEffect.DROP,), (TrackEffect.MERGE,)
    return (
        Transition(None, e.BORN, (), Phase.TENTATIVE),
        Transition(None, e.SPLIT_OFF, (), Phase.TENTATIVE),
        Transition(ANY, e.TAKES_IN, (g.OTHER_SEEN_MORE,), Other.ITS_PHASE),
        Transition(ANY, e.JUDGED, (g.KNOWN_HERE, g.SEEN_THROUGH), None, (TrackEffect.DOUBT,)),
        Transition(ANY, e.AGED, (g.PHANTOM,), End.DROPPED, drop, "looked through"),
        Transition(tentative, e.AGED, (g.SURE,), Phase.ACTIVE),
        Transition(tentative, e.AGED, (g.UNCONFIRMED, g.DOUBTED), End.DROPPED, drop, "looked through"),
        Transition(tentative, e.AGED, (g.UNCONFIRMED,), End.DROPPED, drop, "never confirmed"),
        Transition(CONFIRMED, e.AGED, (g.LONG_UNSEEN,), Phase.ARCHIVED),
        Transition(active, e.AGED, (g.UNSEEN, g.KNOWN_HERE, g.UNSUPPORTED), End.MERGED, merge),
        Transition(CONFIRMED, e.AGED, (g.UNSEEN,), Phase.DORMANT),
        Transition(CONFIRMED, e.AGED, (), Phase.ACTIVE),
        Transition(tentative, e.SOURCE_ENDED, (), End.DROPPED, drop, "never confirmed"),
        Transition(CONFIRMED, e.SOURCE_ENDED, (g.KNOWN_HERE, g.UNSUPPORTED), End.MERGED, merge),
    )


# In order of precedence.
LIFE_CYCLE = _life_cycle()


def transition(phase: Phase | None, event: LifeEvent, holds: Callable[[Guard], bool]) -> Transition | None:
    """Return the row that applies to a track in a phase (None: a new track); None if nothing changes."""
    return next((row for row in _ROWS[phase, event] if all(holds(guard) for guard in row.guards)), None)


def first_phase(event: LifeEvent) -> Phase:
    """Return the phase of a new track."""
    row = transition(None, event, lambda _: True)
    assert row is not None
    assert isinstance(row.to, Phase)
    return row.to


def is_sure(track: Track, config: LifecycleConfig) -> bool:
    """Return whether there is enough evidence to confirm a track."""
    return track.observed_ns >= 1e9 * config.confirm_s


def counted_ns(passed_ns: int) -> int:
    """Return how much of the time between two keyframes counts as observed, or as seen through."""
    return min(passed_ns, LONGEST_NS)


def life_cycle_table() -> str:
    """Return the table as Markdown."""
    lines = ["| phase | event | guard | next phase | effects |", "|---|---|---|---|---|"]
    for row in LIFE_CYCLE:
        phases = "any" if row.phases == ANY else ", ".join(row.phases or ("(new)",))
        to = f"{row.to or '(the same)'}{f': {row.cause}' if row.cause else ''}"
        cells = (phases, row.event, "; ".join(row.guards) or "-", to, "; ".join(row.effects) or "-")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


_ROWS = {
    (phase, event): tuple(
        row
        for row in LIFE_CYCLE
        if row.event is event and (row.phases is None if phase is None else phase in (row.phases or ()))
    )
    for phase in (None, *Phase)
    for event in LifeEvent
}
