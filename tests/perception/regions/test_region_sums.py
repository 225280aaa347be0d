import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hickory_stream.geometry.camera import Camera
from hickory_stream.perception.regions.region_sums import region_sums
from hickory_stream.perception.surface import Surface
from tests.strategies import seeds

BIN_M = 0.01


@given(seeds, st.integers(1, 6))
@settings(max_examples=25)
def test_the_sums_are_those_over_the_pixels_of_each_part(seed, count):
    rng = np.random.default_rng(seed)
    shape = (12, 17)
    labels = rng.integers(0, count + 1, shape).astype(np.int32)
    labels[0, 0] = count
    supports = rng.integers(0, 3, shape).astype(np.int32)
    points, normals = rng.normal(size=(2, *shape, 3)).astype(np.float32)
    normals[3] = np.nan
    areas, depth = np.abs(rng.normal(size=(2, *shape))).astype(np.float32)
    lab = rng.normal(size=(*shape, 3)).astype(np.float32)
    surface = Surface(
        factor=1, camera=Camera(width=17, height=12, fx=10.0, fy=10.0, cx=8.0, cy=6.0), depth_m=depth,
        points_world=points, normals_world=normals, lab=lab, sigma_m=depth, world_from_camera=np.eye(4),
    )  # fmt: skip
    sums, middle, bottom_m = region_sums(surface, labels, supports, areas, BIN_M)
    place = points.astype(np.float64) - middle
    bins = ((points[..., 2].astype(np.float64) - bottom_m) / BIN_M).astype(np.int64)
    assert np.allclose(middle, points[labels > 0].mean(axis=0, dtype=np.float64))
    assert bottom_m == points[labels > 0, 2].min()
    for i in range(1, count + 1):
        own = labels == i
        assert sums.pixels[i] == own.sum()
        if not own.any():
            continue
        assert np.allclose([sums.area_m2[i], sums.depth_m[i]], [areas[own].sum(), depth[own].sum()], rtol=1e-5)
        assert np.isclose(sums.sigma_m[i], depth[own].sum(), rtol=1e-5)
        beside = own[:, 1:] & own[:, :-1]
        light, green, blue = (lab[:, 1:] - lab[:, :-1])[beside].T.astype(np.float64)
        grain = np.sqrt(0.25 * light**2 + green**2 + blue**2).sum()
        assert np.allclose(sums.grain[i], [grain, beside.sum()], rtol=1e-5)
        assert np.allclose(sums.lab[i], lab[own].sum(axis=0), atol=1e-4)
        assert np.allclose(sums.lab_squares[i], (lab[own] ** 2).sum(axis=0), rtol=1e-5)
        assert np.allclose(sums.place[i], place[own].sum(axis=0))
        assert np.allclose(sums.place_products[i], (place[own].T @ place[own])[np.triu_indices(3)])
        assert np.allclose(sums.normals[i], np.nansum(normals[own], axis=0), atol=1e-5)
        assert np.array_equal(sums.planes[i], np.bincount(supports[own], minlength=sums.planes.shape[1]))
        assert np.array_equal(sums.heights[i], np.bincount(bins[own], minlength=sums.heights.shape[1]))
        assert np.array_equal([sums.low[i], sums.high[i]], [points[own].min(axis=0), points[own].max(axis=0)])
    assert sums.pixels[0] == 0
