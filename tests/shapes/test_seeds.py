import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy import ndimage
from hickory_stream.shapes.fit.seeds import chessboard_depth


@given(arrays.arrays(bool, arrays.array_shapes(min_dims=3, max_dims=3, max_side=8), elements=st.booleans()))
def test_depth_is_the_chessboard_distance_to_what_is_not_solid(solid):
    assert np.array_equal(chessboard_depth(solid), ndimage.distance_transform_cdt(solid, "chessboard"))


def test_a_cube_is_deepest_in_its_middle():
    solid = np.pad(np.ones((5, 5, 5), bool), 1)
    assert chessboard_depth(solid)[3, 3, 3] == 3
    assert chessboard_depth(solid).sum() == 5**3 + 3**3 + 1


def test_where_all_is_solid_no_depth_is_known():
    assert (chessboard_depth(np.ones((2, 3, 4), bool)) == -1).all()
