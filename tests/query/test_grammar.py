import re
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.errors import InputError
from hickory_stream.query import vocabulary
from hickory_stream.query.grammar import question_of
from hickory_stream.query.looks import squared
from hickory_stream.query.question import phrase_of

WORDS = sorted(
    {
        *vocabulary.ADJECTIVES,
        *vocabulary.NOUNS,
        *vocabulary.STAND_INS,
        *vocabulary.SUPERLATIVES,
        *(word for phrase in (*vocabulary.RELATIONS, *vocabulary.USES) for word in phrase),
        *vocabulary.COMPARISONS,
        *vocabulary.FILLERS,
        *("not", "nearest", "0.5", "m", "1,-2", "#7", "wall", "floor"),
    }
)


@pytest.mark.parametrize(
    ("text", "meaning"),
    [
        ("a red box", "(red, box)"),
        ("Show me the big grey boxes!", "(large, gray, box)"),
        ("something on a table", "on (to put things on, as long as a table, not flat)"),
        ("a ball on a box near 1,-2.5", "(ball, on (box, near 1,-2.5))"),
        ("a ball on a box and near 1,-2.5", "(ball, on box, near 1,-2.5)"),
        ("a ball on a seat near a box and near the wall", "(ball, on (to sit on, near box), near the wall)"),
        ("a red and blue thing under a red and blue box", "(red, blue, under (red, blue, box))"),
        ("something next to object 12", "beside #12"),
        ("thing in front of #3 and not white", "(in front of #3, not white)"),
        ("not red thing to sit on", "(not red, to sit on)"),
        ("things taller than 50 cm", "taller than 0.5 m"),
        ("the nearest seat to 1,2", "(nearest to 1,2, to sit on)"),
        ("the largest thing on the floor", "(largest, on the floor)"),
        ("anything", "any object"),
        ("shelves", "(bookcase-sized (60-200 x 22-50 x 75-220 cm), on the floor, not to sit on)"),
        ("a ball to the left of a box", "(ball, left of box)"),
    ],
)
def test_a_question_means(text, meaning):
    assert phrase_of(question_of(text).thing) == meaning


def test_a_question_that_counts_is_told_from_one_that_looks():
    assert question_of("how many red boxes are there?").counts
    assert question_of("the number of seats").counts
    assert not question_of("red boxes").counts


@pytest.mark.parametrize(("text", "complaint"), [
    ("something to sit on near the window", 'the word "window"'), ("a gren box", '"gren" (did you mean green?)'),
    ("a botle on a table", '"botle" (did you mean bottle?)'), ("how meny boxes", '"how" (did you mean how many?)'),
    ("a red botle", '"botle" (did you mean bottle?)'),
    (
        "a wine bottle",
        '"wine", which size, shape, colour and place of objects do not define; things that they define: ',
    ),
    ("", "what to look for"), ("a box on", 'ends after "on"'),
    ("taller than a box", "a length, e.g. taller than 0.5 m"), ("taller than", 'a length after "taller than"'),
    ("nearest box", '"nearest to"'), ("red " * 200, "800 characters"),
])  # fmt: skip
def test_what_is_no_question_is_refused_in_one_line(text, complaint):
    with pytest.raises(InputError, match=re.escape(complaint)) as refused:
        question_of(text)
    assert "\n" not in str(refused.value)


@given(st.lists(st.sampled_from(WORDS), max_size=12))
def test_words_in_any_order_are_a_question_or_refused(words):
    try:
        assert phrase_of(question_of(" ".join(words)).thing)
    except InputError:
        pass


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
