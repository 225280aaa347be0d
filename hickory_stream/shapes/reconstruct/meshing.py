"""Surface extraction: from a solid on a voxel grid to a closed, smooth, coloured mesh in the object's frame.

Squared distances to a solid's boundary are least sums of three squares, found axis by axis within a reach; SciPy's
transform looks at all cells.
"""

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.camera import project
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.ports import Crop, Reconstruction
from hickory_stream.shapes.reconstruct.tsdf import Evidence, VoxelGrid, gaussian_blurred


def rough_distance(solid: NDArray[np.bool_], reach: int) -> NDArray[np.float32]:
    """Return the signed distances to the faces between solid and other cells, in cells, negative inside."""
    # Between the middles of cells, less half a cell; cut off at `reach`.
    away = np.empty((2, 2, *solid.shape), np.int32)
    for cells, room in zip((solid, ~solid), away, strict=True):
        _fill_squared(cells, reach, *room)
    outside, inside = np.sqrt(away[:, 0].astype(np.float64))
    return np.where(solid, 0.5 - inside, outside - 0.5).astype(np.float32)


@kernel
def _fill_squared(cells, reach, squared, room):
    # To the set ones of the cells.
    nx, ny, nz = cells.shape
    most = np.int32(reach * reach)
    for i in range(nx):
        for j in range(ny):
            since = reach
            for k in range(nz):
                since = 0 if cells[i, j, k] else min(since + 1, reach)
                squared[i, j, k] = since
            since = reach
            for k in range(nz - 1, -1, -1):
                since = 0 if cells[i, j, k] else min(since + 1, reach)
                least = min(np.int64(squared[i, j, k]), since)
                squared[i, j, k], room[i, j, k] = least * least, most
    for i in range(nx):
        for j in range(ny):
            for other in range(max(j - reach, 0), min(j + reach + 1, ny)):
                more = np.int32((j - other) ** 2)
                for k in range(nz):
                    room[i, j, k] = min(room[i, j, k], np.int32(squared[i, other, k] + more))
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                squared[i, j, k] = most
        for other in range(max(i - reach, 0), min(i + reach + 1, nx)):
            more = np.int32((i - other) ** 2)
            for j in range(ny):
                for k in range(nz):
                    squared[i, j, k] = min(squared[i, j, k], np.int32(room[other, j, k] + more))


_GREY = (150, 150, 150)
# The surface depends on the cells beside it, and their blurred values on those up to four cells away along each axis:
# none of them is farther from the solid's boundary than 5 sqrt 3 cells. Where the solid meets the side of its block,
# the surface lies beside cells of any depth.
_REACH = 9


def surface_field(solid: NDArray[np.bool_], evidence: Evidence) -> NDArray[np.float32]:
    """Return a signed field in voxels, negative inside, whose zero is the surface: measured, else smoothed distance.

    It is never exactly zero on a voxel, so that its level set is a closed manifold.
    """
    rough = rough_distance(solid, sum(solid.shape) if _meets_a_side(solid) else _REACH)
    smooth = gaussian_blurred(rough, 1.0, mode="nearest")
    measured = (evidence.near > evidence.free) & (np.abs(evidence.distance) < 1.0) & ((evidence.distance <= 0) == solid)
    # Where both are known, the nearer surface counts: a measured front must not move the completed back.
    magnitude = np.where(measured, np.minimum(np.abs(evidence.distance), np.abs(rough)), np.abs(smooth))
    # The sign is that of the solid everywhere: smoothing must not open a hole in a plate of one voxel.
    magnitude = np.where(~measured & ((smooth < 0) != solid), 0.1, np.maximum(magnitude, 1e-3))
    return np.where(solid, -magnitude, magnitude).astype(np.float32)


def _meets_a_side(solid: NDArray[np.bool_]) -> bool:
    return any(bool(np.take(solid, (0, -1), axis=axis).any()) for axis in range(solid.ndim))


