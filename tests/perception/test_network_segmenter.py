from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.engine.shape_jobs.processor import processor_of_run
from hickory_stream.perception.affinity.pixel_network import NUM_OUTPUTS, ODDS_UNIT, ODDS_ZERO, THING, PixelOdds
from hickory_stream.perception.choose import make_segmenter
from hickory_stream.perception.geometric_segmenter import GeometricConfig, GeometricSegmenter
from hickory_stream.perception.network_segmenter import NetworkJoinConfig, NetworkSegmenter, thing_log_odds
from hickory_stream.perception.perceive import PerceptionConfig
from hickory_stream.perception.regions.join import JoinConfig
from hickory_stream.perception.regions.odds_features import ODDS_FEATURES
from tests.perception.perception_scenes import Block, best_iou, floor, looking, render

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


def test_a_mask_that_the_network_takes_for_the_room_is_rejected(two_boxes):
    frame, shown = two_boxes
    odds = even()
    columns = np.flatnonzero((shown == 1).any(axis=0)) * 160 // shown.shape[1]
    odds[THING, :, columns.min() - 1 : columns.max() + 2] = ODDS_ZERO - 3 * ODDS_UNIT
    masks, reasons = {}, {}
    for shift in (-1.0, -8.0):
        config = NetworkJoinConfig(structure_shift=shift)
        result = NetworkSegmenter(Said(odds), config, GeometricConfig()).segment(frame)
        masks[shift] = [best_iou(result.instances, shown == i)[0] for i in (1, 2)]
        reasons[shift] = [mask.reason for mask in result.rejected]
    assert masks[-1.0][0] < 0.2
    assert masks[-1.0][1] > 0.8
    assert min(masks[-8.0]) > 0.8
    assert any("part of the room" in reason for reason in reasons[-1.0])
    assert not any("part of the room" in reason for reason in reasons[-8.0])


def test_two_boxes_apart_are_two_instances(two_boxes):
    frame, shown = two_boxes
    segmenter = make_segmenter(PerceptionConfig(segmenter="network"))
    result = segmenter.segment(frame, None, segmenter.prepare(frame))
    (iou_left, label_left), (iou_right, label_right) = (best_iou(result.instances, shown == i) for i in (1, 2))
    assert min(iou_left, iou_right) > 0.8
    assert label_left != label_right
    assert result.structure[(shown == 0) & (frame.depth_m < 5.5)].mean() > 0.9


def test_trained_trees_ask_the_network_by_their_probability(two_boxes):
    frame, _ = two_boxes
    asked = Asked()
    geometric = GeometricConfig(join=JoinConfig(probability=0.4))
    NetworkSegmenter(Said(even()), NetworkJoinConfig(), geometric, asked).segment(frame)
    assert set(ODDS_FEATURES) <= set(asked.inputs)
    assert (asked.inputs["odds_near"][np.isfinite(asked.inputs["odds_near"])] == 0).all()


def test_trees_that_have_learned_join_without_a_network_too(two_boxes):
    frame, shown = two_boxes
    result = GeometricSegmenter(GeometricConfig()).segment(frame)
    assert min(best_iou(result.instances, shown == i)[0] for i in (1, 2)) > 0.8


def test_a_map_made_with_it_depends_on_no_processor():
    default = PerceptionConfig()
    of_network = processor_of_run(replace(default, segmenter="network"), is_own=True)
    assert of_network == processor_of_run(default, is_own=True)
    assert processor_of_run(replace(default, segmenter="fastsam"), is_own=True) != ""


def test_a_mask_has_the_mean_odds_of_its_pixels_or_none():
    labels = np.zeros((6, 8), dtype=np.int32)
    labels[:, :4] = 1
    labels[1, 5] = 2  # between the outputs, which are those of even rows and columns
    odds = np.full((NUM_OUTPUTS, 3, 4), ODDS_ZERO, dtype=np.uint8)
    odds[THING, :, 0] = ODDS_ZERO + 2 * ODDS_UNIT
    odds[THING, :, 1] = ODDS_ZERO - 4 * ODDS_UNIT
    np.testing.assert_array_equal(thing_log_odds(labels, PixelOdds(odds=odds)), [0.0, -1.0, np.nan])
