import numpy as np
import pytest
from hickory_stream.errors import InputError
from hickory_stream.query.grammar import question_of
from hickory_stream.query.looks import squared
from hickory_stream.query.question import phrase_of


@pytest.mark.parametrize(
    ("text", "meaning"),
    [
        ("something to sit on near the window", '(to sit on, near looks like "window")'),
        ("a red coffee mug on a box", '(red, looks like "coffee mug", on box)'),
        ("an office stool", '(looks like "office stool", to sit on, without a back, for one)'),
        ("a wooden thing", 'looks like "wooden"'),
        ("not plush", 'not looks like "plush"'),
        ("a red box", "(red, box)"),
    ],
)  # fmt: skip
def test_words_that_geometry_does_not_tell_are_looks(text, meaning):
    assert phrase_of(question_of(text, with_looks=True).thing) == meaning


@pytest.mark.parametrize("text", ["a mug #", "50 mugs", "% of it"])
def test_what_is_no_word_is_none_with_a_network_either(text):
    with pytest.raises(InputError):
        question_of(text, with_looks=True)


def test_a_view_is_made_a_square_of_which_nothing_is_cut_off():
    picture = np.zeros((4, 10, 3), np.uint8)
    picture[:, 5:] = 200
    square = squared(picture)
    assert square.shape == (10, 10, 3)
    assert (square[3:7] == picture).all()
    assert (square[:3] == 100).all()
