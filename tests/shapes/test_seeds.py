import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy import ndimage
from hickory_stream.shapes.fit.seeds import chessboard_depth


@given(arrays.arrays(bool, arrays.array_shapes(min_dims=3, max_dims=3, max_side=8), elements=st.booleans()))
def test_depth_is_the_chessboard_distance_to_what_is_not_solid(solid):
    assert np.array_equal(chessboard_depth(solid), ndimage.distance_transform_cdt(solid, "chessboard"))
