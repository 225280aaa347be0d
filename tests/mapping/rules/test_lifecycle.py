from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.events import CancelShape
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.geometry.voxels import keys_of_points
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.entities.submaps import first_submap, with_seen
from hickory_stream.mapping.entities.track import ShapeState
from hickory_stream.mapping.entities.track_table import TrackTable
from hickory_stream.mapping.map_state import MapState
from hickory_stream.mapping.rules import lifecycle
from hickory_stream.mapping.rules.lifecycle import LIFE_CYCLE
from hickory_stream.mapping.rules.merging import merge
from hickory_stream.mapping.steps.ageing import EFFECTS, GUARDS, TrackTransition, end_tracks, is_seen_through
from hickory_stream.records import Phase
from tests.mapping.mapping_fixtures import SECOND_NS, VOXEL_M, box_surface, space, track

CONFIG = MappingConfig(
    voxels=Lattice(object_m=VOXEL_M),
    lifecycle=lifecycle.LifecycleConfig(confirm_s=3.0, tentative_s=8.0, dormant_s=4.0, archive_s=60.0, phantom_s=4.0),
)
SPACE_M = CONFIG.voxels.space_m
TENTATIVE, ACTIVE, DORMANT, ARCHIVED = Phase
PAGE = Path(__file__).resolve().parent.parent.parent.parent / "hickory_stream" / "mapping" / "LIFE_CYCLE.md"
BOX = box_surface((0, 0, 0.1))
FREE = np.unique(keys_of_points(BOX, SPACE_M))
POT = box_surface((0.0, 0.0, 0.3), (0.3, 0.3, 0.6))
BRANCH = box_surface((0.32, 0.0, 0.75), (0.16, 0.12, 0.12))


def there(phase, *, points=BOX, observed_s=9.0, unseen_s=0.0, seen_through_s=0.0, others=()):
    """A map with track 1 in a phase, not seen for so long, whose shape is asked for as job 5 once it is confirmed."""
    state = MapState(submaps=first_submap(SPACE_M), clock_ns=round((7 + unseen_s) * SECOND_NS), next_id=9)
    state.keyframe_ns = SECOND_NS
    item = replace(
        track(1, points, phase=phase), seen_clock_ns=7 * SECOND_NS, seen_through_ns=round(seen_through_s * SECOND_NS),
        observed_ns=round(observed_s * SECOND_NS),
        shape_state=ShapeState() if phase is TENTATIVE else ShapeState(open_ticket=5),
    )  # fmt: skip
    state.tracks = TrackTable({item.id: item, **{other.id: other for other in others}})
    return state


def forgotten(state):
    """The map after a pose jump: nothing was seen since."""
    state.submaps = replace(state.submaps, first=1)
    return state


def in_air(phase, unseen_s):
    """A branch in free space, away from every wall, that touches the pot."""
    state = there(phase, points=BRANCH, unseen_s=unseen_s, others=(track(2, POT),))
    steps = np.arange(-1.0, 1.0, 0.025)
    grid = np.stack(np.meshgrid(steps, steps, np.arange(0.1, 1.5, 0.025), indexing="ij"), axis=-1).reshape(-1, 3)
    for _ in range(2):
        state.submaps = with_seen(
            state.submaps, space(free=keys_of_points(grid.astype(np.float32), SPACE_M), floor_z_m=0.0)
        )
    return state


def case_of(state):
    return TrackTransition(state, 1, CONFIG, free_keys=FREE, merges=True)


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """The row of the table that applies to a map's first track, and how it ends (a phase, or why it is gone)."""

    row: int
    make: Callable[[], MapState]
    ends: Phase | str


