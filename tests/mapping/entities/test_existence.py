from dataclasses import replace
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.mapping.entities.existence import (
    Existence,
    ExistenceConfig,
    no_evidence,
    sighted,
    united,
    with_evidence_against,
)
from hickory_stream.mapping.rules.lifecycle import LifecycleConfig
from hickory_stream.records import Observation
from tests.mapping.mapping_fixtures import box_surface, observation

CONFIG = ExistenceConfig()
ENOUGH = LifecycleConfig().confirm_sightings
THING = replace(observation(0, box_surface((0, 0, 0.1))), r_depth=1.0)


def seen_from(*cameras: tuple[float, float], thing: Observation = THING) -> Existence:
    known = no_evidence()
    for x, y in cameras:
        known = sighted(known, thing, np.array([x, y, 0.1]), CONFIG)
    return known


def test_a_thing_that_is_seen_well_twice_from_apart_is_one():
    assert seen_from((1.5, 0.0), (0.0, 1.5)).evidence >= ENOUGH
    # Straight ahead, but twice as near.
    assert seen_from((2.0, 0.0), (1.0, 0.0)).evidence >= ENOUGH


def test_from_one_place_it_takes_the_configured_sightings():
    assert seen_from(*[(1.5, 0.0)] * (ENOUGH - 1)).evidence < ENOUGH
    assert seen_from(*[(1.5, 0.0)] * ENOUGH).evidence >= ENOUGH


def test_distance_or_unsure_depth_makes_a_weaker_witness():
    near, far = seen_from((1.5, 0.0), (0.0, 1.5)), seen_from((25.0, 0.0), (0.0, 25.0))
    assert far.evidence == pytest.approx(CONFIG.min_gain * near.evidence)
    patchy = seen_from((1.5, 0.0), (0.0, 1.5), thing=replace(THING, r_depth=0.6))
    assert patchy.evidence == pytest.approx(0.6 * near.evidence)


def test_a_keyframe_that_looks_through_takes_one_sighting_away():
    known = seen_from((1.5, 0.0), (0.0, 1.5))
    assert with_evidence_against(known).evidence == known.evidence - 1
    assert with_evidence_against(with_evidence_against(no_evidence())).evidence == 0


def test_two_that_are_one_are_as_sure_as_the_surer():
    a, b = seen_from((1.5, 0.0)), seen_from((1.5, 0.0), (0.0, 1.5))
    assert united(a, b) is b
    assert united(b, a) is b


@given(st.lists(st.tuples(st.floats(-5, 5), st.floats(0.5, 5)), min_size=1, max_size=30))
def test_every_sighting_adds_between_the_least_and_the_most(cameras):
    evidence = seen_from(*cameras).evidence
    assert (
        CONFIG.min_gain * CONFIG.same_view_gain * len(cameras) <= evidence <= CONFIG.new_view_gain * len(cameras) + 1e-9
    )
    assert len(seen_from(*cameras).places) <= 12
