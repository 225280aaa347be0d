"""The table of phases, row by row."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hickory_stream.mapping.lifecycle import LifecycleConfig, aged, is_structure, next_phase
from hickory_stream.records import Phase
from tests.mapping.mapping_fixtures import SECOND_NS, box_surface, track

CONFIG = LifecycleConfig(
    confirm_sightings=3, tentative_s=8.0, dormant_s=4.0, archive_s=60.0, phantom_frames=4, phantom_share=0.7
)
TENTATIVE, ACTIVE, DORMANT, ARCHIVED = Phase.TENTATIVE, Phase.ACTIVE, Phase.DORMANT, Phase.ARCHIVED
TRACK = track(1, box_surface((0, 0, 0.1)))


def after(phase: Phase, sightings: int, unseen_s: float, seen_through: int = 0) -> Phase | None:
    known = replace(TRACK.existence, evidence=float(sightings))
    then = replace(TRACK, phase=phase, seen_clock_ns=7 * SECOND_NS, seen_through=seen_through, existence=known)
    return next_phase(then, round((7 + unseen_s) * SECOND_NS), CONFIG)


@pytest.mark.parametrize(
    ("phase", "sightings", "unseen_s", "expected"),
    [
        (TENTATIVE, 1, 0.0, TENTATIVE),
        (TENTATIVE, 2, 8.0, TENTATIVE),
        (TENTATIVE, 3, 0.0, ACTIVE),
        (TENTATIVE, 2, 8.1, None),
        (ACTIVE, 3, 0.0, ACTIVE),
        (ACTIVE, 3, 4.0, ACTIVE),
        (ACTIVE, 3, 4.1, DORMANT),
        (DORMANT, 3, 60.0, DORMANT),
        (DORMANT, 3, 60.1, ARCHIVED),
        (DORMANT, 4, 0.0, ACTIVE),
        (ARCHIVED, 3, 600.0, ARCHIVED),
        (ARCHIVED, 4, 0.0, ACTIVE),
    ],
)
def test_the_next_phase_is_that_of_the_table(
    phase: Phase, sightings: int, unseen_s: float, expected: Phase | None
) -> None:
    assert after(phase, sightings, unseen_s) is expected


@pytest.mark.parametrize("phase", Phase)
def test_a_track_of_any_phase_is_dropped_once_enough_keyframes_looked_through_its_place(phase: Phase) -> None:
    assert after(phase, 5, 1.0, seen_through=3) is not None
    assert after(phase, 5, 1.0, seen_through=4) is None


@given(st.sampled_from([ACTIVE, DORMANT, ARCHIVED]), st.integers(1, 50), st.floats(0, 10_000))
def test_a_confirmed_track_is_never_lost_by_time_alone(phase: Phase, sightings: int, unseen_s: float) -> None:
    assert after(phase, sightings, unseen_s) in (ACTIVE, DORMANT, ARCHIVED)


@given(st.sampled_from(list(Phase)), st.integers(1, 9), st.floats(0, 100), st.floats(0, 100))
def test_a_track_that_stays_unseen_never_becomes_younger(
    phase: Phase, sightings: int, first_s: float, more_s: float
) -> None:
    age = [TENTATIVE, ACTIVE, DORMANT, ARCHIVED, None]
    sooner, later = after(phase, sightings, first_s), after(phase, sightings, first_s + more_s)
    assert age.index(later) >= age.index(sooner)


def test_ageing_changes_the_phase_and_nothing_else() -> None:
    assert aged(TRACK, TRACK.phase) is TRACK
    dormant = aged(TRACK, DORMANT)
    assert dormant.phase is DORMANT
    assert replace(dormant, phase=TRACK.phase).cloud is TRACK.cloud


@pytest.mark.parametrize(
    ("size", "verdict"),
    [
        ((3.0, 0.2, 2.4), True),
        ((2.1, 2.1, 0.05), True),
        ((3.0, 0.9, 0.75), False),
        ((0.6, 0.4, 2.5), False),
        ((0.2, 0.2, 0.2), False),
    ],
    ids=["a wall", "a floor", "a long table", "a tall shelf", "a box"],
)
def test_what_is_over_two_metres_in_two_directions_is_structure(
    size: tuple[float, float, float], verdict: bool
) -> None:
    corners = np.array([(0, 0, 0), size, (size[0], 0, 0), (0, size[1], size[2])], dtype=np.float32)
    assert is_structure(track(1, corners), None, LifecycleConfig(structure_m=2.0)) is verdict
