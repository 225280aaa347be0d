import zlib
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from hickory_stream.geometry.codecs.color_code import packed_colors, unpacked_colors, unpacked_means
from hickory_stream.geometry.codecs.depth_code import packed_depths, unpacked_depths
from hickory_stream.geometry.codecs.packing import color_planes
from hickory_stream.geometry.lattice import MESH_STEPS_PER_M, STEPS_PER_M, packed_points, points_of, unpacked_steps
from hickory_stream.geometry.voxels import keys_of_cells, sorted_unique
from tests.strategies import integer_cells, seeds

# Mean colours as journals until 2026-11 have them; the third is no mean.
MEANS = np.float32([[10, 20, 30], [100 / 3, 151 / 3, 200 / 3], [0.1, np.nan, 1], [127.50001, 1.25, 254.75]])
STORED = bytes.fromhex(
    "f6f9117e141ece010a06f0fd01030004000100020001000100020003000000020000000000000000cdcccc3d0000c07f0000803f"
)


def test_means_of_before_come_back_to_the_bit():
    assert unpacked_means(STORED, len(MEANS)).tobytes() == MEANS.tobytes()


@pytest.mark.parametrize("change", [lambda data: data[:-1], lambda data: data + b"\0", lambda data: data[:20]])
def test_fewer_or_more_bytes_are_refused(change):
    with pytest.raises(ValueError, match="4 mean colours in"):
        unpacked_means(change(STORED), len(MEANS))


@given(st.binary(max_size=60), st.integers(0, 6))
def test_foreign_bytes_give_colours_or_are_refused(data, count):
    try:
        assert unpacked_means(data, count).shape == (count, 3)
    except ValueError:
        pass


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


IMAGES = hnp.arrays(
    np.uint16,
    hnp.array_shapes(min_dims=2, max_dims=2, min_side=0, max_side=9),
    elements=st.sampled_from([0, 1, 2, 1000, 1001, 1254, 1255, 1256, 1257, 32768, 65535]) | st.integers(0, 65535),
)


@given(st.lists(IMAGES, max_size=4))
def test_images_come_back_to_the_millimetre(images):
    read = unpacked_depths(packed_depths(images), [image > 0 for image in images])
    assert [image.tolist() for image in read] == [image.tolist() for image in images]


def test_a_slope_takes_a_byte_for_each_return_of_the_same_value():
    rows, columns = np.mgrid[:40, :60]
    slope = (1500 + 3 * columns - 2 * rows).astype(np.uint16)
    data = packed_depths([slope])
    # What the first row and column cannot be told from takes more: the very first return two bytes.
    assert len(data) == slope.size + 2
    assert np.count_nonzero(np.frombuffer(data, np.uint8)) <= 60 + 40 + 2


def test_an_edge_takes_what_a_slope_does():
    image = np.full((50, 50), 1000, np.uint16)
    image[:, 20:] = 3000
    image[10:30, 5:15] = 0
    assert len(packed_depths([image])) <= np.count_nonzero(image) + 2 * 2


@pytest.mark.parametrize("cut", [1, 2, 3])
def test_fewer_or_more_bytes_of_depths_are_refused(cut):
    image = np.array([[1, 5000], [40_000, 3]], np.uint16)
    data = packed_depths([image])
    with pytest.raises(ValueError, match="4 returns in"):
        unpacked_depths(data[:-cut], [image > 0])
    with pytest.raises(ValueError, match="4 returns in"):
        unpacked_depths(data + b"\0" * cut, [image > 0])


def test_a_return_of_no_depth_is_refused():
    with pytest.raises(ValueError, match="no depth"):
        unpacked_depths(b"\0", [np.ones((1, 1), bool)])


@given(st.binary(max_size=40), IMAGES)
def test_foreign_bytes_give_an_image_or_are_refused(data, where):
    try:
        (image,) = unpacked_depths(data, [where > 0])
    except ValueError:
        return
    assert ((image > 0) == (where > 0)).all()


STEPS = hnp.arrays(np.int32, st.tuples(st.integers(0, 20), st.just(3)), elements=st.integers(-(2**24) + 1, 2**24 - 1))


@given(STEPS, st.sampled_from([STEPS_PER_M, MESH_STEPS_PER_M]))
def test_points_at_steps_come_back_to_the_bit(steps, steps_per_m):
    points = points_of(steps, steps_per_m)
    data = packed_points(points, steps_per_m)
    assert len(data) == 12 * len(points)
    assert points_of(unpacked_steps(data, len(points)), steps_per_m).tobytes() == points.tobytes()


def test_steps_are_deltas_with_lowest_bytes_first():
    points = np.array([[1, -1, 300], [1, 0, 298]], np.float32) / np.float32(STEPS_PER_M)
    # 0, -1, 1, -2, ... as 0, 1, 2, 3, ...: x 1 and 0, y -1 and 1, z 300 and -2.
    assert packed_points(points) == bytes([2, 0, 1, 2, 600 % 256, 3, 0, 0, 0, 0, 600 // 256, 0, *(0,) * 12])


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -0.0, 512.0, -512.0, 1e-6])
def test_what_is_at_no_step_or_too_far_is_not_packed(value):
    points = np.zeros((3, 3), np.float32)
    assert packed_points(points) is not None
    points[1, 2] = value
    assert packed_points(points) is None
