import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.perception.masks import enlarged, enlarged_mask, occluded_shares
from hickory_stream.perception.models.mask_pipeline import InstanceMask, MaskConfig, compose
from hickory_stream.perception.surface import SurfaceConfig, surface_of
from tests.perception.perception_scenes import CAMERA, Block, Cylinder, floor, looking, render

WOOD, WHITE, RED = (170, 130, 80), (225, 225, 220), (190, 40, 40)
TABLE = Block(low=(-0.4, -0.6, 0.69), high=(0.4, 0.6, 0.73), color=WOOD)
VIEW = looking((0.0, 0.0, 0.7), start=(-1.5, -0.2, 1.6))


def scene(*things):
    """Return the surface of a table with things on it, the mask of each, and no structure."""
    frame, shown = render([floor(), TABLE, *things], VIEW)
    return surface_of(frame, SurfaceConfig()), shown, np.zeros(shown.shape, bool)


def masked(mask, score=0.9):
    ys, xs = np.nonzero(mask)
    box = (int(xs.min()), int(ys.min()), int(xs.max()) + 1, int(ys.max()) + 1)
    return InstanceMask(box_px=box, mask=mask[box[1] : box[3], box[0] : box[2]], score=score)


def test_a_cup_inside_the_mask_of_a_table_stays_a_thing():
    surface, shown, nothing = scene(Cylinder(foot=(-0.1, 0.1, 0.73), radius=0.05, height=0.12, color=WHITE))
    whole, cup = shown >= 1, shown == 2
    instances, rejected = compose([masked(whole), masked(cup)], surface, nothing, MaskConfig())
    assert rejected == ()
    assert instances.max() == 2
    assert len(np.unique(instances[cup])) == 1
    assert (instances[cup] != instances[shown == 1][0]).all()


def test_a_magazine_on_a_table_stays_and_a_label_is_a_part():
    surface, shown, nothing = scene()
    flat = np.zeros(shown.shape, bool)
    ys, xs = np.nonzero(shown == 1)
    y, x = int(np.median(ys)), int(np.median(xs))
    flat[y - 12 : y + 12, x - 25 : x + 25] = True
    flat &= shown == 1
    instances, rejected = compose([masked(shown == 1), masked(flat)], surface, nothing, MaskConfig())
    assert (instances.max(), rejected) == (2, ())

    box = Block(low=(-0.2, -0.3, 0.73), high=(0.2, 0.3, 1.2), color=RED)
    surface, shown, nothing = scene(box)
    front = shown == 2
    ys, xs = np.nonzero(front)
    label = np.zeros(shown.shape, bool)
    y, x = int(np.quantile(ys, 0.75)), int(np.median(xs))
    label[y - 9 : y + 9, x - 20 : x + 20] = True
    instances, rejected = compose([masked(front), masked(label & front)], surface, nothing, MaskConfig())
    assert instances.max() == 1
    assert [r.reason for r in rejected] == ["part of a larger mask: nothing stands out"]


def test_of_two_masks_of_the_same_thing_the_better_scored_stays():
    surface, shown, nothing = scene()
    table = shown == 1
    smaller = table.copy()
    smaller[np.nonzero(table)[0].min()] = False
    instances, rejected = compose([masked(smaller, 0.5), masked(table, 0.9)], surface, nothing, MaskConfig())
    assert ((instances == 1) == table).all()
    assert "a better mask covers the same" in rejected[0].reason


def test_a_mask_made_up_of_others_is_left_out():
    left = Block(low=(-0.2, 0.05, 0.73), high=(0.1, 0.4, 1.0), color=RED)
    right = Block(low=(-0.2, -0.4, 0.73), high=(0.1, -0.05, 1.0), color=WHITE)
    surface, shown, nothing = scene(left, right)
    both = (shown == 2) | (shown == 3)
    masks = [masked(both, 0.95), masked(shown == 2), masked(shown == 3)]
    instances, rejected = compose(masks, surface, nothing, MaskConfig())
    assert instances.max() == 2
    assert ["made up of smaller masks" in r.reason for r in rejected] == [True]


def test_unusable_masks_are_rejected_with_their_reasons():
    surface, shown, _ = scene()
    small = np.zeros(shown.shape, bool)
    small[5:10, 5:10] = True
    on_floor = np.zeros(shown.shape, bool)
    on_floor[-60:, :100] = True
    structure = on_floor.copy()
    everything = np.ones(shown.shape, bool)
    instances, rejected = compose(
        [masked(small), masked(on_floor), masked(everything)], surface, structure, MaskConfig()
    )
    assert instances.max() == 0
    reasons = [r.reason for r in rejected]
    assert reasons[0] == "25 pixels, fewer than 240"
    assert reasons[1] == "100% of it is floor, wall or ceiling"
    assert reasons[2] == "100% of the image: the scene"


def test_a_mask_at_the_border_is_used():
    surface, shown, nothing = scene()
    cut = np.zeros(shown.shape, bool)
    cut[: CAMERA.height // 4, : CAMERA.width // 4] = True
    instances, _ = compose([masked(cut)], surface, nothing, MaskConfig(max_extent_m=100.0))
    assert ((instances == 1) == cut).all()


@pytest.mark.parametrize("masks", [[], [InstanceMask(box_px=(3, 3, 3, 3), mask=np.zeros((0, 0), bool))]])
def test_no_masks_and_empty_masks_give_no_instances(masks):
    surface, _, nothing = scene()
    instances, rejected = compose(masks, surface, nothing, MaskConfig())
    assert instances.max() == 0
    assert len(rejected) == len(masks)


@given(st.integers(1, 4), st.integers(0, 3), st.integers(0, 3), st.integers(0, 2**32 - 1))
def test_what_is_enlarged_repeats_pixels_and_is_nothing_beyond(factor, more_x, more_y, seed):
    labels = np.random.default_rng(seed).integers(0, 3, (4, 5)).astype(np.int32)
    size = (5 * factor + min(more_x, factor - 1), 4 * factor + min(more_y, factor - 1))
    expected = np.zeros((size[1], size[0]), dtype=np.int32)
    expected[: 4 * factor, : 5 * factor] = labels.repeat(factor, axis=0).repeat(factor, axis=1)
    assert np.array_equal(enlarged(labels, factor, size), expected)
    assert np.array_equal(enlarged_mask(labels == 1, factor, size), expected == 1)


def test_the_occluded_share_is_the_outline_behind_nearer_things():
    depth = np.full((6, 8), 2.0, dtype=np.float32)
    labels = np.zeros((6, 8), dtype=np.int32)
    labels[2:4, 2:5] = 1
    depth[2:4, 2:5] = 1.5
    labels[2:4, 5:7] = 2
    depth[2, 7] = 1.0
    depth[3, 7] = np.nan
    # 1: ten neighbours, none nearer; 2: eight, of which two of 1 and the one on its right are.
    assert occluded_shares(depth, labels, 3).tolist() == [0.0, 0.0, 3 / 8]
