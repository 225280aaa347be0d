from dataclasses import replace

import numpy as np
import pytest
from perception_scenes import Block, best_iou, floor, looking, render

from hickory_stream.engine.processor import processor_of_run
from hickory_stream.perception.choose import make_segmenter
from hickory_stream.perception.geometric import GeometricConfig, GeometricSegmenter
from hickory_stream.perception.join import JoinConfig
from hickory_stream.perception.network_segmenter import (
    NetworkJoinConfig,
    NetworkSegmenter,
    Prepared,
    combined,
    corrected_structure,
)
from hickory_stream.perception.odds_features import ODDS_FEATURES
from hickory_stream.perception.perceive import PerceptionConfig
from hickory_stream.perception.pixel_network import NUM_OUTPUTS, ODDS_UNIT, ODDS_ZERO, OFFSETS, THING, PixelOdds

VIEW = looking((0.0, 0.0, 0.3), start=(-2.2, -0.3, 1.5))
LEFT = Block(low=(-0.15, 0.15, 0.0), high=(0.15, 0.45, 0.35), color=(190, 40, 40))
RIGHT = Block(low=(-0.15, -0.45, 0.0), high=(0.15, -0.15, 0.35), color=(190, 40, 40))


class Said:
    """A network that says what it was told to say."""

    def __init__(self, odds):
        self._odds = odds

    def odds(self, surface, floor_z_m):
        return PixelOdds(odds=self._odds)


class Asked:
    """Trees that join nothing and keep what they were asked first."""

    def __init__(self):
        self.inputs = None

    def probabilities(self, inputs):
        self.inputs = self.inputs or dict(inputs)
        return np.zeros(len(inputs["odds_near"]))


def even():
    return np.full((NUM_OUTPUTS, 120, 160), ODDS_ZERO, np.uint8)


@pytest.fixture(scope="module")
def two_boxes():
    return render([floor(), LEFT, RIGHT], VIEW)


@pytest.mark.parametrize("join", ["network", "both", "trees", "learned"])
def test_two_boxes_apart_are_two_instances_however_fragments_are_joined(two_boxes, join):
    frame, shown = two_boxes
    segmenter = make_segmenter(PerceptionConfig(segmenter="network", affinities=NetworkJoinConfig(join=join)))
    result = segmenter.segment(frame, None, segmenter.prepare(frame))
    (iou_left, label_left), (iou_right, label_right) = (best_iou(result.instances, shown == i) for i in (1, 2))
    assert min(iou_left, iou_right) > 0.8
    assert label_left != label_right
    assert result.structure[(shown == 0) & (frame.depth_m < 5.5)].mean() > 0.9


def test_with_even_odds_and_the_weight_of_the_trees_alone_both_decide_as_the_trees_do(two_boxes):
    frame, _ = two_boxes
    config = NetworkJoinConfig(join="both", trees_weight=1.0, odds_shift=0.0)
    ours = NetworkSegmenter(Said(even()), config, GeometricConfig()).segment(frame)
    trees = GeometricSegmenter(GeometricConfig()).segment(frame)
    np.testing.assert_array_equal(ours.instances, trees.instances)
    np.testing.assert_array_equal(ours.structure, trees.structure)


def test_trees_that_have_learned_ask_the_network_by_their_own_probability(two_boxes):
    frame, _ = two_boxes
    config = NetworkJoinConfig(join="learned", learned_probability=0.4)
    ours = NetworkSegmenter(Said(even()), config, GeometricConfig()).segment(frame)
    join = JoinConfig(forest="odds", probability=0.4)
    same = NetworkSegmenter(Said(even()), NetworkJoinConfig(join="trees"), GeometricConfig(join=join)).segment(frame)
    np.testing.assert_array_equal(ours.instances, same.instances)
    asked = Asked()
    NetworkSegmenter(Said(even()), config, GeometricConfig(), asked).segment(frame)
    assert set(ODDS_FEATURES) <= set(asked.inputs)
    assert (asked.inputs["odds_near"][np.isfinite(asked.inputs["odds_near"])] == 0).all()


def test_trees_that_have_learned_join_without_a_network_too(two_boxes):
    frame, shown = two_boxes
    join = JoinConfig(forest="odds", probability=NetworkJoinConfig().learned_probability)
    result = GeometricSegmenter(GeometricConfig(join=join)).segment(frame)
    assert min(best_iou(result.instances, shown == i)[0] for i in (1, 2)) > 0.8


def test_the_network_alone_joins_whatever_it_is_sure_of(two_boxes):
    frame, shown = two_boxes
    odds = even()
    odds[: len(OFFSETS)] = ODDS_ZERO + 6 * ODDS_UNIT
    instances = (
        NetworkSegmenter(Said(odds), NetworkJoinConfig(join="network"), GeometricConfig()).segment(frame).instances
    )
    assert best_iou(instances, (shown == 1) | (shown == 2))[0] > 0.8


def test_the_odds_of_the_network_move_those_of_the_trees_by_their_weights():
    config = NetworkJoinConfig(trees_weight=0.5, near_weight=0.5, far_odds_weight=0.25, odds_shift=0.5)
    features = {"odds_near": np.array([2.0, np.nan, -2.0]), "odds_far": np.array([4.0, np.nan, np.nan])}
    found = combined(np.array([0.5, 0.8, 0.5]), features, config)
    assert found == pytest.approx([1 / (1 + np.exp(-2.5)), 0.8, 1 / (1 + np.exp(0.5))])


def test_structure_is_corrected_both_ways_and_only_where_the_network_is_sure(two_boxes):
    frame, _ = two_boxes
    surface = GeometricSegmenter(GeometricConfig()).prepare(frame)
    odds = even()
    odds[THING, :, :50], odds[THING, :, 110:] = ODDS_ZERO + 4 * ODDS_UNIT, ODDS_ZERO - 4 * ODDS_UNIT
    structure = np.zeros((240, 320), bool)
    structure[100:] = True
    found = Prepared(surface=surface, odds=PixelOdds(odds=odds))
    corrected = corrected_structure(structure, found, NetworkJoinConfig(structure_odds=2.0, thing_odds=2.0))
    seen = np.isfinite(surface.depth_m)
    assert not corrected[:, :98].any()
    assert corrected[:, 222:][seen[:, 222:]].all()
    np.testing.assert_array_equal(corrected[:, 102:218], structure[:, 102:218])
    np.testing.assert_array_equal(corrected_structure(structure, found, NetworkJoinConfig()), structure)


def test_a_map_made_with_it_depends_on_no_processor():
    default = PerceptionConfig()
    of_network = processor_of_run(replace(default, segmenter="network"), is_own=True)
    assert of_network == processor_of_run(default, is_own=True)
    assert processor_of_run(replace(default, segmenter="fastsam"), is_own=True) != ""
