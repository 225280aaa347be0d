import numpy as np
import pytest
from hickory_stream.geometry.camera import Camera
from hickory_stream.records import Frame
from tools.evaluation.masks.boundaries import sides

CAMERA = Camera(width=40, height=30, fx=40.0, fy=40.0, cx=19.5, cy=14.5)


@pytest.mark.parametrize(("far_m", "red", "kind"), [(3.0, 90, 0), (1.0, 250, 1), (1.0, 90, 2)])
@pytest.mark.parametrize("is_drawn", [True, False])
def test_a_boundary_is_of_the_kind_that_shows_it(far_m, red, kind, is_drawn):
    right = np.arange(CAMERA.width)[None].repeat(CAMERA.height, axis=0) >= 20
    rgb = np.full((*right.shape, 3), 90, np.uint8)
    rgb[right, 0] = red
    depth = np.where(right, np.float32(far_m), np.float32(1.0))
    frame = Frame(index=0, stamp_ns=0, rgb=rgb, depth_m=depth, camera=CAMERA, world_from_camera=np.eye(4))
    masks = (1 + right * is_drawn).astype(np.int32)
    _, (pairs, kinds, differ) = sides(frame, 5 + 2 * right.astype(np.int64), masks)
    assert (pairs == (5, 7)).all()
    assert (kinds == kind).all()
    assert (differ == is_drawn).all()
    assert len(pairs) == 6 * CAMERA.height
