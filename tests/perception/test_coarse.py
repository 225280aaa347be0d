import numpy as np
import pytest
from hickory_stream.geometry.camera import Camera
from hickory_stream.perception.coarse import cells_of, coarse_frame, enlarged_cells

CAMERA = Camera(width=640, height=480, fx=500.0, fy=500.0, cx=319.5, cy=239.5)


@pytest.mark.parametrize(("width", "height", "stride"), [(640, 480, 4), (64, 48, 1), (1920, 1080, 12), (161, 3, 2)])
def test_a_pixel_amid_a_cell_is_found_to_the_millimetre(width, height, stride):
    rng = np.random.default_rng(width)
    depth = rng.uniform(0.3, 6.0, (height, width)).astype(np.float32)
    structure = rng.random((height, width)) < 0.5
    coarse = coarse_frame(depth, structure, CAMERA)
    assert coarse.stride_px == stride
    rows, columns = (np.arange(min(stride // 2, size - 1), size, stride) for size in (height, width))
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    depth_m, is_structure = cells_of(coarse, pixels)
    np.testing.assert_allclose(depth_m, depth[pixels[:, 1], pixels[:, 0]], atol=0.00051)
    np.testing.assert_array_equal(is_structure, structure[pixels[:, 1], pixels[:, 0]])


def test_what_is_no_return_or_too_far_to_tell_is_none():
    depth = np.array([[np.nan, np.inf, -1.0, 70.0, 65.0]], dtype=np.float32)
    depth_m, _ = cells_of(coarse_frame(depth, np.zeros((1, 5), bool), CAMERA), np.array([[i, 0] for i in range(5)]))
    np.testing.assert_array_equal(depth_m, [np.nan, np.nan, np.nan, np.nan, 65.0])


def test_cells_are_enlarged_to_the_frame_that_they_are_of():
    structure = np.random.default_rng(0).random((7, 323)) < 0.5
    coarse = coarse_frame(np.ones(structure.shape, np.float32), structure, CAMERA)
    large = enlarged_cells(coarse.structure, coarse.stride_px, (323, 7))
    assert large.shape == structure.shape
    pixels = np.stack(np.meshgrid(np.arange(323), np.arange(7)), axis=-1).reshape(-1, 2)
    np.testing.assert_array_equal(large.ravel(), cells_of(coarse, pixels)[1])
