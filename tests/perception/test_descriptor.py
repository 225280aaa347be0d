from dataclasses import replace
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.perception.descriptor import ColorTextureDescriptor, _pixels_of_patches, mask_feature
from hickory_stream.perception.observe import observe
from hickory_stream.records import Segmentation

from tests.perception.perception_scenes import Block, looking, render  # isort: skip

DESCRIPTOR = ColorTextureDescriptor()


def observation_of_a_filled_image():
    wall = Block(low=(1.0, -9.0, -9.0), high=(1.2, 9.0, 9.0), color=(90, 140, 60))
    frame, shown = render([wall], looking((1.0, 0.0, 0.0), start=(0.0, 0.0, 0.0)))
    instances = (shown == 0).astype(np.int32)
    segmentation = Segmentation(instances=instances, structure=shown < 0, floor_z_m=None, rejected=())
    return frame, observe(frame, segmentation, Lattice())[0][0]


@given(height=st.integers(1, 60), width=st.integers(1, 60), seed=st.integers(0, 99))
def test_features_have_unit_norm_and_one_patch_per_14_pixels(height, width, seed):
    features = DESCRIPTOR.extract(np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8))
    assert features.shape == (-(-height // 14), -(-width // 14), DESCRIPTOR.dim)
    assert features.dtype == np.float32
    assert np.linalg.norm(features, axis=-1) == pytest.approx(1.0, abs=1e-5)


def test_wide_images_have_the_features_of_the_same_view_at_640():
    tiles = np.random.default_rng(0).integers(0, 256, (3, 64, 3), dtype=np.uint8)
    small, wide = (tiles.repeat(side, axis=0).repeat(side, axis=1) for side in (10, 20))
    features = DESCRIPTOR.extract(wide)
    assert features.shape[:2] == (5, 92)
    assert np.array_equal(features[::2, ::2], DESCRIPTOR.extract(small))


def test_a_plain_mask_has_no_variance_and_a_unit_feature():
    frame, observation = observation_of_a_filled_image()
    feature = mask_feature(observation, DESCRIPTOR.extract(frame.rgb), DESCRIPTOR.patch_px)
    assert feature.variance == pytest.approx(0.0, abs=1e-6)
    assert np.linalg.norm(feature.pooled) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_variance_is_at_most_one_and_grows_with_texture(seed):
    frame, observation = observation_of_a_filled_image()
    rgb = np.random.default_rng(seed).integers(0, 256, frame.rgb.shape, dtype=np.uint8)
    rgb[:, : rgb.shape[1] // 2] = (200, 30, 30)
    assert 0.01 < mask_feature(observation, DESCRIPTOR.extract(rgb), DESCRIPTOR.patch_px).variance <= 1.0


@given(st.integers(1, 12), st.integers(1, 8), st.integers(0, 999))
def test_no_unit_features_have_a_variance_above_one(side, dim, seed):
    """The bound of S rests on it, for any extractor: opposite features included."""
    rng = np.random.default_rng(seed)
    features = rng.standard_normal((side, side, dim)) + rng.choice([0.0, 3.0])
    features = (features / np.linalg.norm(features, axis=-1, keepdims=True)).astype(np.float32)
    mask = rng.random((4 * side, 4 * side)) < 0.7
    mask[0, 0] = True
    weight = mask.reshape(side, 4, side, 4).sum(axis=(1, 3)) / mask.sum()
    mean = np.tensordot(weight, features, axes=2)
    if np.linalg.norm(mean) < 1e-3:
        return  # has no direction
    _, observation = observation_of_a_filled_image()
    feature = mask_feature(replace(observation, mask=mask, box_px=(0, 0, 4 * side, 4 * side)), features, 4)
    assert 0.0 <= feature.variance <= 1.0
    assert feature.variance == pytest.approx(1.0 - float(mean @ mean), abs=1e-5)


def test_patches_of_two_colours_are_unlike():
    red, blue = (np.full((28, 28, 3), color, dtype=np.uint8) for color in ((190, 40, 40), (40, 60, 190)))
    a, b = DESCRIPTOR.extract(red)[0, 0], DESCRIPTOR.extract(blue)[0, 0]
    assert float(a @ b) < 0.3


@given(st.integers(0, 2**32 - 1), st.integers(0, 9), st.integers(0, 9))
def test_patches_count_the_pixels_of_a_mask(seed, x0, y0):
    mask = np.random.default_rng(seed).random((25, 31)) < 0.4
    counts = _pixels_of_patches(mask, x0, y0, 14, 3, 3)
    expected = np.zeros((3, 3))
    np.add.at(expected, tuple((np.argwhere(mask) + np.array([y0, x0])).T // 14), 1.0)
    assert np.array_equal(counts, expected)
