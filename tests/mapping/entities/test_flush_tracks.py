from functools import reduce
import numpy as np
import pytest
from hickory_stream.geometry.boxes import box_iou
from hickory_stream.geometry.depth_sensor import information
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.geometry.rigid import apply, from_rotation_translation, yaw_rotation
from hickory_stream.mapping.entities.cloud import cloud_of, fuse, moved_cloud
from hickory_stream.mapping.entities.track import box_of, settled
from hickory_stream.perception.observe import observe
from tests.mapping.picture_wall import frames, true_boxes

VOXEL_M = 0.01


def clouds(distance_m, count, sigma_per_m):
    """The cloud of each picture that its true masks make, by its number."""
    found = {}
    for frame, segmentation in frames(distance_m, count, sigma_per_m):
        for one in observe(frame, segmentation, Lattice())[0]:
            (x0, y0, _, _), (y, x) = one.box_px, np.argwhere(one.mask)[0]
            weights = information(one.points_world, frame.world_from_camera, frame.sensor.law)
            cloud = cloud_of(one.points_world, one.colors, VOXEL_M, weights, one.behind)
            found.setdefault(int(segmentation.instances[y0 + y, x0 + x]), []).append(cloud)
    return {label: reduce(fuse, seen) for label, seen in found.items()}


@pytest.mark.parametrize(
    ("distance_m", "sigma_per_m", "least_iou"), [(2.0, 0.0012, 0.6), (4.0, 0.0012, 0.5), (4.0, 0.002, 0.4)]
)
def test_pictures_on_a_wall_have_their_thickness(distance_m, sigma_per_m, least_iou):
    made = clouds(distance_m, 6, sigma_per_m)
    assert len(made) == len(true_boxes())
    for label, cloud in made.items():
        true = true_boxes()[label - 1]
        points, box = settled(cloud, VOXEL_M)
        assert box_iou(box, true) > max(least_iou, box_iou(box_of(cloud.points, VOXEL_M), true))
        assert (np.abs(points[:, 0] - 2 * true.half_extents_m[0]) < 0.03).all()


def test_a_flush_cloud_that_moves_stays_flush():
    cloud = clouds(3.0, 2, 0.0012)[2]
    new_from_old = from_rotation_translation(yaw_rotation(0.7), np.array([3.0, -1.0, 0.5]))
    before, after = settled(cloud, VOXEL_M), settled(moved_cloud(cloud, new_from_old, VOXEL_M), VOXEL_M)
    assert np.allclose(apply(new_from_old, before[1].center[None])[0], after[1].center, atol=0.01)
    assert np.allclose(np.sort(before[1].half_extents_m), np.sort(after[1].half_extents_m), atol=0.01)


def test_a_cloud_flush_in_few_views_is_left_as_it_was():
    flush = clouds(3.0, 1, 0.0012)[2]
    free = cloud_of(flush.points, flush.colors.astype(np.uint8), VOXEL_M, flush.weights)
    assert settled(fuse(fuse(flush, free), free), VOXEL_M) is None
