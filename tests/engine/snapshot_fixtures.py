"""Small maps with real records and real files: a table with a box on it, and a ball without shape."""

from dataclasses import replace
import numpy as np
import trimesh
from hickory_stream import records
from hickory_stream.config import RunConfig
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.mesh import Mesh, sha256_of, write_glb
from hickory_stream.geometry.superquadric import Superquadrics
from hickory_stream.geometry.voxels import keys_of_points
from hickory_stream.map_folder.views import write_crop
from hickory_stream.ports import Crop

VOXEL_M = 0.02
DEFAULT_RUN = RunConfig()


def box_mesh(extents_m, color):
    solid = trimesh.creation.box(extents_m).subdivide()
    return Mesh(
        vertices=solid.vertices, faces=solid.faces, colors=np.tile(np.uint8(color), (len(solid.vertices), 1)),
        is_seen=solid.vertices[:, 2] > -extents_m[2] / 2,
    )  # fmt: skip


def placed(x, y, z):
    world_from_object = np.eye(4)
    world_from_object[:3, 3] = x, y, z
    return world_from_object


def make_view(object_id, frame_index, x):
    feature = np.random.default_rng(frame_index).normal(size=12).astype(np.float32)
    return records.View(
        object_id=object_id, frame_index=frame_index, stamp_ns=1_700_000_000_123_456_789 + frame_index,
        box_px=(10, 20, 10 + 16, 20 + 12), world_from_camera=placed(x, -2.0, 1.3), r_area=0.1 + 0.2, r_depth=1.0 / 3.0,
        box_volume_m3=0.07, score=0.123456789 / 7, variance=0.5, feature=feature / np.linalg.norm(feature),
    )  # fmt: skip


def make_crop(seed=0):
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.5, 4.0, (12, 16)).astype(np.float32)
    depth[0, :4] = np.nan
    return Crop(
        rgb=rng.integers(0, 256, (12, 16, 3), dtype=np.uint8), depth_m=depth, mask=rng.random((12, 16)) > 0.5,
        camera=Camera(width=16, height=12, fx=20.0, fy=20.5, cx=8.1, cy=6.2),
        world_from_camera=placed(0.1, 0.2, 1.0 / 3.0),
    )  # fmt: skip


def make_shape(mesh, world_from_object, half_m, revision):
    def primitives(grow_m):
        return Superquadrics(
            exponents=[[0.2, 0.2]], semi_axes_m=[np.add(half_m, grow_m)], world_from_local=world_from_object[None]
        )

    return records.ObjectShape(
        revision=revision, reconstructor="fused", mesh_name=f"{revision:06d}.glb", mesh_sha256=sha256_of(mesh),
        world_from_object=world_from_object, fitted=primitives(0.0), inflated=primitives(0.03), seen_share=[0.75],
        containment=records.Containment(num_checked=1000, num_outside=1, max_g=1.01),
    )  # fmt: skip


def make_object(object_id, mesh, world_from_object, *, shape=None, views=()):
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    points, _ = trimesh.sample.sample_surface(solid, 1500, seed=object_id)
    points_world = (points @ world_from_object[:3, :3].T + world_from_object[:3, 3]).astype(np.float32)
    return records.TrackedObject(
        id=object_id, phase=records.Phase.ACTIVE, submap_id=0, sightings=7, first_seen_ns=1_700_000_000_000_000_001,
        last_seen_ns=1_700_000_009_000_000_003, points_world=points_world,
        colors=np.tile(mesh.colors[:1], (len(points_world), 1)), box=gravity_aligned_box(points_world, VOXEL_M),
        feature=views[0].feature if views else None, views=views, best_view=views[-1] if views else None, shape=shape,
        merged_ids=(90 + object_id,),
    )  # fmt: skip


def make_space():
    grid = np.stack(np.meshgrid(np.arange(-1.5, 1.5, 0.05), np.arange(-1.5, 1.5, 0.05), indexing="ij"), -1) + 0.025
    floor = np.concatenate([grid.reshape(-1, 2), np.full((grid.size // 2, 1), 0.01)], axis=1)
    wall = np.stack([np.full(3600, 1.51), floor[:, 1], (floor[:, 0] + 1.5) * 0.8], axis=1)
    air = np.concatenate([floor + np.array([0, 0, 0.05]), wall - np.array([0.05, 0, 0])])
    return records.ObservedSpace(
        voxel_m=0.05, free=np.unique(keys_of_points(air, 0.05)),
        structure=np.unique(keys_of_points(np.concatenate([floor, wall]), 0.05)), floor_z_m=0.0,
    )  # fmt: skip


def make_snapshot(folder=None, revision=3, views_as=DEFAULT_RUN):
    """Return a map of three objects; with a folder, write the meshes and views that it refers to."""
    parts = [
        (1, box_mesh((1.2, 0.8, 0.05), (150, 110, 70)), placed(0.2, 0.3, 0.7), (0.6, 0.4, 0.025)),
        (4, box_mesh((0.3, 0.2, 0.25), (60, 90, 180)), placed(0.1, 0.3, 0.85), (0.15, 0.1, 0.125)),
    ]
    objects = []
    for object_id, mesh, pose, half_m in parts:
        views = (make_view(object_id, object_id, 0.0), make_view(object_id, object_id + 10, 0.5))
        shape = make_shape(mesh, pose, half_m, revision=object_id)
        objects.append(make_object(object_id, mesh, pose, shape=shape, views=views))
        if folder:
            write_glb(mesh, folder.shapes / shape.mesh_name)
            for view in views:
                write_crop(folder.views, view.name, make_crop(view.frame_index), views_as)
    ball = trimesh.creation.icosphere(2, 0.15)
    count = len(ball.vertices)
    ball_mesh = Mesh(
        vertices=ball.vertices, faces=ball.faces, colors=np.tile(np.uint8([200, 60, 50]), (count, 1)),
        is_seen=np.ones(count, dtype=bool),
    )  # fmt: skip
    objects.append(replace(make_object(9, ball_mesh, placed(-0.9, -0.6, 0.15)), phase=records.Phase.TENTATIVE))
    submap = records.Submap(id=0, world_from_submap=np.eye(4), observed_space=make_space())
    return records.MapSnapshot(
        revision=revision, stamp_ns=1_700_000_010_000_000_007, submaps=(submap,), objects=tuple(objects)
    )