JUDGED, AGED = lifecycle.LifeEvent.JUDGED, lifecycle.LifeEvent.AGED
SCENARIOS = [
    Scenario(row=3, make=lambda: there(ACTIVE, unseen_s=1.0), ends=ACTIVE),
    Scenario(row=4, make=lambda: there(TENTATIVE, seen_through_s=4.0), ends="looked through"),
    Scenario(row=4, make=lambda: there(ARCHIVED, seen_through_s=4.0), ends="looked through"),
    Scenario(row=5, make=lambda: there(TENTATIVE, observed_s=3.0, unseen_s=9.0), ends=ACTIVE),
    Scenario(
        row=6, make=lambda: there(TENTATIVE, observed_s=2.0, unseen_s=8.1, seen_through_s=1.0), ends="looked through"
    ),
    Scenario(row=7, make=lambda: there(TENTATIVE, observed_s=2.0, unseen_s=8.1), ends="never confirmed"),
    Scenario(row=8, make=lambda: there(DORMANT, unseen_s=60.1), ends=ARCHIVED),
    Scenario(row=8, make=lambda: there(ACTIVE, unseen_s=60.1), ends=ARCHIVED),
    Scenario(row=9, make=lambda: in_air(ACTIVE, 4.1), ends="merged"),
    Scenario(row=10, make=lambda: forgotten(there(ACTIVE, unseen_s=4.1)), ends=DORMANT),
    Scenario(row=10, make=lambda: in_air(DORMANT, 4.1), ends=DORMANT),
    Scenario(row=11, make=lambda: there(ACTIVE, observed_s=0.0, unseen_s=4.0), ends=ACTIVE),
    Scenario(row=11, make=lambda: there(DORMANT), ends=ACTIVE),
    Scenario(row=11, make=lambda: there(ARCHIVED), ends=ACTIVE),
    Scenario(row=12, make=lambda: there(TENTATIVE), ends="never confirmed"),
    Scenario(row=13, make=lambda: in_air(DORMANT, 9.0), ends="merged"),
]
NOTHING = [
    (TENTATIVE, AGED, lambda: there(TENTATIVE, observed_s=2.9, unseen_s=8.0)),
    (ACTIVE, JUDGED, lambda: there(ACTIVE)),
    (ACTIVE, lifecycle.LifeEvent.SOURCE_ENDED, lambda: there(ACTIVE)),
]


def told(row):
    return f"{'/'.join(row.phases or ('new',))} {row.event.name}"


@pytest.mark.parametrize("scenario", SCENARIOS, ids=[f"{s.row} {told(LIFE_CYCLE[s.row])}" for s in SCENARIOS])
def test_a_row_applies_where_its_guards_hold(scenario):
    state, row = scenario.make(), LIFE_CYCLE[scenario.row]
    case, before = case_of(state), state.tracks[1]
    assert lifecycle.transition(before.phase, row.event, lambda guard: GUARDS[guard](case)) is row
    # What the guards have found is found anew.
    effects = case_of(state).happens(row.event)
    after = state.tracks.get(1)
    if isinstance(scenario.ends, Phase):
        assert row.to in (scenario.ends, None)
        assert after.phase is scenario.ends
        assert effects == []
        assert after.shape_state.open_ticket == before.shape_state.open_ticket
        is_change = after.phase is not before.phase
        assert [d.kind for d in state.decisions if d.kind == "phase"] == ["phase"] * is_change
        doubts_ns = SECOND_NS * (lifecycle.TrackEffect.DOUBT in row.effects)
        assert (after.seen_through_ns, after.observed_ns) == (
            before.seen_through_ns + doubts_ns,
            before.observed_ns - doubts_ns,
        )
        return
    assert after is None
    assert effects == ([] if before.phase is TENTATIVE else [CancelShape(ticket=5)])
    (decision,) = state.decisions
    if row.to is lifecycle.End.MERGED:
        assert state.tracks[2].merged_ids == (1,)
        assert (decision.kind, decision.object_id, decision.other_id) == ("merge", 2, 1)
    else:
        assert row.to is lifecycle.End.DROPPED
        assert (decision.kind, decision.cause) == ("drop", scenario.ends)


def test_every_row_a_case_can_meet_has_a_scenario():
    others = {lifecycle.LifeEvent.BORN, lifecycle.LifeEvent.SPLIT_OFF, lifecycle.LifeEvent.TAKES_IN}
    assert {s.row for s in SCENARIOS} == {i for i, row in enumerate(LIFE_CYCLE) if row.event not in others}


@pytest.mark.parametrize(("phase", "event", "make"), NOTHING, ids=range(len(NOTHING)))
def test_where_no_row_applies_nothing_changes(phase, event, make):
    state = make()
    before = state.tracks[1]
    assert before.phase is phase
    assert case_of(state).happens(event) == []
    assert state.tracks[1] is before
    assert state.decisions == []


