from dataclasses import replace
from types import SimpleNamespace
import numpy as np
import pytest
from hypothesis import given, settings
from hickory_stream.perception.affinity.pixel_network import PixelNetwork
from tests.strategies import seeds
from tools.evaluation.masks.scores import score_masks
from tools.network_training.scenes import Scene
from tools.segmenter_lessons import Lesson, lessons_of_scene, score_groups, true_groups


@pytest.fixture(scope="module")
def lessons(tmp_path_factory):
    scene = Scene(kind="clutter-training", seed=0, frames=2)
    return lessons_of_scene(scene, tmp_path_factory.mktemp("views"), PixelNetwork())


def lesson_of(labels, truth):
    owners, place = np.unique(truth, return_inverse=True)
    shown = np.zeros((int(labels.max()) + 1, len(owners)))
    np.add.at(shown, (labels.ravel(), place.ravel()), 1)
    in_image = shown.sum(axis=0).astype(np.int64)
    shown[0] = 0
    return Lesson(measures=SimpleNamespace(labels=labels), shown=shown, owners=owners, in_image=in_image)


@settings(deadline=None, max_examples=30)
@given(seeds)
def test_group_scores_from_counts_equal_those_from_pixels(seed):
    rng = np.random.default_rng(seed)
    labels = np.repeat(np.repeat(rng.integers(0, 9, (6, 8)), 10, axis=0), 10, axis=1).astype(np.int32)
    truth = np.repeat(np.repeat(rng.integers(-1, 5, (6, 8)), 10, axis=0), 10, axis=1).astype(np.int32)
    labels[0, 0] = 8
    numbers = np.append(0, np.unique(rng.integers(0, 4, 8), return_inverse=True)[1] + 1)
    masks = numbers[labels].astype(np.int32)
    assert score_groups(lesson_of(labels, truth), numbers) == score_masks(masks, truth, int(0.002 * labels.size))


def test_true_joins_are_at_least_as_good_as_none(lessons):
    for lesson in lessons:
        alone = score_groups(lesson, np.arange(len(lesson.shown)))
        assert score_groups(lesson, true_groups(lesson)).f1 > alone.f1
        assert (true_groups(replace(lesson, shown=np.zeros_like(lesson.shown))) == 0).all()


def test_a_lesson_counts_every_pixel_of_its_image(lessons):
    for lesson in lessons:
        assert lesson.in_image.sum() == lesson.measures.labels.size
        assert (lesson.shown.sum(axis=0) <= lesson.in_image).all()
        np.testing.assert_array_equal(lesson.shown.sum(axis=1)[1:], lesson.measures.regions.pixels[1:])
