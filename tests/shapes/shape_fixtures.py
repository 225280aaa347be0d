"""Objects with a known shape, and what cameras see of them: the ground truth of the tests of layers 2 to 4."""

import numpy as np
import trimesh
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.camera import Camera, backproject
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.portable_kernels import exp, log
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.voxels import centers_of_keys, keys_of_points
from hickory_stream.pictures.open3d_import import import_open3d
from hickory_stream.ports import Crop, ShapeInputs
from tests.perception.perception_scenes import looking
from tools.evaluation.shapes.meshes import MESH_NAMES, test_mesh

__all__ = ["MESH_NAMES", "test_mesh"]


def as_mesh(shape):
    count = len(shape.vertices)
    return Mesh(
        vertices=shape.vertices, faces=shape.faces, colors=np.full((count, 3), 128, np.uint8),
        is_seen=np.ones(count, bool),
    )  # fmt: skip


def ray_scene(meshes):
    scene = import_open3d().t.geometry.RaycastingScene(nthreads=1)
    for mesh in meshes:
        scene.add_triangles(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
    return scene


def cast_view(scene, camera, world_from_camera):
    """Return the depth along the axis (inf where nothing is hit) and the index of the mesh hit."""
    o3d = import_open3d()
    pixels = backproject(np.ones((camera.height, camera.width), np.float32), camera)
    directions = pixels @ world_from_camera[:3, :3].T.astype(np.float32)
    origins = np.broadcast_to(world_from_camera[:3, 3].astype(np.float32), directions.shape)
    answer = scene.cast_rays(o3d.core.Tensor(np.ascontiguousarray(np.concatenate([origins, directions], axis=-1))))
    return answer["t_hit"].numpy(), answer["geometry_ids"].numpy()


def shape_inputs(
    shape, num_views, *, azimuths_rad=(0.3, 0.3 + 2 * np.pi), noise=0.01, elevation_rad=0.5, seed=0, margin_px=12
):
    """Return what `num_views` cameras around an object on a floor see of it; depth noise is `noise` times the depth."""
    rng = np.random.default_rng(seed)
    camera = Camera(width=640, height=480, fx=525, fy=525, cx=319.5, cy=239.5)
    middle, size = shape.bounds.mean(axis=0), float(np.linalg.norm(np.ptp(shape.bounds, axis=0)))
    scene = ray_scene([shape, trimesh.creation.box((20, 20, 0.2)).apply_translation([0, 0, -0.1])])
    crops, points, colors = [], [], []
    for i in range(num_views):
        azimuth = azimuths_rad[0] + (azimuths_rad[1] - azimuths_rad[0]) * i / num_views
        distance = max(1.6 * size, 0.5)
        tilt = elevation_rad + 0.15 * np.cos(2.1 * i)
        eye = middle + distance * np.array(
            [np.cos(azimuth) * np.cos(tilt), np.sin(azimuth) * np.cos(tilt), np.sin(tilt)]
        )
        pose = looking(middle, start=eye)
        depth, hit = cast_view(scene, camera, pose)
        mask = hit == 0
        depth = np.where(np.isfinite(depth), depth * (1 + noise * rng.standard_normal(depth.shape)), np.nan)
        depth[rng.random(depth.shape) < 0.05] = np.nan
        rows, columns = np.nonzero(mask)
        x0, x1 = max(columns.min() - margin_px, 0), min(columns.max() + 1 + margin_px, camera.width)
        y0, y1 = max(rows.min() - margin_px, 0), min(rows.max() + 1 + margin_px, camera.height)
        rgb = np.full((*depth.shape, 3), 90, np.uint8)
        rgb[mask] = (200, 120, 40)
        crop = Crop(
            rgb=rgb[y0:y1, x0:x1], depth_m=depth[y0:y1, x0:x1].astype(np.float32), mask=mask[y0:y1, x0:x1],
            camera=camera.cropped(x0, y0, x1, y1), world_from_camera=pose,
        )  # fmt: skip
        crops.append(crop)
        inside = crop.mask & np.isfinite(crop.depth_m)
        points.append(apply(pose, backproject(crop.depth_m, crop.camera)[inside]))
        colors.append(crop.rgb[inside])
    fused, rgb_points = fused_points(np.concatenate(points), np.concatenate(colors), 0.01)
    return ShapeInputs(
        crops=tuple(crops), points_world=fused, colors=rgb_points, box=gravity_aligned_box(fused, 0.01), support_z_m=0.0
    )


def fused_points(points, colors, voxel_m):
    """Return one point per voxel that at least three points fell into, as the tracks keep them."""
    keys, first, counts = np.unique(keys_of_points(points, voxel_m), return_index=True, return_counts=True)
    kept = counts >= min(3, counts.max())
    return centers_of_keys(keys[kept], voxel_m), colors[first[kept]]


def occupancy_iou(shape, vertices_world, faces, cells=64):
    """Return the IoU of the solids on a grid over both (inside by ray parity, part by part)."""
    low = np.minimum(shape.bounds[0], vertices_world.min(axis=0))
    high = np.maximum(shape.bounds[1], vertices_world.max(axis=0))
    step = (high - low).max() / cells
    axes = [np.arange(a - step / 2, b + step, step, dtype=np.float32) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    truth = solid_of_parts(shape, grid)
    other = inside(trimesh.Trimesh(vertices_world, faces, process=False), grid)
    return float((truth & other).sum() / (truth | other).sum())


def solid_of_parts(shape, points):
    solid = np.zeros(points.shape[:-1], bool)
    parts = shape.split(only_watertight=True)
    for part in parts if len(parts) else [shape]:
        solid |= inside(part, points)
    return solid


def inside(shape, points):
    o3d = import_open3d()
    scene = ray_scene([shape])
    return scene.compute_occupancy(o3d.core.Tensor(np.ascontiguousarray(points, np.float32)), nsamples=3).numpy() > 0.5


def tangent_distance(row, point, depth):
    """Return the distance of one point to a tangent plane of a primitive (`tangent_planes`), in plain Python."""
    e1, e2, log_a, log_b, log_c = row[:5].tolist()
    dx, dy, dz = (np.asarray(point) - row[5:8]).tolist()
    r = row[8:17].tolist()
    local = (r[i] * dx + r[3 + i] * dy + r[6 + i] * dz for i in range(3))
    px, py, pz = (along if abs(along) > 1e-6 else 1e-6 for along in local)
    log_x, log_y, log_z = log(abs(px)) - log_a, log(abs(py)) - log_b, log(abs(pz)) - log_c
    log_rho, share_x, share_y = _softmax(log_x, log_y, e2)
    log_h, share_r, share_z = _softmax(log_rho, log_z, e1)
    slope = _length(share_r * share_x / px, share_r * share_y / py, share_z / pz)
    if log_h >= 0.0:
        return (1.0 - exp(-log_h)) / slope
    h = max(exp(log_h), 1e-200)
    smallest = exp(min(log_a, log_b, log_c)) * (1.0 if e1 <= 1.0 and e2 <= 1.0 else 0.57735)
    if (1.0 - h) * smallest > depth:
        return -(1.0 - h) * smallest
    best = (1.0 / h - 1.0) / slope
    # The surface along each axis, and the shares there.
    whole = exp(2.0 / e1 * log_h)
    in_plane, along_z = share_r * whole, share_z * whole
    rest_z, rest_r = max(1.0 - in_plane, 1e-300), max(1.0 - along_z, 1e-300)
    log_most = 0.5 * e1 * log(rest_r)
    own = exp(min(2.0 / e2 * (log_rho - log_most), 0.0))
    rest_x, rest_y = max(1.0 - share_y * own, 1e-300), max(1.0 - share_x * own, 1e-300)
    ways = [
        (exp(log_c + 0.5 * e1 * log(rest_z)) - abs(pz), 2, (share_x, share_y, in_plane, rest_z)),
        (exp(log_a + log_most + 0.5 * e2 * log(rest_x)) - abs(px), 0, (rest_x, 1.0 - rest_x, rest_r, along_z)),
        (exp(log_b + log_most + 0.5 * e2 * log(rest_y)) - abs(py), 1, (1.0 - rest_y, rest_y, rest_r, along_z)),
    ]
    reach, axis, (foot_x, foot_y, foot_r, foot_z) = min(ways, key=lambda way: way[0])
    reach = max(reach, 0.0)
    foot = [px, py, pz]
    foot[axis] += reach if foot[axis] > 0.0 else -reach
    gradient = (foot_r * foot_x / foot[0], foot_r * foot_y / foot[1], foot_z / foot[2])
    planar = reach * abs(gradient[axis]) / _length(*gradient)
    return -planar if reach < best * 4.0 and planar < best else -best


def _softmax(log_a, log_b, exponent):
    # ln (a^(2/e) + b^(2/e))^(e/2) and the shares of both in the sum.
    gap = 2.0 / exponent * (log_b - log_a)
    small = exp(-abs(gap))
    large = 1.0 / (1.0 + small)
    log_sum = max(log_a, log_b) + 0.5 * exponent * log(1.0 + small)
    return (log_sum, small * large, large) if gap > 0.0 else (log_sum, large, small * large)


def _length(x, y, z):
    return float(np.sqrt(x * x + y * y + z * z))
