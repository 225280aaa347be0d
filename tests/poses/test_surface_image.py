import numpy as np
import pytest
from hickory_stream.geometry.camera import backproject
from hickory_stream.poses.surface_image import surface_image
from tests.poses.registration_scenes import CAMERA, SPREAD_PER_M


def seen(depth_m, max_sigma_m=0.1):
    depth_mm = np.rint(1e3 * depth_m).astype(np.uint16)
    return surface_image(depth_mm, CAMERA, spread_per_m=SPREAD_PER_M, max_sigma_m=max_sigma_m)


def plane(normal, distance_m):
    """Return the depth of the plane n . p = -d, as an image."""
    rays = backproject(np.ones((CAMERA.height, CAMERA.width), np.float32), CAMERA).astype(float)
    return -distance_m / (rays @ np.asarray(normal))


@pytest.mark.parametrize("normal", [(0.0, 0.0, -1.0), (0.6, 0.0, -0.8), (0.28, -0.0, -0.96)])
def test_a_plane_has_its_normal_and_its_distance_everywhere(normal):
    image = seen(plane(normal, 1.5))
    has = ~np.isnan(image.sigma_m)
    assert has[2:-2, 2:-2].mean() > 0.95
    assert np.allclose(image.normals[has], normal, atol=0.02)
    assert np.allclose(image.points[has] @ np.asarray(normal), -1.5, atol=0.002)


def test_sigma_grows_with_the_square_of_the_distance():
    near, far = seen(plane((0.0, 0.0, -1.0), 1.0)), seen(plane((0.0, 0.0, -1.0), 3.0))
    assert np.nanmedian(far.sigma_m) == pytest.approx(9 * np.nanmedian(near.sigma_m), rel=0.05)


def test_beside_an_edge_no_point_lies_between_the_two_surfaces():
    depth_m = np.full((CAMERA.height, CAMERA.width), 3.0)
    depth_m[:, :80] = 1.5
    z = seen(depth_m).points[..., 2]
    z = z[~np.isnan(z)]
    assert (np.minimum(np.abs(z - 1.5), np.abs(z - 3.0)) < 0.02).all()


def test_missing_far_or_flat_pixels_are_no_surface():
    assert np.isnan(seen(np.zeros((CAMERA.height, CAMERA.width))).sigma_m).all()
    assert np.isnan(seen(np.full((CAMERA.height, CAMERA.width), 4.0), max_sigma_m=0.01).sigma_m).all()
    floor = np.where((depth_m := plane((0.0, -0.99, -0.14), 0.3)) > 0, depth_m, 0.0).clip(0, 20)
    slanted = seen(floor)
    cosines = -(slanted.points * slanted.normals).sum(axis=-1) / np.linalg.norm(slanted.points, axis=-1)
    assert np.nanmin(cosines) >= 0.2
