from dataclasses import replace
import numpy as np
from hypothesis import given, settings
from hickory_stream.alignment.object_map import ObjectMap, shape_box
from hickory_stream.alignment.shape_scores import box_scores, literal_scores, point_scores, superquadric_scores
from hickory_stream.geometry.superquadric import Superquadrics, implicit_value, taken
from tests.alignment.map_fixtures import box_at, frame
from tests.strategies import seeds
from tools.evaluation.simulated_maps.simulate import real_fits
from tools.evaluation.simulated_maps.variants import moved_map


def map_of(shapes):
    count = len(shapes)
    return ObjectMap(
        ids=np.arange(count), centroids=np.zeros((count, 3)), features=None, shapes=tuple(shapes),
        boxes=tuple(box_at(np.zeros(3)) for _ in shapes), points=(None,) * count,
    )  # fmt: skip


@settings(max_examples=15)
@given(seed=seeds)
def test_a_shape_equals_itself_in_any_order_and_heading(seed):
    rng = np.random.default_rng(seed)
    shapes = [real_fits()[i] for i in rng.choice(len(real_fits()), 4, replace=False)]
    shuffled = [taken(shape, rng.permutation(len(shape))) for shape in shapes]
    turned = moved_map(map_of(list(shuffled)), frame(rng.uniform(0, 360), 3.0, -1.0))
    scores = superquadric_scores(map_of(list(shapes)), turned)
    assert np.allclose(np.diag(scores), 1.0)
    assert scores.max() <= 1 + 1e-9
    assert scores.min() >= 0
    assert np.allclose(scores, superquadric_scores(turned, map_of(list(shapes))).T)


def test_losing_a_small_part_costs_little():
    for shape in real_fits()[:10]:
        if len(shape) > 4:
            rest = taken(shape, np.arange(len(shape) - 1))
            assert superquadric_scores(map_of([shape]), map_of([rest]))[0, 0] > 0.8


def test_an_object_without_shape_has_no_score():
    scores = superquadric_scores(map_of([None, real_fits()[0]]), map_of([real_fits()[0], None]))
    assert np.isnan(scores[0]).all()
    assert scores[1, 0] > 0.999
    assert np.isnan(scores[1, 1])
    assert np.isnan(superquadric_scores(map_of([None]), map_of([None]))).all()


def test_the_literal_score_is_the_papers_formula():
    def two(e, large):
        return Superquadrics(
            exponents=np.array([[e, 1.0], [1.0, 1.0]]),
            semi_axes_m=np.array([[large, large, large], [0.5, 0.5, 0.5]]),
            world_from_local=np.tile(np.eye(4), (2, 1, 1)),
        )

    # Two unit balls' shares: 8/9 and 1/9 each; exponents 0.2 apart, axes 1 : 0.8; sigma 1.
    one = two(1.0, 1.0)
    other = replace(two(1.2, 0.8), semi_axes_m=np.array([[0.8] * 3, [0.5] * 3]))
    volume = [1.0, 0.5**3]
    share_a = volume[0] / sum(volume)
    score = literal_scores(map_of([one]), map_of([one]))[0, 0]
    assert np.isclose(score, 1.0)
    found = literal_scores(map_of([one]), map_of([other]))[0, 0]
    assert share_a * np.exp(-0.2) * 0.8 * 0.9 < found < np.exp(-0.2) * 0.8 + 0.25


def test_the_box_of_a_shape_holds_it_and_touches_it():
    rng = np.random.default_rng(0)
    for shape in real_fits()[:6]:
        box = shape_box(shape)
        points = box.center + rng.uniform(-2, 2, (4000, 3)) * box.half_extents_m
        inside = np.any([implicit_value(shape, i, points) <= 1 for i in range(len(shape))], axis=0)
        assert box.contains(points[inside], 0.02).all()


def test_boxes_and_clouds_of_one_object_score_one():
    cloud = np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32) * np.float32([1, 0.5, 0.1])
    plain = replace(map_of([None]), points=(cloud,))
    assert np.isclose(box_scores(plain, plain), 1.0).all()
    assert np.isclose(point_scores(plain, moved_map(plain, frame(70, 1, 2))), 1.0, atol=1e-3).all()
    assert np.isnan(point_scores(map_of([None]), plain)).all()
