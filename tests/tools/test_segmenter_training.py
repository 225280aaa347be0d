"""The trees of the default segmenter are grown as documented: here few, on few images, and tried on others."""

import numpy as np
import pytest

pytest.importorskip("sklearn")

from hickory_stream.evaluation.truth import load_truth
from hickory_stream.perception.join import JoinConfig, rounds
from tools.segmenter_training import lessons_of, train


def right_share(lesson, numbers):
    """Return the share of a lesson's pixels in groups that are of their owner, over those of one owner in one group."""
    shown = np.zeros((int(numbers.max()) + 1, lesson.shown.shape[1]))
    np.add.at(shown, numbers, lesson.shown)
    things = shown[:, lesson.owners > 0]
    return things.max(axis=0).sum() / things.sum() - (1 - shown.max(axis=1).sum() / shown.sum())


@pytest.fixture(scope="module")
def lessons(request):
    log = request.config.rootpath / "recordings" / "demo.mcap"
    return lessons_of(log, load_truth(log.with_suffix(".truth")), max_keyframes=12)


def test_trees_grown_on_some_images_join_the_fragments_of_others(lessons):
    trees, num_pairs = train(lessons[::2], num_trees=20)
    assert num_pairs > 500
    before, after = [], []
    for lesson in lessons[1::2]:
        first, *_, last = rounds(lesson.measures, trees.probabilities, JoinConfig())
        before.append(right_share(lesson, first.numbers))
        after.append(right_share(lesson, last.numbers))
    assert np.mean(after) > np.mean(before) + 0.05
    assert np.mean(after) > 0.85


def test_the_same_seed_grows_the_same_trees(lessons):
    one, other = (train(lessons[:2], seed=3, num_trees=5)[0] for _ in range(2))
    np.testing.assert_array_equal(one.value, other.value)
    np.testing.assert_array_equal(one.threshold, other.threshold)
