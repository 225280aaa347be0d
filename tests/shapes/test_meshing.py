import numpy as np
import pytest
from scipy import ndimage
from hickory_stream.shapes.reconstruct.meshing import extract, surface_field
from hickory_stream.shapes.reconstruct.tsdf import Evidence, VoxelGrid, gaussian_blurred


@pytest.mark.parametrize("at_side", [False, True])
def test_the_surface_is_exact_also_at_the_side_of_its_block(at_side):
    solid = np.zeros((40, 36, 34), dtype=bool)
    first = 0 if at_side else 5
    solid[6:34, first:30, 5:29] = True
    nothing = np.zeros(solid.shape, np.float32)
    evidence = Evidence(distance=nothing, near=nothing, free=nothing)
    grid = VoxelGrid(world_from_grid=np.eye(4), voxel_m=0.01, shape=solid.shape)
    vertices, faces = extract(surface_field(solid, evidence), grid)
    expected_vertices, expected_faces = extract(_field_of_exact_distances(solid), grid)
    np.testing.assert_array_equal(faces, expected_faces)
    np.testing.assert_array_equal(vertices, expected_vertices)


def _field_of_exact_distances(solid):
    distance = ndimage.distance_transform_edt(~solid) - ndimage.distance_transform_edt(solid)
    smooth = gaussian_blurred((distance - np.sign(distance) * 0.5).astype(np.float32), 1.0, mode="nearest")
    magnitude = np.where((smooth < 0) != solid, 0.1, np.maximum(np.abs(smooth), 1e-3))
    return np.where(solid, -magnitude, magnitude).astype(np.float32)
