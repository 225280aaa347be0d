import numpy as np
import pytest

pytest.importorskip("sklearn")

from hickory_stream.evaluation.truth import load_truth
from hickory_stream.perception.affinity.pixel_network import PixelNetwork
from hickory_stream.perception.regions.join import JoinConfig, rounds
from hickory_stream.perception.regions.odds_features import ODDS_FEATURES
from tools.segmenter_growth import Growth, train
from tools.segmenter_lessons import lessons_of


def right_share(lesson, numbers):
    """Return the share of a lesson's pixels in groups that are of their owner, over those of one owner in one group."""
    shown = np.zeros((int(numbers.max()) + 1, lesson.shown.shape[1]))
    np.add.at(shown, numbers, lesson.shown)
    things = shown[:, lesson.owners > 0]
    return things.max(axis=0).sum() / things.sum() - (1 - shown.max(axis=1).sum() / shown.sum())


@pytest.fixture(scope="module")
def lessons(request):
    log = request.config.rootpath / "recordings" / "demo.mcap"
    return lessons_of(log, load_truth(log.with_suffix(".truth")), max_keyframes=12, network=PixelNetwork())


def test_trees_grown_on_some_images_join_the_fragments_of_others(lessons):
    trees, num_pairs = train([lessons[::2]], Growth(num_trees=8))
    assert num_pairs > 300
    before, after = [], []
    for lesson in lessons[1::2]:
        first, *_, last = rounds(lesson.measures, trees.probabilities, JoinConfig())
        before.append(right_share(lesson, first.numbers))
        after.append(right_share(lesson, last.numbers))
    assert np.mean(after) > np.mean(before) + 0.05
    assert np.mean(after) > 0.85


def test_the_same_seed_grows_the_same_trees(lessons):
    one, other = (train([lessons[:2]], Growth(seed=3, num_trees=3))[0] for _ in range(2))
    np.testing.assert_array_equal(one.value, other.value)
    np.testing.assert_array_equal(one.threshold, other.threshold)


def test_a_forest_of_odds_joins_with_or_without_the_network(lessons):
    trees, _ = train([lessons[::2], lessons[1:4]], Growth(num_trees=12), shares=[1.0, 0.5])
    assert set(ODDS_FEATURES) < set(trees.features)
    assert {trees.features[i] for i in trees.feature if i >= 0} & set(ODDS_FEATURES)
    for odds in (lessons[5].odds, None):
        first, *_, last = rounds(lessons[5].measures, trees.probabilities, JoinConfig(probability=0.5), odds)
        assert right_share(lessons[5], last.numbers) > right_share(lessons[5], first.numbers)


def test_the_networks_answer_for_a_pair_is_calibrated(lessons):
    trees, _ = train([lessons[::2]], Growth(num_trees=12))
    step = next(rounds(lessons[1].measures, trees.probabilities, JoinConfig(), lessons[1].odds))
    before = trees.probabilities(step.features)
    better = dict(step.features)
    for name in ODDS_FEATURES:
        if name.startswith("odds_") and not name.endswith("_share"):
            better[name] = step.features[name] + (-5.0 if name.endswith(("_apart", "_below_even")) else 5.0)
    after = trees.probabilities(better)
    assert (after >= before - 1e-9).all()
    assert (after > before).any()