@pytest.mark.parametrize("event", [lifecycle.LifeEvent.BORN, lifecycle.LifeEvent.SPLIT_OFF])
def test_a_new_track_is_tentative(event):
    assert lifecycle.first_phase(event) is TENTATIVE


@pytest.mark.parametrize(("kept", "gone", "after"), [(3, 4, ARCHIVED), (3, 3, ACTIVE), (4, 3, ACTIVE)])
def test_a_track_takes_over_the_phase_of_the_more_seen_one(kept, gone, after):
    other = track(2, BOX, sightings=gone, phase=ARCHIVED)
    assert merge(track(1, BOX, sightings=kept), other, VOXEL_M).phase is after
    assert {row.to for row in LIFE_CYCLE if row.event is lifecycle.LifeEvent.TAKES_IN} == {lifecycle.Other.ITS_PHASE}


def test_all_that_the_table_names_is_carried_out():
    assert set(GUARDS) | {lifecycle.Guard.OTHER_SEEN_MORE} == set(lifecycle.Guard)
    assert set(EFFECTS) == set(lifecycle.TrackEffect)
    assert {guard for row in LIFE_CYCLE for guard in row.guards} == set(lifecycle.Guard)
    assert {effect for row in LIFE_CYCLE for effect in row.effects} == set(lifecycle.TrackEffect)
    assert {row.event for row in LIFE_CYCLE} == set(lifecycle.LifeEvent)


def test_a_row_ends_a_track_by_one_effect_and_a_drop_has_a_cause():
    for row in LIFE_CYCLE:
        ends = [effect for effect in row.effects if effect in (lifecycle.TrackEffect.DROP, lifecycle.TrackEffect.MERGE)]
        expected = {
            lifecycle.End.DROPPED: [lifecycle.TrackEffect.DROP],
            lifecycle.End.MERGED: [lifecycle.TrackEffect.MERGE],
        }
        assert ends == (expected[row.to] if isinstance(row.to, lifecycle.End) else [])
        assert (row.cause is not None) == (row.to is lifecycle.End.DROPPED)


def test_no_row_is_hidden_by_one_before_it():
    for i, row in enumerate(LIFE_CYCLE):
        earlier = [other for other in LIFE_CYCLE[:i] if other.event is row.event]
        for phase in row.phases or ():
            guards = [set(other.guards) for other in earlier if phase in (other.phases or ())]
            hidden = [one <= set(row.guards) for one in guards]
            assert not any(hidden), f"row {i} never applies to {phase}"


@given(st.sampled_from([ACTIVE, DORMANT, ARCHIVED]), st.integers(0, 50), st.floats(0, 10_000))
def test_a_confirmed_track_is_never_lost_by_time_alone(phase, observed_s, unseen_s):
    state = there(phase, observed_s=observed_s, unseen_s=unseen_s)
    assert case_of(state).happens(AGED) == []
    assert state.tracks[1].phase in (ACTIVE, DORMANT, ARCHIVED)


@given(st.sampled_from(list(Phase)), st.integers(0, 9), st.floats(0, 100), st.floats(0, 100))
def test_a_track_that_stays_unseen_never_becomes_younger(phase, observed_s, first_s, more_s):
    def after(unseen_s):
        state = there(phase, observed_s=observed_s, unseen_s=unseen_s)
        case_of(state).happens(AGED)
        return state.tracks[1].phase if 1 in state.tracks else None

    age = [TENTATIVE, ACTIVE, DORMANT, ARCHIVED, None]
    assert age.index(after(first_s + more_s)) >= age.index(after(first_s))


def test_without_final_tracks_nothing_is_merged_for_support():
    state = in_air(ACTIVE, 4.1)
    assert end_tracks(state, CONFIG, merges=False) == []
    assert sorted(state.tracks) == [1, 2]


def test_the_table_is_printed_in_the_documentation():
    table = lifecycle.life_cycle_table()
    assert len(table.splitlines()) == len(LIFE_CYCLE) + 2
    assert table in PAGE.read_text(encoding="utf-8"), "run tools/write_life_cycle"


def test_what_rays_passed_for_the_most_part_was_looked_through():
    assert is_seen_through(track(1, BOX), FREE, CONFIG)
    assert not is_seen_through(track(1, BOX), FREE[: len(FREE) // 2], CONFIG)
