import numpy as np
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import from_rotation_translation, yaw_rotation
from hickory_stream.mapping.entities.submap_surface import SurfacePoints, no_surface, surface_points, with_points
from hickory_stream.records import CoarseFrame

CAMERA = Camera(width=320, height=240, fx=250.0, fy=250.0, cx=159.5, cy=119.5)
POSE = from_rotation_translation(yaw_rotation(0.5), np.array([1.0, 2.0, 3.0]))


def wall(depth_m=2.0):
    depth = np.full((120, 160), round(1000 * depth_m), np.uint16)
    depth[:, 80:] += 500  # a step: two walls, with an edge between them
    return CoarseFrame(stride_px=2, depth_mm=depth, structure=np.zeros(depth.shape, bool), camera=CAMERA)


def test_points_lie_on_near_walls_and_normals_look_at_the_camera():
    seen = surface_points(wall(), POSE, 5.0)
    camera_from_world = np.linalg.inv(POSE)
    local = seen.points @ camera_from_world[:3, :3].T + camera_from_world[:3, 3]
    assert np.isin(np.round(local[:, 2], 3), [2.0, 2.5]).all()
    assert np.allclose(seen.normals @ camera_from_world[:3, :3].T, [0, 0, -1], atol=1e-5)
    # Cells at the step belong to no surface.
    assert len(seen.points) < 118 * 158
    assert np.abs(local[:, 0]).max() < 1.7
    assert len(surface_points(wall(), POSE, 1.9).points) == 0


def test_keyframes_add_up_to_means_with_counts_per_voxel():
    rng = np.random.default_rng(0)
    grid = np.stack(np.meshgrid(np.arange(10), np.arange(10)), axis=-1).reshape(-1, 2) * 0.1 + 0.05
    surface = no_surface()
    for _ in range(40):
        points = np.column_stack([grid, 0.05 + rng.normal(0, 0.01, len(grid))]).astype(np.float32)
        normals = np.tile(np.float32([0, 0, 1]), (len(points), 1))
        surface = with_points(surface, SurfacePoints(points=points, normals=normals), 0.1)
    assert len(surface) == 100
    assert (np.diff(surface.keys) > 0).all()
    assert (surface.hits == 40).all()
    assert np.abs(surface.points[:, 2] - 0.05).max() < 0.008


def test_both_sides_of_a_thin_board_leave_no_normal_between_them():
    point = np.float32([[0.05, 0.05, 0.05]])
    up, down = np.float32([[0, 0, 1]]), np.float32([[0, 0, -1]])
    surface = with_points(no_surface(), SurfacePoints(points=point, normals=up), 0.1)
    surface = with_points(surface, SurfacePoints(points=point, normals=down), 0.1)
    assert np.abs(surface.normals).max() < 1e-6
    assert surface.hits.tolist() == [2]
