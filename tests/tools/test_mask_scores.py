import numpy as np
import pytest
from tools.evaluation.masks.scores import UNKNOWN, MaskScore, score_masks, total


def image(*rows):
    return np.repeat(np.repeat(np.array(rows, dtype=np.int32), 10, axis=0), 10, axis=1)


TRUTH = image([0, 1, 1, 0], [0, 2, 2, 0])


def test_true_masks_are_right_and_one_over_two_things_is_not():
    score = score_masks(image([0, 7, 7, 0], [0, 3, 3, 0]), TRUTH, 50)
    assert (score.f1, score.best_iou, score.found_fraction) == (1.0, 1.0, 1.0)
    # Labels without a pixel are no masks.
    assert (score.num_things, score.num_masks) == (2, 2)
    score = score_masks(image([0, 1, 1, 0], [0, 1, 1, 0]), TRUTH, 50)
    assert (score.num_right, score.num_masks, score.f1) == (0, 1, 0.0)
    assert score.best_iou == pytest.approx(0.5)


def test_a_mask_on_no_thing_counts_and_unknown_pixels_do_not():
    masks = image([1, 2, 2, 0], [0, 3, 3, 0])
    assert score_masks(masks, TRUTH, 50).f1 == pytest.approx(2 * 2 / (2 + 3))
    assert score_masks(masks, np.where(image([1, 0, 0, 0], [0, 0, 0, 0]) > 0, UNKNOWN, TRUTH), 50).f1 == 1.0
    truth = image([0, 1, UNKNOWN, UNKNOWN], [0, 0, 0, 0])
    assert score_masks(image([0, 1, 1, 0], [0, 0, 0, 0]), truth, 50).best_iou == 1.0


def test_too_small_things_and_masks_and_none_do_not_count():
    score = score_masks(image([1, 2, 2, 0], [0, 0, 0, 0]), image([0, 1, 1, 0], [0, 2, 0, 0]), 150)
    assert (score.num_things, score.num_masks, score.f1) == (1, 1, 1.0)
    empty = np.zeros((8, 8), dtype=np.int32)
    assert score_masks(empty, empty, 5) == MaskScore()
    assert score_masks(empty, TRUTH[:8, :8], 5).f1 == 0.0


def test_a_total_is_over_all_images_together():
    one, other = score_masks(TRUTH, TRUTH, 50), score_masks(np.zeros_like(TRUTH), TRUTH, 50)
    assert total([one, other]).f1 == pytest.approx(2 * 2 / (4 + 2))
    assert total([one, other]).best_iou == pytest.approx(0.5)
