"""A generated shape that agrees with what was seen: measured surface where there is some, generated elsewhere.

Its signed distances are corrected by their miss of the measured surface, fully near it and less farther away, so that
both meet without a step; space that was seen to be free is cut away. The result is closed.
"""

from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray

from hickory_stream.geometry import portable
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.ports import NoShape, Reconstruction, ShapeInputs
from hickory_stream.shapes.reconstruct.completion import large_pieces
from hickory_stream.shapes.reconstruct.fused import VolumeConfig, mesh_of_field, view_of, voxel_over
from hickory_stream.shapes.reconstruct.tsdf import DepthView, Evidence, VoxelGrid, gaussian_blurred, integrate
from hickory_stream.shapes.sdf import distance_grid

_BAND_VOXELS = 8.0
_MIN_HALF_EXTENT_M = 0.01
_EDGE_PX = 2
_FAR_M = 100.0
# The correction by the distance to the measured surface fades over this many voxels, and is smoothed over these.
_REACH_VOXELS = 10.0
_SEAM_VOXELS = 1.0
# Parts smaller than this share of the largest are left out.
_MIN_PART = 0.02


def blended(placed: Reconstruction, inputs: ShapeInputs, volume: VolumeConfig) -> Reconstruction | NoShape:
    """Return a placed shape that passes through what was measured and keeps out of what was seen to be free."""
    vertices_world = apply(placed.world_from_object, placed.mesh.vertices.astype(np.float64))
    try:
        grid, generated = _generated_field(vertices_world, placed.mesh.faces, inputs, volume)
    except ValueError as error:
        return NoShape(reason=str(error))
    evidence = integrate(grid, [_with_silhouette(view_of(crop)) for crop in inputs.crops])
    field = _joined(generated, evidence)
    if inputs.support_z_m is not None:
        # Nothing of an object is below what it stands on.
        heights = grid.world_from_grid[2, 3] + grid.voxel_m * np.arange(grid.shape[2])
        field = np.maximum(field, ((inputs.support_z_m - heights) / grid.voxel_m).astype(np.float32))
    solid = large_pieces(field < 0, _MIN_PART)
    if not solid.any():
        return NoShape(reason="nothing of the generated shape is outside of free space")
    field = np.where(solid, field, np.maximum(field, np.float32(1e-3)))
    return mesh_of_field(field, grid, inputs)


def _with_silhouette(view: DepthView) -> DepthView:
    # Pixels beside the mask without depth look far. For a generated surface; the fused shape takes them for no
    # evidence.
    near = scipy.ndimage.binary_dilation(view.mask, iterations=_EDGE_PX)
    return replace(view, depth_m=np.where(~near & np.isnan(view.depth_m), np.float32(_FAR_M), view.depth_m))


def _generated_field(
    vertices_world: NDArray[np.float64], faces: NDArray[np.int32], inputs: ShapeInputs, volume: VolumeConfig
) -> tuple[VoxelGrid, NDArray[np.float32]]:
    # Signed distances in voxels.
    around = np.concatenate([vertices_world, inputs.points_world.astype(np.float64)])
    box = gravity_aligned_box(around, _MIN_HALF_EXTENT_M)
    half = box.half_extents_m
    voxel = voxel_over(half, volume)
    # Points of layer 1 are vertices that no face uses: the grid reaches over them.
    own = apply(invert(box.world_from_box), around)
    cells = max(int(np.ceil(2 * float(half.max()) / voxel)), 4)
    found = distance_grid(own, faces, cells=cells, band_cells=_BAND_VOXELS)
    world_from_grid = box.world_from_box.copy()
    world_from_grid[:3, 3] += portable.matmul(box.world_from_box[:3, :3], found.origin)
    shape = (found.values.shape[0], found.values.shape[1], found.values.shape[2])
    grid = VoxelGrid(world_from_grid=world_from_grid, voxel_m=found.step_m, shape=shape)
    return grid, found.values / np.float32(found.step_m)


def _joined(generated: NDArray[np.float32], evidence: Evidence) -> NDArray[np.float32]:
    measured = (evidence.near > evidence.free) & (evidence.near > 0) & (np.abs(evidence.distance) < 1.5)
    free = (evidence.free > evidence.near) & (evidence.free > 0)
    field = generated
    if measured.any():
        miss = np.where(measured, generated - evidence.distance, np.float32(0))
        away, nearest = scipy.ndimage.distance_transform_edt(~measured, return_indices=True)
        fade = np.maximum(1.0 - away / _REACH_VOXELS, 0.0)
        carried = (miss[tuple(nearest)] * fade).astype(np.float32)
        smooth = gaussian_blurred(carried, _SEAM_VOXELS, mode="nearest")
        field = generated - np.where(measured, carried, smooth)
    # Never exactly zero on a voxel: its level set is then a closed manifold.
    field = np.where(free, np.maximum(field, np.float32(0.5)), field)
    return np.where(np.abs(field) < 1e-3, np.float32(1e-3), field).astype(np.float32)
