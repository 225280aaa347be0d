"""A recorded keyframe of 64 x 48 pixels: a thing 2 m away before a wall at 4 m, and no depth at the left border."""

from dataclasses import replace
import numpy as np
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.geometry.voxels import keys_of_points
from hickory_stream.inspection.keyframe_labels import rays_of
from hickory_stream.map_folder.history.recorded import RecordedKeyframe
from hickory_stream.perception.coarse import coarse_frame
from hickory_stream.records import RejectedMask
from tests.mapping.mapping_fixtures import keyframe, observation, space

CAMERA = Camera(width=64, height=48, fx=50.0, fy=50.0, cx=31.5, cy=23.5)
SPACE_M = Lattice().space_m
THING_M, WALL_M = 2.0, 4.0
ON_THING, ON_WALL, WITHOUT_DEPTH, REJECTED = (32.0, 24.0), (55.0, 8.0), (3.0, 24.0), (50.0, 40.0)


def point_at(pixel, depth_m):
    """(3,) in the camera's frame, which is the odometry's."""
    return rays_of(CAMERA, np.array([pixel]))[0] * depth_m


def a_keyframe(*, map_from_odometry=None):
    depth_m = np.full((48, 64), WALL_M, dtype=np.float32)
    depth_m[18:30, 26:38] = THING_M
    depth_m[:, :8] = np.nan
    rows, columns = np.mgrid[18:30, 26:38]
    points = rays_of(CAMERA, np.stack([columns.ravel(), rows.ravel()], axis=1)) * THING_M
    seen = observation(0, points.astype(np.float32), box_px=(26, 18, 38, 30))
    rows, columns = np.mgrid[0:48, 0:64]
    wall = rays_of(CAMERA, np.stack([columns.ravel(), rows.ravel()], axis=1)) * WALL_M
    structure = keys_of_points(wall[(np.nan_to_num(depth_m) == WALL_M).ravel()], SPACE_M)
    free = keys_of_points(np.linspace(0.1, 0.9, 200)[:, None] * point_at(ON_WALL, WALL_M), SPACE_M)
    observed = keyframe(7, [seen], seen=space(free=free, structure=structure))
    rejected = RejectedMask(box_px=(48, 38, 53, 43), reason="too few points", mask=np.ones((5, 5), dtype=bool))
    coarse = coarse_frame(depth_m, depth_m == WALL_M, CAMERA)
    return RecordedKeyframe(
        number=2,
        camera=CAMERA,
        observed=replace(observed, world_from_camera=np.eye(4), coarse=coarse, rejected=(rejected,)),
        map_from_odometry=np.eye(4) if map_from_odometry is None else map_from_odometry,
    )
