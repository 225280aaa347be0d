import numpy as np
import pytest
from hickory_stream.errors import ModelError
from hickory_stream.perception.choose import make_segmenter
from hickory_stream.perception.masks import InstanceMask
from hickory_stream.perception.perceive import PerceptionConfig
from hickory_stream.perception.regions.mask_evidence import divided_by_masks, evidence_of, sampled_masks
from tests.perception.perception_scenes import CAMERA, Block, best_iou, floor, looking, render

RED = (190, 40, 40)
VIEW = looking((0.0, 0.0, 0.3), start=(-2.2, -0.3, 1.5))
TABLE = Block(low=(-0.4, -0.6, 0.69), high=(0.4, 0.6, 0.73), color=(170, 130, 80))
ABOVE = looking((0.0, 0.0, 0.7), start=(-1.5, -0.2, 1.6))


def masked(mask, score=0.9):
    ys, xs = np.nonzero(mask)
    box = (int(xs.min()), int(ys.min()), int(xs.max()) + 1, int(ys.max()) + 1)
    return InstanceMask(box_px=box, mask=mask[box[1] : box[3], box[0] : box[2]], score=score)


@pytest.fixture(scope="module")
def segmenter():
    return make_segmenter(PerceptionConfig())


def likelihood(masks, labels, before):
    """Return the probability that fragments 1 and 2 are one."""
    evidence, count = evidence_of(np.array(masks).reshape(-1, *labels.shape), labels), int(labels.max()) + 1
    return evidence.combined(np.array([before]), np.array([[1, 2]]), np.arange(count), count)[0]


def test_a_whole_joins_a_part_divides_and_geometry_decides_between_them():
    labels = np.ones((20, 20), np.int32)
    labels[:, 10:] = 2
    whole, part = np.ones(labels.shape, bool), labels == 1
    assert likelihood([], labels, 0.5) == 0.5
    assert likelihood([whole], labels, 0.1) > 0.5
    assert likelihood([part], labels, 0.9) < 0.5
    assert likelihood([whole, part], labels, 0.05) < 0.3 < 0.5 < likelihood([whole, part], labels, 0.95)


def test_a_fragment_is_divided_where_a_mask_ends_but_not_at_its_outline():
    labels = np.zeros((40, 40), np.int32)
    labels[4:36, 4:36] = 1
    half, nearly = np.zeros((2, 40, 40), bool)
    half[:, :20], nearly[5:36, 4:36] = True, True
    divided = divided_by_masks(labels, half[None])
    assert [len(np.unique(divided[4:36, x])) for x in (4, 19, 20, 35)] == [1, 1, 1, 1]
    assert (divided[10, 19], divided[10, 20]) == (1, 2)
    assert (divided_by_masks(labels, nearly[None]) == labels).all()


@pytest.mark.parametrize("factor", [1, 2, 3])
def test_a_mask_is_sampled_where_the_labels_are(factor):
    whole = np.random.default_rng(factor).random((24, 36)) < 0.3
    few = sampled_masks([masked(whole)], factor, (24 // factor, 36 // factor))
    assert (few[0] == whole[factor // 2 :: factor, factor // 2 :: factor][: 24 // factor, : 36 // factor]).all()


def test_masks_of_nothing_and_of_the_scene_are_no_evidence(segmenter):
    frame, _ = render([floor(), TABLE], ABOVE)
    nothing = InstanceMask(box_px=(3, 3, 3, 3), mask=np.zeros((0, 0), bool))
    scene = masked(np.ones((CAMERA.height, CAMERA.width), bool))
    alone, found = segmenter.segment(frame), segmenter.segment_with([nothing, scene], frame)
    assert (found.instances == alone.instances).all()
    assert (found.structure == alone.structure).all()


def test_a_mask_over_two_things_apart_in_depth_is_divided(segmenter):
    near = Block(low=(-0.7, -0.25, 0.0), high=(-0.5, 0.0, 0.35), color=RED)
    far = Block(low=(0.3, -0.1, 0.0), high=(0.6, 0.3, 0.6), color=(40, 60, 180))
    frame, shown = render([floor(), near, far], VIEW)
    found = segmenter.segment_with([masked(shown >= 1)], frame)
    (iou_near, label_near), (iou_far, label_far) = (best_iou(found.instances, shown == i) for i in (1, 2))
    assert min(iou_near, iou_far) > 0.8
    assert label_near != label_far


def test_a_mask_beyond_the_frame_is_refused(segmenter):
    frame, _ = render([floor(), TABLE], ABOVE)
    large = InstanceMask(box_px=(0, 0, CAMERA.width + 1, 5), mask=np.ones((5, CAMERA.width + 1), bool))
    with pytest.raises(ModelError, match="320x240"):
        segmenter.segment_with([large], frame)
