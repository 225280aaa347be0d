import numpy as np
import pytest
from hickory_stream.evaluation.surface_score import SurfaceScore
from tools.evaluation.views.comparison import compare, format_comparison, paired_difference, verdict
from tools.evaluation.views.trials import BEST, OURS, STRATEGIES, ViewTrial


def trial(truth_id, s, others, best=None):
    """A true object of 1 m on which S has one F1 and all other strategies another one; None for no shape."""

    def score(f1):
        return None if f1 is None else SurfaceScore(f1_1cm=f1 / 2, f1_5pct=f1, add_s_m=0.2 * (1 - f1))

    scores = {strategy: score(s if strategy == OURS else others) for strategy in STRATEGIES}
    return ViewTrial(truth_id=truth_id, kind="box", diameter_m=1.0, scores={**scores, BEST: score(best or s or others)})


MISSED = ViewTrial(truth_id=9, kind="box", diameter_m=1.0, scores={})


def test_a_missed_object_and_one_without_shape_count_as_nothing():
    scores = {score.strategy: score for score in compare([[trial(1, 0.9, 0.5), trial(2, None, 0.5), MISSED]])}
    ours, initial = scores[OURS], scores["initial"]
    assert (ours.f1_5pct, initial.f1_5pct) == (pytest.approx(0.3), pytest.approx(1 / 3))
    assert (ours.common_f1_5pct, ours.num_objects, ours.num_common) == (pytest.approx(0.45), 3, 2)
    # 0.02 m and 0.1 m of 1 m.
    assert (ours.adds_05, initial.adds_05, initial.adds_10) == (pytest.approx(1 / 3), 0.0, 0.0)
    assert scores[BEST].f1_5pct == pytest.approx((0.9 + 0.5) / 3)


def test_the_difference_is_that_of_the_same_objects():
    paired = compare([[trial(i, 0.1 * i + 0.02, 0.1 * i) for i in range(1, 9)]])[-1].s_minus_this
    # The objects differ by far more than the strategies do: unpaired, nothing could be said.
    assert (paired.low, paired.mean, paired.high) == pytest.approx((0.02, 0.02, 0.02))
    assert paired.p_value == pytest.approx(1e-4)


def test_common_errors_of_a_room_are_not_independent():
    rooms = [np.full(40, shift) for shift in np.random.default_rng(0).normal(0.0, 0.05, 12)]
    apart = [np.array([value]) for room in rooms for value in room]
    by_room, by_object, few = (paired_difference(each) for each in (rooms, apart, rooms[:9]))
    assert by_room.high - by_room.low > 2 * (by_object.high - by_object.low)
    # Nine rooms are too few to be drawn again.
    assert few == paired_difference(apart[: 9 * 40])


def test_chance_is_told_from_a_difference():
    rng = np.random.default_rng(1)
    noise = [rng.normal(0.0, 0.1, 30) for _ in range(20)]
    assert paired_difference(noise).p_value > 0.05
    assert paired_difference([each + 0.03 for each in noise]).p_value < 0.01


def test_it_is_said_how_certain_the_best_choice_is():
    rooms = [[trial(i, 0.8, 0.7), trial(i + 50, 0.6, 0.5)] for i in range(12)]
    assert verdict(compare(rooms)).startswith("S is 0.1000 better than initial, the next best: a difference that")
    mixed = [[trial(i, 0.5 + 0.1 * (i % 2), 0.56)] for i in range(12)]
    assert verdict(compare(mixed)).startswith("S is 0.0100 worse than initial, the best of the others: which may be")
    assert "24 true objects of 12 logs, 24 of them in the maps; intervals" in format_comparison(compare(rooms))


def test_nothing_to_compare_is_refused():
    with pytest.raises(ValueError, match="no true object"):
        compare([[]])
