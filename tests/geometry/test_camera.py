import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.geometry.camera import Camera, backproject, project
from tests.strategies import cameras, seeds


def rays(camera, pixels):
    """Directions (x, y, 1) through pixel coordinates, by the inverse of the intrinsic matrix."""
    return np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(camera.K).T


@given(cameras(), seeds)
def test_projecting_the_points_of_a_depth_image_gives_its_pixels(camera, seed):
    depth = np.random.default_rng(seed).uniform(0.2, 8, (camera.height, camera.width)).astype(np.float32)
    points = backproject(depth, camera)
    y, x = np.mgrid[: camera.height, : camera.width]
    assert np.allclose(project(points, camera), np.stack([x, y], axis=-1), atol=2e-3)
    assert np.array_equal(points[..., 2], depth)


@given(cameras())
def test_a_pixel_without_depth_has_no_point(camera):
    depth = np.ones((camera.height, camera.width), dtype=np.float32)
    depth[2, 3] = np.nan
    points = backproject(depth, camera)
    assert np.isnan(points[2, 3]).all()
    assert np.isfinite(np.delete(points.reshape(-1, 3), 2 * camera.width + 3, axis=0)).all()


def test_projection_uses_the_intrinsics_and_drops_points_behind():
    camera = Camera(width=64, height=48, fx=50, fy=60, cx=31, cy=23)
    assert np.allclose(project(np.array([[0.5, -0.25, 2.0]]), camera), [[31 + 12.5, 23 - 7.5]])
    assert np.isnan(project(np.array([[0.1, 0.1, 0.0], [0.1, 0.1, -1.0]]), camera)).all()


@given(cameras(), st.sampled_from([0.25, 0.5, 0.75, 1.0, 2.0, 3.0]))
def test_a_scaled_camera_sees_the_same_rays(camera, factor):
    scaled = camera.scaled(factor)
    # Shares of the image's extent, whose border is half a pixel outside the outermost pixel centres.
    shares = np.array([[0, 0], [1, 0], [0, 1], [1, 1], [0.3, 0.6]])
    pixels, scaled_pixels = (shares * (c.width, c.height) - 0.5 for c in (camera, scaled))
    assert np.allclose(rays(camera, pixels), rays(scaled, scaled_pixels), atol=1e-9)
    assert (scaled.width, scaled.height) == (round(camera.width * factor), round(camera.height * factor))


@given(cameras(), st.data())
def test_a_cropped_camera_sees_the_rays_of_its_pixels(camera, data):
    x0, y0 = data.draw(st.integers(0, camera.width - 1)), data.draw(st.integers(0, camera.height - 1))
    x1, y1 = data.draw(st.integers(x0 + 1, camera.width)), data.draw(st.integers(y0 + 1, camera.height))
    depth = np.linspace(0.5, 3, camera.width * camera.height, dtype=np.float32).reshape(camera.height, camera.width)
    cropped = camera.cropped(x0, y0, x1, y1)
    assert np.allclose(backproject(depth, camera)[y0:y1, x0:x1], backproject(depth[y0:y1, x0:x1], cropped), atol=1e-5)


@pytest.mark.parametrize(
    "wrong", [{"width": 0}, {"height": -1}, {"fx": 0.0}, {"fy": -5.0}, {"fx": np.nan}, {"cx": np.inf}], ids=str
)
def test_a_camera_that_cannot_be_is_refused(wrong):
    with pytest.raises(ValueError, match=r"camera of|focal lengths"):
        Camera(**{"width": 4, "height": 4, "fx": 5.0, "fy": 5.0, "cx": 2.0, "cy": 2.0, **wrong})
