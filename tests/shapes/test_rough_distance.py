import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage
from hickory_stream.shapes.reconstruct.meshing import rough_distance


@given(st.integers(0, 1000), st.integers(1, 12), st.tuples(*[st.integers(1, 14)] * 3))
def test_distances_are_those_of_the_transform_up_to_the_reach(seed, reach, shape):
    rng = np.random.default_rng(seed)
    solid = ndimage.uniform_filter(rng.random(shape), 3) > rng.uniform(0.35, 0.65)
    found = rough_distance(solid, reach)
    far = np.full(shape, float(reach))
    away = ndimage.distance_transform_edt(~solid) if solid.any() else far
    deep = ndimage.distance_transform_edt(solid) if not solid.all() else far
    truth = np.where(solid, 0.5 - np.minimum(deep, reach), np.minimum(away, reach) - 0.5)
    assert np.array_equal(found, truth.astype(np.float32))
