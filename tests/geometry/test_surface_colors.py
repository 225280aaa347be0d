import zlib
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.geometry.codecs.color_code import packed_colors, unpacked_colors
from hickory_stream.geometry.codecs.packing import color_planes
from hickory_stream.geometry.voxels import keys_of_cells, sorted_unique
from tests.strategies import integer_cells, seeds


@given(integer_cells(largest=6) | integer_cells(), seeds)
def test_colours_come_back(cells, seed):
    keys = sorted_unique(keys_of_cells(cells))
    colors = np.random.default_rng(seed).integers(0, 256, (len(keys), 3)).astype(np.uint8)
    assert unpacked_colors(keys, packed_colors(keys, colors)).tolist() == colors.tolist()


@given(st.integers(0, 255), st.integers(0, 255), st.integers(0, 255))
def test_of_a_surface_of_one_colour_only_the_first_voxel_says_it(red, green, blue):
    keys = sorted_unique(keys_of_cells(np.stack(np.mgrid[:5, :6, :1], axis=-1).reshape(-1, 3)))
    left = packed_colors(keys, np.tile(np.uint8([red, green, blue]), (len(keys), 1)))
    assert left[:, 0].tolist() == [(red - green) % 256, green, (blue - green) % 256]
    assert not left[:, 1:].any()


def test_a_noisy_pattern_takes_less_than_by_the_order_of_keys():
    x, y = np.mgrid[:60, :60].reshape(2, -1)
    z = (x + y) // 3
    keys = keys_of_cells(np.stack([x, y, z], axis=-1))
    order = np.argsort(keys)
    shade = 128 + 90 * np.sin(x / 9) * np.cos(y / 7)
    noise = np.random.default_rng(0).normal(0, 3, (len(x), 3))
    colors = np.clip(shade[:, None] + noise, 0, 255).astype(np.uint8)[order]
    packed = zlib.compress(packed_colors(keys[order], colors).tobytes())
    assert len(packed) < 0.95 * len(zlib.compress(color_planes(colors)))
    assert unpacked_colors(keys[order], packed_colors(keys[order], colors)).tolist() == colors.tolist()
