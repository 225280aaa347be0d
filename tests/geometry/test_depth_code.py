import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from hickory_stream.geometry.codecs.depth_code import packed_depths, unpacked_depths

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
def test_fewer_or_more_bytes_are_refused(cut):
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
