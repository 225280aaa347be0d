from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.errors import InputError
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.superquadric import Superquadrics
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.query.answers import ask
from hickory_stream.query.colors import COLOR_NAMES, name_shares
from hickory_stream.query.grammar import UnknownWord
from hickory_stream.query.map_index import index_of
from hickory_stream.query.shape_scores import hollow_score, top_map
from tests.engine.snapshot_fixtures import box_mesh, make_object, make_view, placed
from tests.navigation.rooms import snapshot

# A bench and a low table are alike by their geometry.
TABLE, CRATE, BOWL, BENCH, BALL, PLATE = 1, 2, 3, 4, 5, 6


def body(object_id, at, size, color, exponents=(0.1, 0.1)):
    primitives = Superquadrics(
        exponents=[exponents], semi_axes_m=[np.array(size) / 2], world_from_local=placed(*at)[None]
    )
    item = make_object(object_id, box_mesh(size, color), placed(*at), views=(make_view(object_id, object_id, 0.0),))
    return replace(item, sketch=primitives)


def bowl(object_id, x, y):
    """A vessel of 0.3 m across and 0.15 m high, open above, on the floor."""
    angles = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    wall = [np.c_[0.15 * np.cos(angles), 0.15 * np.sin(angles), np.full(120, z)] for z in np.arange(0.0, 0.15, 0.01)]
    inside = [np.c_[r * np.cos(angles), r * np.sin(angles), np.full(120, 0.01)] for r in np.arange(0.0, 0.15, 0.01)]
    points = (np.concatenate([*wall, *inside]) + np.array([x, y, 0.0])).astype(np.float32)
    item = body(object_id, (x, y, 0.075), (0.3, 0.3, 0.15), (0, 0, 0), (0.1, 1.0))
    colors = np.tile(np.uint8([40, 90, 200]), (len(points), 1))
    return replace(item, points_world=points, colors=colors, box=gravity_aligned_box(points, 0.01))


def table(object_id):
    """A top of 1.2 x 0.8 m at 0.7 m with its legs."""
    x, y = np.meshgrid(np.arange(-0.6, 0.6, 0.02), np.arange(-0.4, 0.4, 0.02))
    top = np.c_[x.ravel(), y.ravel(), np.full(x.size, 0.7)]
    legs = [
        np.c_[np.full(35, a), np.full(35, b), np.arange(0, 0.7, 0.02)] for a in (-0.55, 0.55) for b in (-0.35, 0.35)
    ]
    points = (np.concatenate([top, *legs]) + np.array([1.5, 2.0, 0.0])).astype(np.float32)
    colors = np.tile(np.uint8([120, 80, 45]), (len(points), 1))
    item = body(object_id, (1.5, 2.0, 0.69), (1.2, 0.8, 0.02), (120, 80, 45))
    return replace(item, points_world=points, colors=colors, box=gravity_aligned_box(points, 0.01))


def room():
    return snapshot(
        table(TABLE), body(CRATE, (1.5, 2.1, 0.8), (0.3, 0.2, 0.2), (200, 40, 30)), bowl(BOWL, 1.5, 2.0),
        body(BENCH, (4.5, 3.0, 0.225), (1.3, 0.4, 0.45), (60, 140, 60)),
        body(BALL, (4.5, 2.4, 0.15), (0.3, 0.3, 0.3), (200, 40, 30), (1.0, 1.0)),
        body(PLATE, (4.5, 3.0, 0.46), (0.25, 0.25, 0.02), (240, 240, 240), (0.1, 1.0)),
    )  # fmt: skip


@pytest.fixture(scope="module")
def index():
    return index_of(room(), MappingConfig())


def ids(answers):
    return {answer.id for answer in answers.found}


@pytest.mark.parametrize(("text", "found"), [
    ("a red box", {CRATE}), ("red things", {CRATE, BALL}), ("a ball", {BALL}), ("a box on a table", {CRATE}),
    ("something carrying a box", {TABLE}), ("something under a table", {BOWL}), ("a container", {BOWL}),
    ("something to sit on", {BENCH}), ("a bench", {BENCH}), ("how many tables", {TABLE, BENCH}),
    ("a white flat thing", {PLATE}), ("something on a seat", {PLATE}), ("a thing beside a bench", {BALL}),
    ("the largest thing near object 5", {BENCH}), ("the smallest red thing", {CRATE, BALL}),
    ("the nearest red thing to 4,2", {BALL}), ("things on the floor and not brown", {BOWL, BENCH, BALL}),
    ("things longer than 1 m", {TABLE, BENCH}), ("things higher than 60 cm", {CRATE}),
    ("a red thing near 1.5,2", {CRATE}), ("a purple box", set()), ("a ball on a table", set()), ("a plate", {PLATE}),
    ("a bowl under a table", {BOWL}),
    *((word, set()) for word in ("a bottle", "a mug", "a lamp", "a shelf", "a screen", "a plant")),
])  # fmt: skip
def test_what_answers(index, text, found):
    assert ids(ask(index, text)) == found