def extract(field: NDArray[np.float32], grid: VoxelGrid) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return the closed surface of a field that is negative inside: (V, 3) world vertices, (F, 3) outward faces."""
    from skimage.measure import marching_cubes

    padded = np.pad(field, 1, constant_values=1.0)
    vertices, faces, _, _ = marching_cubes(padded, 0.0, gradient_direction="descent")
    return grid.points_world(vertices - 1.0), faces.astype(np.int32)


def taubin_smoothed(vertices: NDArray[np.float64], faces: NDArray[np.int32], iterations: int) -> NDArray[np.float64]:
    """Return the vertices after Taubin's lambda-mu smoothing (0.5, -0.53), which does not shrink the shape."""
    counts = np.bincount(faces.ravel(), minlength=len(vertices))[:, None]
    for _ in range(iterations):
        for factor in (0.5, -0.53):
            sums = np.zeros_like(vertices)
            _add_neighbours(vertices, faces, sums)
            vertices = vertices + factor * (np.where(counts, sums / np.maximum(counts, 1), vertices) - vertices)
    return vertices


@kernel
def _add_neighbours(vertices, faces, sums):
    for f in range(len(faces)):
        for corner in range(3):
            here, there = faces[f, corner], faces[f, (corner + 1) % 3]
            for i in range(3):
                sums[here, i] += vertices[there, i]


def painted(
    vertices: NDArray[np.float64],
    crops: tuple[Crop, ...],
    points_world: NDArray[np.float32],
    point_colors: NDArray[np.uint8],
    reach_m: float,
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return per vertex its colour and whether it was seen, within `reach_m` of a crop's surface or a layer-1 point.

    The colour is the mean over crops, else the point's; a generated vertex has that of the nearest seen one.
    """
    total = np.zeros((len(vertices), 3))
    weight = np.zeros(len(vertices))
    for crop in crops:
        here, colors, weights = _seen_in(vertices, crop, reach_m)
        total[here] += colors * weights[:, None]
        weight[here] += weights
    is_seen = weight > 0
    colors = total / np.maximum(weight, 1e-12)[:, None]
    unseen = np.flatnonzero(~is_seen)
    if len(points_world) and len(unseen):
        near, which = scipy.spatial.cKDTree(points_world).query(vertices[unseen], distance_upper_bound=reach_m)
        is_found = np.isfinite(near)
        colors[unseen[is_found]] = point_colors[which[is_found]]
        is_seen[unseen[is_found]] = True
    if is_seen.any() and not is_seen.all():
        _, nearest = scipy.spatial.cKDTree(vertices[is_seen]).query(vertices[~is_seen])
        colors[~is_seen] = colors[is_seen][nearest]
    elif not is_seen.any():
        colors[:] = _GREY
    return np.round(colors).clip(0, 255).astype(np.uint8), is_seen


def in_object_frame(
    vertices_world: NDArray[np.float64], faces: NDArray[np.int32], colors: NDArray[np.uint8], is_seen: NDArray[np.bool_]
) -> Reconstruction:
    """Return the mesh in the frame of its own gravity-aligned box, the origin at the box's centre."""
    world_from_object = gravity_aligned_box(vertices_world, 1e-4).world_from_box
    mesh = Mesh(vertices=apply(invert(world_from_object), vertices_world), faces=faces, colors=colors, is_seen=is_seen)
    return Reconstruction(mesh=mesh, world_from_object=world_from_object)


def _seen_in(
    vertices: NDArray[np.float64], crop: Crop, reach_m: float
) -> tuple[NDArray[np.int64], NDArray[Any], NDArray[np.float64]]:
    # Colours (n, 3) and weights 1/z^2.
    points = apply(invert(crop.world_from_camera), vertices)
    pixels = project(points, crop.camera)
    inside = np.isfinite(pixels).all(axis=1)
    columns = np.round(np.where(inside, pixels[:, 0], 0)).astype(np.int64)
    rows = np.round(np.where(inside, pixels[:, 1], 0)).astype(np.int64)
    inside &= (columns >= 0) & (rows >= 0) & (columns < crop.camera.width) & (rows < crop.camera.height)
    candidates = np.nonzero(inside)[0]
    rows, columns = rows[candidates], columns[candidates]
    depth = crop.depth_m[rows, columns]
    kept = crop.mask[rows, columns] & (np.abs(depth - points[candidates, 2]) <= reach_m)
    return candidates[kept], crop.rgb[rows[kept], columns[kept]], 1 / np.square(depth[kept].astype(np.float64))
