import numpy as np
import pytest
from hickory_stream.alignment.align import align
from hickory_stream.alignment.answer import Alignment, NoAlignment, Refusal
from tools.evaluation.alignment_table import error_of
from tools.evaluation.simulated_maps.ambiguous import AmbiguousConfig, simulate_ambiguous
from tools.evaluation.simulated_maps.simulate import SimulationConfig, simulate_pair
from tools.evaluation.simulated_maps.trial import overlap_b


def answered(config, seeds):
    """Return the answers, and which of them are right."""
    told = []
    for seed in seeds:
        pair = simulate_ambiguous(config, seed)
        answer = align(pair.map_a, pair.map_b)
        is_right = (
            isinstance(answer, Alignment)
            and len(pair.common) > 0
            and error_of(answer.a_from_b, pair.a_from_b, overlap_b(pair)).is_success
        )
        told.append((answer, is_right))
    return told


@pytest.mark.parametrize("order", [2, 4])
def test_a_symmetric_room_is_refused_and_its_rivals_are_listed(order):
    config = AmbiguousConfig(kind="symmetric", order=order)
    for seed, (answer, _) in zip(range(3), answered(config, range(3)), strict=True):
        assert isinstance(answer, NoAlignment)
        assert answer.refusal is Refusal.RIVAL
        assert len(answer.rivals) >= 2
        # The truth is among them, and within what its covariance allows.
        pair = simulate_ambiguous(config, seed)
        errors = [error_of(rival.a_from_b, pair.a_from_b, overlap_b(pair)) for rival in answer.rivals]
        assert any(error.is_success for error in errors)
        assert all(np.linalg.eigvalsh(rival.covariance)[0] > 0 for rival in answer.rivals)


@pytest.mark.parametrize("order", [2, 4])
def test_three_objects_that_break_the_symmetry_decide_it(order):
    told = answered(AmbiguousConfig(kind="symmetric", order=order, breaking=3), range(8))
    assert sum(is_right for _, is_right in told) >= 7
    assert not any(isinstance(answer, Alignment) and not is_right for answer, is_right in told)


@pytest.mark.parametrize(
    ("kind", "num_objects", "jitter_m"), [("identical-rooms", 10, 0.0), ("identical-rooms", 20, 0.0)]
)
def test_repetition_is_no_evidence_in_any_number(kind, num_objects, jitter_m):
    told = answered(AmbiguousConfig(kind=kind, num_objects=num_objects, jitter_m=jitter_m), range(6))
    assert sum(isinstance(answer, Alignment) for answer, _ in told) == 0


def test_the_few_unique_objects_decide_a_repeated_grid():
    told = answered(AmbiguousConfig(kind="repeated", breaking=3, difficulty="hard"), range(2_000_003, 2_000_010, 2))
    assert sum(is_right for _, is_right in told) >= 3
    assert not any(isinstance(answer, Alignment) and not is_right for answer, is_right in told)


def test_a_level_alignment_beats_a_tilt_with_one_more_pair():
    pair = simulate_pair(SimulationConfig(num_objects=20), 11)
    answer = align(pair.map_a, pair.map_b)
    assert isinstance(answer, NoAlignment)
    assert answer.refusal is Refusal.RIVAL
    errors = [error_of(rival.a_from_b, pair.a_from_b, overlap_b(pair)) for rival in answer.rivals]
    assert any(error.is_success for error in errors)
    assert not all(error.is_success for error in errors)


def test_rooms_are_found_by_what_only_they_have():
    told = answered(AmbiguousConfig(kind="different-rooms", num_objects=10, num_rooms=3), range(6))
    assert all(is_right for _, is_right in told)
    told = answered(AmbiguousConfig(kind="identical-rooms", num_objects=10, breaking=3), range(8))
    assert sum(is_right for _, is_right in told) >= 6
    assert not any(isinstance(answer, Alignment) and not is_right for answer, is_right in told)
