from dataclasses import replace
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hickory_stream.perception.geometric_segmenter import GeometricConfig, GeometricSegmenter
from hickory_stream.perception.regions.join import Groups, JoinConfig, region_graph_of, rounds
from hickory_stream.perception.regions.odds_features import ODDS_FEATURES
from hickory_stream.perception.regions.pair_features import pair_features
from hickory_stream.perception.regions.region_graph import merged_pairs, merged_regions
from hickory_stream.perception.regions.trees import embedded_trees
from tests.perception.perception_scenes import Block, Cylinder, floor, looking, render

VIEW = looking((0.0, 0.0, 0.4), start=(-1.6, -0.3, 1.4))
RED, BLUE, WOOD = (190, 40, 40), (40, 60, 190), (170, 130, 80)


@pytest.fixture(scope="module")
def pieces():
    table = Block(low=(-0.3, -0.5, 0.5), high=(0.3, 0.5, 0.54), color=WOOD)
    leg = Block(low=(-0.05, -0.05, 0.0), high=(0.05, 0.05, 0.5), color=WOOD)
    boxes = [Block(low=(-0.1, y, 0.54), high=(0.1, y + 0.15, 0.7), color=c) for y, c in ((-0.3, RED), (-0.1, BLUE))]
    mug = Cylinder(foot=(-0.1, 0.3, 0.54), radius=0.05, height=0.1, color=BLUE)
    frame, _ = render([floor(), table, leg, *boxes, mug], VIEW)
    return GeometricSegmenter(GeometricConfig()).fragments(frame)


def measures_of(pieces, labels):
    return region_graph_of(replace(pieces, labels=labels))


@pytest.fixture(scope="module")
def graph(pieces):
    return measures_of(pieces, pieces.labels)


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 2**32 - 1))
def test_groups_are_measured_as_if_they_had_been_one_fragment(pieces, graph, seed):
    count = len(graph.regions.pixels)
    drawn = np.random.default_rng(seed).integers(1, count, count - 1)
    numbers = np.append(0, np.unique(drawn, return_inverse=True)[1] + 1)
    groups = int(numbers.max()) + 1
    anew = measures_of(pieces, numbers.astype(np.int32)[pieces.labels])
    regions = merged_regions(graph.regions, numbers, groups)
    for name in ("pixels", "area_m2", "lab", "place", "place_products", "normals", "planes", "heights", "low", "high"):
        np.testing.assert_allclose(getattr(regions, name), getattr(anew.regions, name), atol=1e-6, err_msg=name)
    # What only `anew` graph is between pixels that were of one fragment before.
    pairs, direct = merged_pairs(graph.pairs, numbers), anew.pairs
    np.testing.assert_array_equal(pairs.a * groups + pairs.b, direct.a * groups + direct.b)
    for name in ("meet", "touch", "lean", "parallel", "contrast", "nearer", "above", "step_m"):
        np.testing.assert_allclose(getattr(pairs, name), getattr(direct, name), atol=1e-6, err_msg=name)


def test_large_and_small_do_not_depend_on_the_order_of_labels(pieces, graph):
    count = len(graph.regions.pixels)
    pairs, features = pair_features(graph, np.arange(count), count)
    turned = np.append(0, np.arange(count - 1, 0, -1))
    other_pairs, other = pair_features(
        measures_of(pieces, turned.astype(np.int32)[pieces.labels]), np.arange(count), count
    )
    place = {tuple(turned[pair]): i for i, pair in enumerate(other_pairs.tolist())}
    uneven = [i for i, (a, b) in enumerate(pairs) if graph.regions.pixels[a] != graph.regions.pixels[b]]
    assert len(uneven) >= 5
    order = [place[tuple(pairs[i])] for i in uneven]
    for name, values in features.items():
        if not name.startswith(("seam_width", "seam_height", "seam_in")):  # taken on the side of the lower label
            np.testing.assert_allclose(other[name][order], values[uneven], atol=1e-5, err_msg=name)


def test_absolute_colours_and_heights_do_not_join_things(pieces, graph):
    count = len(graph.regions.pixels)
    surface = pieces.surface
    elsewhere = replace(
        surface,
        lab=surface.lab + np.array([8, -6, 11], np.float32),
        points_world=surface.points_world + np.array([0, 0, 1], np.float32),
    )
    moved = measures_of(replace(pieces, surface=elsewhere), pieces.labels)
    pairs, before = pair_features(graph, np.arange(count), count)
    other_pairs, after = pair_features(moved, np.arange(count), count)
    np.testing.assert_array_equal(other_pairs, pairs)
    sizes = (
        "_m", "_m2", "_m3", "_pixels", "_members", "_light", "_chroma", "touch", "bridged_level", "bridged_upright",
    )  # fmt: skip
    bins = ("lows", "highs", "over_", "height", "seam_in")
    for name, values in before.items():
        if not name.endswith(sizes) and not any(
            word in name for word in bins
        ):  # heights are counted in bins of a centimetre
            np.testing.assert_allclose(after[name], values, atol=0.06, err_msg=name)


def test_a_darker_neighbour_is_as_far_as_its_surface_is_rough(pieces, graph):
    count = len(graph.regions.pixels)
    rng = np.random.default_rng(0)
    noisy = pieces.surface.lab + rng.normal(0, 8, pieces.surface.lab.shape).astype(np.float32)
    rough = measures_of(replace(pieces, surface=replace(pieces.surface, lab=noisy)), pieces.labels)
    _, smooth_seams = pair_features(graph, np.arange(count), count)
    _, rough_seams = pair_features(rough, np.arange(count), count)
    sharp = (smooth_seams["seam_contrast"] > 20) & (smooth_seams["seam_grains"] > 1)
    assert sharp.sum() >= 3
    assert (rough_seams["seam_grains"][sharp] < 0.3 * smooth_seams["seam_grains"][sharp]).all()


def test_each_round_joins_what_is_likeliest_for_both_sides(graph):
    steps = list(rounds(graph, lambda features: np.ones(len(features["aside"])), JoinConfig(), most=50))
    assert (np.diff([step.numbers.max() for step in steps]) < 0).all()
    assert len(steps[-1].pairs) == 0 or steps[-1].numbers.max() == 1


def test_the_trees_ask_only_for_what_a_round_tells(graph):
    trees = embedded_trees()
    step = next(rounds(graph, trees.probabilities, JoinConfig(), most=0))
    assert set(trees.features) <= set(step.features)
    assert not set(ODDS_FEATURES).isdisjoint(trees.features)
    found = trees.probabilities(step.features)
    assert ((found > 0) & (found < 1)).all()


def test_nothing_is_joined_that_is_not_likely(graph):
    steps = list(rounds(graph, lambda features: np.full(len(features["aside"]), 0.3), JoinConfig(probability=0.31)))
    assert len(steps) == 1
    np.testing.assert_array_equal(steps[0].numbers, np.arange(len(graph.regions.pixels)))


def test_no_more_rounds_than_asked_for(graph):
    def by_size(features):
        return features["small_pixels"] / 20

    steps = list(rounds(graph, by_size, JoinConfig(probability=0.0), most=1))
    assert len(steps) == 2


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), max_size=12), st.randoms())
def test_groups_do_not_depend_on_the_order_of_joining(pairs, random):
    one, other = Groups(10), Groups(10)
    one.unite(pairs)
    random.shuffle(pairs)
    other.unite(pairs)
    np.testing.assert_array_equal(one.numbers()[0], other.numbers()[0])
    assert all(one.numbers()[0][a] == one.numbers()[0][b] for a, b in pairs)
