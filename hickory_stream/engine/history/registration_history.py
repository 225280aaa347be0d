"""What the registration of keyframes knew after a step of a run: from the journal alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from hickory_stream.events import FrameObserved, KeyframeRegistered

if TYPE_CHECKING:
    from hickory_stream.engine.journal import Journal
    from hickory_stream.geometry.camera import Camera
    from hickory_stream.records import CoarseFrame


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RegisteredKeyframe:
    """A keyframe that later ones may be registered to: `number` counts those that were registered, from 0."""

    event: KeyframeRegistered
    coarse: CoarseFrame
    camera: Camera
    number: int


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RegistrationHistory:
    """The last of the keyframes that were registered, how many these were, and those that are remembered, in order."""

    last: KeyframeRegistered
    num_placed: int
    remembered: tuple[RegisteredKeyframe, ...]


def registration_history(journal: Journal, num_steps: int, *, num_recent: int) -> RegistrationHistory | None:
    """Return what was known after the first `num_steps` steps of a run; None if no keyframe was registered by then.

    `num_recent` keyframes are remembered beside the anchors.

    Raises:
        MapFolderError: the journal is damaged.
    """
    found: list[tuple[int, KeyframeRegistered]] = []
    for index in _way_to(journal, num_steps):
        for event in journal.events(index, "KeyframeRegistered"):
            assert isinstance(event, KeyframeRegistered)
            found.append((index, event))
    if not found:
        return None
    begun = max(i for i, (_, event) in enumerate(found) if event.how in ("first", "begun anew") or i == 0)
    remembered = []
    for number, (index, event) in enumerate(found):
        if number < begun or not (event.is_anchor or number >= len(found) - num_recent):
            continue
        for observed in journal.events(index, "FrameObserved", has_points=False):
            assert isinstance(observed, FrameObserved)
            if observed.frame_index == event.frame_index and observed.coarse is not None:
                camera = journal.step(index).camera
                remembered.append(RegisteredKeyframe(event=event, coarse=observed.coarse, camera=camera, number=number))
    return RegistrationHistory(last=found[-1][1], num_placed=len(found), remembered=tuple(remembered))


def _way_to(journal: Journal, num_steps: int) -> list[int]:
    """Return the steps that led to the state after `num_steps`, without those that somebody went back from."""
    way = []
    index = num_steps - 1
    while index >= 0:
        way.append(index)
        goes_back_to = journal.step(index).goes_back_to
        index = index - 1 if goes_back_to is None else goes_back_to - 1
    return way[::-1]
