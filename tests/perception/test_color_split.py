import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.perception.fragments.color_split import _histogram, split_by_color
from hickory_stream.perception.masks import label_boxes
from hickory_stream.perception.surface import lab_of
from tests.strategies import seeds

ORANGE, RED, WHITE = (230, 150, 60), (215, 40, 40), (240, 240, 235)


def checks(height, width, one, side=2):
    v, u = np.mgrid[:height, :width] // side
    return np.where(((u + v) % 2 == 0)[..., None], one, WHITE).astype(np.uint8)


def divided(rgb, labels, depth=2):
    return split_by_color(labels, label_boxes(labels, int(labels.max()) + 1), lab_of(rgb), depth)


def test_two_patterned_boxes_that_are_flush_are_two():
    out = divided(np.concatenate([checks(30, 40, RED), checks(30, 40, ORANGE)]), np.ones((60, 40), dtype=np.int32))
    assert set(np.unique(out)) == {1, 2}
    top, bottom = out[:25].ravel(), out[35:].ravel()
    assert (top == top[0]).all()
    assert (bottom == bottom[0]).all()
    assert top[0] != bottom[0]


def marked(rgb, where, color):
    rgb = np.full((60, 40, 3), rgb, dtype=np.uint8)
    rgb[where] = color
    return rgb


PLAIN = {
    "a pattern alone": checks(60, 40, RED),
    "a shadow": marked(150, np.s_[30:], 115),
    "a speck": marked(WHITE, np.s_[10:12, 10:12], RED),
}


@pytest.mark.parametrize("name", PLAIN)
def test_what_is_no_border_divides_nothing(name):
    assert (divided(PLAIN[name], np.ones((60, 40), dtype=np.int32)) == 1).all()


def test_a_piece_is_divided_again():
    rgb = np.zeros((90, 40, 3), dtype=np.uint8)
    rgb[:30], rgb[30:60], rgb[60:] = RED, (60, 90, 200), (70, 200, 90)
    out = divided(rgb, np.ones((90, 40), dtype=np.int32))
    assert len({int(out[v, 20]) for v in (10, 45, 80)}) == 3
    once = divided(rgb, np.ones((90, 40), dtype=np.int32), depth=1)
    assert len(np.unique(once)) == 2


@given(st.integers(0, 10_000))
@pytest.mark.filterwarnings("error")
def test_pieces_are_of_one_fragment_and_leave_nothing_out(seed):
    random = np.random.default_rng(seed)
    labels = np.repeat(np.repeat(random.integers(0, 4, (4, 4)), 12, axis=0), 12, axis=1).astype(np.int32)
    names, labels = np.unique(labels, return_inverse=True)
    labels = labels.reshape(48, 48).astype(np.int32) + (0 if names[0] == 0 else 1)
    rgb = np.repeat(np.repeat(random.integers(0, 256, (6, 6, 3)), 8, axis=0), 8, axis=1).astype(np.uint8)
    out = divided(rgb, labels)
    assert ((out > 0) == (labels > 0)).all()
    for piece in np.unique(out[out > 0]):
        assert len(np.unique(labels[out == piece])) == 1
    assert set(np.unique(out[out > 0])) == set(range(1, int(out.max()) + 1))


@given(seeds, st.integers(2, 200), st.integers(0, 3))
def test_a_histogram_counts_what_lies_between_its_edges(seed, count, digits):
    values = np.round(np.random.default_rng(seed).normal(size=count), digits)
    edges = np.linspace(values.min(), values.max() + 0.1, 49)
    assert np.array_equal(_histogram(values, edges), np.histogram(values, bins=edges)[0])