# Sizes in metres of one thing of each kind, its form and its colour; each stands on the table, or on the floor.
KINDS = {
    "bottle": ((0.075, 0.075, 0.30), (0.1, 1.0), (40, 60, 50), True),
    "mug": ((0.12, 0.08, 0.082), (0.1, 1.0), (200, 60, 40), True),
    "screen": ((0.57, 0.18, 0.42), (0.1, 0.1), (20, 20, 20), True),
    "table lamp": ((0.3, 0.3, 0.6), (1.0, 1.0), (230, 220, 190), True),
    "floor lamp": ((0.4, 0.4, 1.6), (1.0, 1.0), (230, 220, 190), False),
    "bookcase": ((0.9, 0.3, 1.8), (0.1, 0.1), (120, 80, 45), False),
    "plant": ((0.6, 0.6, 1.0), (1.9, 1.9), (40, 140, 40), False),
    "cabinet": ((0.9, 0.6, 1.0), (0.1, 0.1), (120, 80, 45), False),
    "carton": ((0.07, 0.07, 0.2), (0.1, 0.1), (40, 90, 200), True),
}


@pytest.mark.parametrize("kind", KINDS)
def test_geometry_stands_in_for_common_things(kind):
    size, form, color, is_on_table = KINDS[kind]
    at = (1.5, 2.0, 0.7 + size[2] / 2) if is_on_table else (4.0, 2.0, size[2] / 2)
    index = index_of(snapshot(table(TABLE), body(2, at, size, color, form)), MappingConfig())
    words = ("bottle", "mug", "screen", "lamp", "shelf", "plant")
    named = {word for word in words if 2 in ids(ask(index, f"a {word}"))}
    assert named == {"bookcase": {"shelf"}, "cabinet": set(), "carton": set()}.get(kind, {kind.split()[-1]})


def test_left_and_right_change_places_with_the_viewer(index):
    # The ball lies beside the bench at smaller y: to the right of who looks along +x.
    for viewer, is_left in (((0.5, 3.0), False), ((5.9, 3.0), True)):
        assert ids(ask(index, "a ball left of a bench", viewer)) == ({BALL} if is_left else set())
        assert ids(ask(index, "a ball on the right of a bench", viewer)) == (set() if is_left else {BALL})


def test_in_front_and_behind_change_places_with_the_viewer(index):
    for viewer, front, back in (((4.5, 0.5), {BALL}, set()), ((4.5, 3.9), set(), {BALL})):
        assert ids(ask(index, "in front of a bench", viewer)) == front
        assert ids(ask(index, "behind a bench", viewer)) == back


def test_answers_are_ranked_and_say_why(index):
    answers = ask(index, "the smallest red thing")
    scores = [answer.score for answer in answers.found]
    assert answers.found[0].id == CRATE or scores[0] == scores[1]
    assert scores == sorted(scores, reverse=True)
    assert {text for text, _ in answers.found[0].why} == {"smallest", "red"}
    assert all(answer.score < 0.5 for answer in ask(index, "a purple box").nearly)


def test_an_unknown_landmark_or_relation_is_refused(index):
    with pytest.raises(InputError, match="found object 77"):
        ask(index, "on object 77")
    with pytest.raises(InputError, match="expected near or beside 1,2"):
        ask(index, "under 1,2")


def test_looks_and_geometry_are_asked_together(index):
    degrees = {TABLE: 0.9, CRATE: 0.8, BALL: 0.7}

    def looks(text):
        assert text in ("wooden", "wooden box", "wooden table")
        return np.array([degrees.get(i, 0.1) for i in index.ids.tolist()])

    assert not ask(index, "a mug").by_looks
    with pytest.raises(UnknownWord, match='"wooden"'):
        ask(index, "a wooden box")
    assert [answer.id for answer in ask(index, "something wooden", looks=looks).found] == [TABLE, CRATE, BALL]
    (crate,) = ask(index, "a wooden box on a table", looks=looks).found
    assert (crate.id, dict(crate.why)['looks like "wooden box"']) == (CRATE, 0.8)
    assert [answer.id for answer in ask(index, "box on a wooden table", looks=looks).found] == [CRATE]


def test_an_empty_map_has_no_answers_and_counts_none():
    empty = index_of(snapshot(), MappingConfig())
    assert ask(empty, "a red box near a ball").found == ()
    assert ask(empty, "the nearest box to 1,2").found == ()


@pytest.mark.parametrize(
    ("rgb", "name"),
    [
        ((10, 10, 10), "black"), ((128, 128, 128), "gray"), ((250, 250, 250), "white"), ((220, 20, 20), "red"),
        ((255, 140, 0), "orange"), ((120, 72, 32), "brown"), ((222, 196, 150), "beige"), ((240, 220, 30), "yellow"),
        ((30, 140, 50), "green"), ((30, 70, 200), "blue"), ((130, 40, 140), "purple"), ((255, 170, 190), "pink"),
    ],
)  # fmt: skip
def test_colours_have_the_names_that_css_gives_to_them(rgb, name):
    shares = name_shares(np.tile(np.uint8(rgb), (4, 1)))
    assert COLOR_NAMES[int(shares.argmax())] == name
    assert shares.sum() == pytest.approx(1.0)


def test_a_bowl_is_hollow_until_it_is_filled():
    item = bowl(1, 0.0, 0.0)
    assert hollow_score(top_map(item.points_world, item.box), 0.15) == 1.0
    x, y = np.meshgrid(np.arange(-0.14, 0.14, 0.01), np.arange(-0.14, 0.14, 0.01))
    lid = np.c_[x.ravel(), y.ravel(), np.full(x.size, 0.14)].astype(np.float32)
    assert hollow_score(top_map(np.concatenate([item.points_world, lid]), item.box), 0.15) == 0.0
