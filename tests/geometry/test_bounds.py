import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from hickory_stream.geometry.bounds import bounds_of, extent_of


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@given(data=st.data())
def test_bounds_are_least_and_greatest_in_the_points_precision(dtype, data):
    width = np.dtype(dtype).itemsize * 8
    points = data.draw(arrays(dtype, (data.draw(st.integers(1, 9)), 3), elements=st.floats(-9, 9, width=width)))
    bounds = bounds_of(points)
    assert bounds.dtype == dtype
    assert np.array_equal(bounds, [points.min(axis=0), points.max(axis=0)])
    assert np.array_equal(extent_of(points), np.ptp(points, axis=0))
