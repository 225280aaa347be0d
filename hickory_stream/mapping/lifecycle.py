"""The life cycle of a track, as a table: `LIFE_CYCLE` is what the core executes, and what the documentation prints.

A row says: in these phases, when this happens and all guards hold, the track goes to that phase, or ends, and these
effects are carried out. Of the rows of a phase and an event the first whose guards hold counts; where there is none,
nothing changes. What guards ask and effects do is in `track_ageing`; times are of the core's own clock, which runs on
through a jump of the stamps.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

from hickory_stream.ranges import Ranged, number
from hickory_stream.records import Phase

if TYPE_CHECKING:
    from collections.abc import Callable

    from hickory_stream.mapping.track import Track
    from hickory_stream.records import DropCause

# Evidence is a sum of floats, which may miss a whole number by its last bits.
_ROUNDING = 1e-6


@dataclass(frozen=True, kw_only=True, slots=True)
class LifecycleConfig(Ranged):
    """The numbers of the table, and of the guards that it names.

    Attributes:
        confirm_sightings: evidence for a confirmation, in units of `existence`: two good sightings from different
            viewpoints, or so many from the same one.
        tentative_s: unconfirmed tracks are kept for so long, so that a second visit can confirm them.
        dormant_s, archive_s: a confirmed track that was not seen for so long is dormant, or archived.
        phantom_frames: a track is dropped once so many keyframes have seen through its place since it was last seen.
        structure_m, structure_m3: a track is structure if its two longest sides are over the one, or its box over the
            other.
        structure_share: a track with more of its points than this on tracks that are part of the room is a piece of
            these.
        revise_evidence: what a track that is set aside as part of the room has to be seen again, in units of
            `existence` (so that viewpoints count, not keyframes), before it may be an object after all.
        wall_foot_m, wall_top_m, wall_height_m, wall_thickness_m: an upright slab that begins at most this high above
            the floor, ends at least that high, is at least so tall and thinner, is a piece of a wall; so is one longer
            than `structure_m`, wherever it begins.
        lintel_foot_m, lintel_top_m: a slab that begins and ends at least that high above the floor is what a wall has
            over a door.
        wall_share, wall_hits: of a track that comes to rest with more of its points than this in voxels that so many
            keyframes saw as structure, and `wall_against` times as many as saw the point as the track's, these points
            are removed: some mask of the track included a piece of the wall behind it.
        phantom_share: minimum share of a track's voxels that a keyframe observes free to count as seeing through it.
    """

    confirm_sightings: int = number(4, 1, 1_000_000, "sightings")
    tentative_s: float = number(60.0, 0, 1e9, "s")
    dormant_s: float = number(4.0, 0, 1e9, "s")
    archive_s: float = number(60.0, 0, 1e9, "s")
    phantom_frames: int = number(4, 1, 1_000_000, "keyframes")
    phantom_share: float = number(0.7, 0, 1, "share")
    structure_m: float = number(2.6, 0, 1000, "m")
    structure_m3: float = number(12.0, 0, 1e6, "m3")
    wall_foot_m: float = number(0.7, 0, 100, "m")
    wall_top_m: float = number(1.25, 0, 100, "m")
    wall_height_m: float = number(0.75, 0, 100, "m")
    wall_thickness_m: float = number(0.22, 0, 100, "m")
    lintel_foot_m: float = number(1.4, 0, 100, "m")
    lintel_top_m: float = number(2.1, 0, 100, "m")
    structure_share: float = number(0.5, 0, 1, "share")
    revise_evidence: float = number(2.0, 0, 1000, "sightings")
    wall_share: float = number(0.15, 0, 1, "share")
    wall_hits: int = number(4, 0, 1_000_000, "keyframes")
    wall_against: float = number(2.0, 0, 1000, "ratio")


class LifeEvent(StrEnum):
    """What happens to a track."""

    BORN = "an observation matches no track"
    SPLIT_OFF = "it was seen apart from another track often enough"
    TAKES_IN = "another track is merged into it"
    JUDGED = "a keyframe: held against the observed space"
    AGED = "a keyframe: time has passed"
    SPACE_FORGOTTEN = "the odometry jumps, or the source has ended"
    SOURCE_ENDED = "the source has ended"


class Guard(StrEnum):
    """What a row asks of a track."""

    IS_ROOM = "it is too large, a piece of a wall, or flat and flush with one"
    IN_ROOM = "more than `structure_share` of it lies on tracks that are part of the room"
    REVISED = "seen since from other viewpoints, worth `revise_evidence`, it is none of that"
    SEEN_THROUGH = "out of sight, and the keyframe saw through its place"
    PHANTOM = "`phantom_frames` keyframes saw through its place"
    SURE = "its evidence is that of `confirm_sightings` sightings"
    UNCONFIRMED = "unseen for `tentative_s`"
    DOUBTED = "a keyframe saw through its place"
    UNSEEN = "unseen for `dormant_s`"
    LONG_UNSEEN = "unseen for `archive_s`"
    KNOWN_HERE = "seen since the last pose jump"
    UNSUPPORTED = "nothing supports it, and it touches another track"
    OTHER_SEEN_MORE = "that was seen in more keyframes"
    OTHER_MAYBE_OBJECT = "that is no part of the room"


class TrackEffect(StrEnum):
    """What else is done when a row applies."""

    SET_ASIDE = "it is tracked on, but no object; its shape job is cancelled"
    DOUBT = "its evidence falls"
    TRIM = "its points in a wall are removed"
    DROP = "it is forgotten, its shape job cancelled"
    MERGE = "the other track takes it in, its shape job is cancelled"


class End(StrEnum):
    """Where a track goes that is none any more."""

    DROPPED = "(dropped)"
    MERGED = "(merged)"


class Other(StrEnum):
    """A phase that another track says."""

    ITS_PHASE = "that of the other"


CONFIRMED = (Phase.ACTIVE, Phase.DORMANT, Phase.ARCHIVED)
MAYBE_OBJECT = (Phase.TENTATIVE, *CONFIRMED)
ANY = tuple(Phase)


@dataclass(frozen=True, slots=True)
class Transition:
    """A row: `phases` None are those of a track that is not there yet; `to` None is the phase that it is in.

    `cause` is why a track is dropped.
    """

    phases: tuple[Phase, ...] | None
    event: LifeEvent
    guards: tuple[Guard, ...]
    to: Phase | End | Other | None
    effects: tuple[TrackEffect, ...] = ()
    cause: DropCause | None = None


LIFE_CYCLE = (
    Transition(None, LifeEvent.BORN, (), Phase.TENTATIVE),
    Transition(None, LifeEvent.SPLIT_OFF, (), Phase.TENTATIVE),
    Transition(MAYBE_OBJECT, LifeEvent.TAKES_IN, (Guard.OTHER_MAYBE_OBJECT, Guard.OTHER_SEEN_MORE), Other.ITS_PHASE),
    Transition((Phase.ROOM,), LifeEvent.TAKES_IN, (Guard.OTHER_MAYBE_OBJECT,), Other.ITS_PHASE),
    Transition(MAYBE_OBJECT, LifeEvent.JUDGED, (Guard.KNOWN_HERE, Guard.IS_ROOM), Phase.ROOM, (TrackEffect.SET_ASIDE,)),
    Transition(
        MAYBE_OBJECT,
        LifeEvent.JUDGED,
        (Guard.KNOWN_HERE, Guard.IN_ROOM),
        End.DROPPED,
        (TrackEffect.DROP,),
        "in structure",
    ),
    Transition((Phase.ROOM,), LifeEvent.JUDGED, (Guard.KNOWN_HERE, Guard.REVISED), Phase.TENTATIVE),
    Transition(ANY, LifeEvent.JUDGED, (Guard.KNOWN_HERE, Guard.SEEN_THROUGH), None, (TrackEffect.DOUBT,)),
    Transition(ANY, LifeEvent.AGED, (Guard.PHANTOM,), End.DROPPED, (TrackEffect.DROP,), "looked through"),
    Transition((Phase.TENTATIVE,), LifeEvent.AGED, (Guard.SURE,), Phase.ACTIVE),
    Transition(
        (Phase.TENTATIVE,),
        LifeEvent.AGED,
        (Guard.UNCONFIRMED, Guard.DOUBTED),
        End.DROPPED,
        (TrackEffect.DROP,),
        "looked through",
    ),
    Transition(
        (Phase.TENTATIVE,), LifeEvent.AGED, (Guard.UNCONFIRMED,), End.DROPPED, (TrackEffect.DROP,), "never confirmed"
    ),
    Transition(CONFIRMED, LifeEvent.AGED, (Guard.LONG_UNSEEN,), Phase.ARCHIVED),
    Transition(
        (Phase.ACTIVE,),
        LifeEvent.AGED,
        (Guard.UNSEEN, Guard.KNOWN_HERE, Guard.UNSUPPORTED),
        End.MERGED,
        (TrackEffect.MERGE,),
    ),
    Transition((Phase.ACTIVE,), LifeEvent.AGED, (Guard.UNSEEN, Guard.KNOWN_HERE), Phase.DORMANT, (TrackEffect.TRIM,)),
    Transition(CONFIRMED, LifeEvent.AGED, (Guard.UNSEEN,), Phase.DORMANT),
    Transition(CONFIRMED, LifeEvent.AGED, (), Phase.ACTIVE),
    Transition(MAYBE_OBJECT, LifeEvent.SPACE_FORGOTTEN, (Guard.KNOWN_HERE,), None, (TrackEffect.TRIM,)),
    Transition((Phase.ROOM,), LifeEvent.SOURCE_ENDED, (), End.DROPPED, (TrackEffect.DROP,), "structure"),
    Transition((Phase.TENTATIVE,), LifeEvent.SOURCE_ENDED, (), End.DROPPED, (TrackEffect.DROP,), "never confirmed"),
    Transition(
        CONFIRMED, LifeEvent.SOURCE_ENDED, (Guard.KNOWN_HERE, Guard.UNSUPPORTED), End.MERGED, (TrackEffect.MERGE,)
    ),
)
"""All that becomes of tracks."""


def transition(phase: Phase | None, event: LifeEvent, holds: Callable[[Guard], bool]) -> Transition | None:
    """Return the row that applies to a track in a phase, None where nothing changes; guards are asked in their order.

    `phase` None: the track is not there yet.
    """
    for row in _ROWS[phase, event]:
        if all(holds(guard) for guard in row.guards):
            return row
    return None


def first_phase(event: LifeEvent) -> Phase:
    """Return the phase of a new track."""
    row = transition(None, event, lambda _: True)
    assert row is not None
    assert isinstance(row.to, Phase)
    return row.to


def is_sure(track: Track, config: LifecycleConfig) -> bool:
    """Return whether there is enough evidence to confirm a track."""
    return track.existence.evidence >= config.confirm_sightings - _ROUNDING


def life_cycle_table() -> str:
    """Return the table as Markdown."""
    lines = ["| phase | event | guard | next phase | effects |", "|---|---|---|---|---|"]
    for row in LIFE_CYCLE:
        cells = (
            _phases_text(row.phases),
            row.event,
            "; ".join(row.guards) or "-",
            f"{row.to or '(the same)'}{f': {row.cause}' if row.cause else ''}",
            "; ".join(row.effects) or "-",
        )
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _phases_text(phases: tuple[Phase, ...] | None) -> str:
    if phases is None:
        return "(new)"
    return "any" if phases == ANY else ", ".join(phases)


_ROWS = {
    (phase, event): tuple(
        row
        for row in LIFE_CYCLE
        if row.event is event and (row.phases is None if phase is None else phase in (row.phases or ()))
    )
    for phase in (None, *Phase)
    for event in LifeEvent
}
