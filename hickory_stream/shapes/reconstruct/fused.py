"""Layer 2 from all kept views: a truncated signed distance field over the object's box, completed and meshed.

A surface of revolution, by its best view, is completed by rotating its views to its far side.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.ranges import Ranged, check_order, check_ranges, number
from hickory_stream.geometry import portable
from hickory_stream.geometry.boxes import OrientedBox, faced_box, gravity_aligned_box
from hickory_stream.geometry.camera import backproject
from hickory_stream.geometry.depth_sensor import Law, sigma_at
from hickory_stream.geometry.rigid import apply, compose, invert
from hickory_stream.ports import Crop, NoShape, Reconstruction, ShapeInputs
from hickory_stream.shapes.reconstruct.completion import classify, solid_of
from hickory_stream.shapes.reconstruct.meshing import extract, in_object_frame, painted, surface_field, taubin_smoothed
from hickory_stream.shapes.reconstruct.symmetry import half_turn_of
from hickory_stream.shapes.reconstruct.tsdf import DepthView, VoxelGrid, integrate, smoothed_depth

_MARGIN_VOXELS = 3
_MIN_POINTS = 20
_MIN_HALF_EXTENT_M = 0.01
# Columns that end at most this far above the support surface are continued down to it through unknown voxels.
_MAX_SUPPORT_GAP_M = 0.08
# A voxel is larger if the mesh would otherwise exceed about this many faces.
MAX_FACES = 20_000
# Ratio of the disagreement between views to the sensor's sigma: errors of neighbouring pixels are correlated, and
# poses have errors, too.
_SPREAD = 1.6
# Number of Taubin iterations.
SMOOTHING = 15
# Maximum distance from a measurement, in voxels, at which a vertex counts as seen.
SEEN_VOXELS = 1.5


@dataclass(frozen=True, kw_only=True, slots=True)
class VolumeConfig(Ranged):
    """The grid and the surface taken from it."""

    #: The voxel is the longest side of the box over this, within `min_voxel_m` .. `max_voxel_m`.
    cells: int = number(56, 4, 512, "cells")
    #: Smallest voxel.
    min_voxel_m: float = number(0.004, 0.0005, 1, "m")
    #: Largest voxel.
    max_voxel_m: float = number(0.03, 0.0005, 1, "m")

    def __post_init__(self) -> None:
        check_ranges(self)
        check_order(self, "min_voxel_m", "max_voxel_m")


# Weight of a view rotated to the far side of a surface of revolution, relative to a real view.
_TURNED_TRUST = 0.2


@dataclass(frozen=True, kw_only=True, slots=True)
class FusedConfig(Ranged):
    """How views are fused."""

    #: The grid.
    volume: VolumeConfig = field(default_factory=VolumeConfig)


class FusedReconstructor:
    """Fuses the kept crops and the points of layer 1."""

    name = "fused"

    def __init__(self, config: FusedConfig) -> None:
        self._config = config

    def reconstruct(self, inputs: ShapeInputs) -> Reconstruction | NoShape:
        """Return the closed mesh over the object's box, or why there is none."""
        if len(inputs.points_world) < _MIN_POINTS:
            return NoShape(reason=f"{len(inputs.points_world)} points; a surface needs at least {_MIN_POINTS}")
        views = [view_of(crop) for crop in inputs.crops]
        inputs, views = completed_round(with_faced_box(inputs), views, self._config)
        return reconstruct_views(inputs, views, self._config.volume)


def with_faced_box(inputs: ShapeInputs) -> ShapeInputs:
    """Return the inputs with a box aligned with the observed sides, along whose axes they are continued."""
    points = inputs.points_world[inputs.box.contains(inputs.points_world, 1e-3)]
    if len(points) < _MIN_POINTS:
        return inputs
    return replace(inputs, box=faced_box(points, _MIN_HALF_EXTENT_M))


def completed_round(
    inputs: ShapeInputs, views: list[DepthView], config: FusedConfig
) -> tuple[ShapeInputs, list[DepthView]]:
    """Return the inputs with a box around the whole object and views rotated to its far side, if it is round."""
    if not inputs.crops:
        return inputs, views
    best = inputs.crops[0]
    points, _ = seen_points(best, views[0].law)
    if len(points) < _MIN_POINTS:
        return inputs, views
    tolerance = noise_m(points, views[0], config.volume)
    world_from_turned = half_turn_of(points, best.world_from_camera[:3, 3], views, tolerance)
    if world_from_turned is None:
        return inputs, views
    around = np.concatenate([inputs.points_world.astype(np.float64), apply(world_from_turned, points)])
    box = gravity_aligned_box(around, 2 * config.volume.min_voxel_m)
    return replace(inputs, box=box), views + moved_views(views, world_from_turned, _TURNED_TRUST)


def view_of(crop: Crop) -> DepthView:
    """Return a kept crop as the integration uses it."""
    floor, constant, quadratic = crop.sensor.law
    return DepthView(
        depth_m=crop.depth_m,
        mask=crop.mask,
        camera=crop.camera,
        camera_from_world=invert(crop.world_from_camera),
        law=(_SPREAD * floor, _SPREAD * constant, _SPREAD * quadratic),
    )


def moved_views(views: list[DepthView], motion: NDArray[np.float64], trust: float) -> list[DepthView]:
    """Return the views moved by a (4, 4) rotation or reflection that maps the object to itself, with less weight."""
    return [
        replace(view, camera_from_world=compose(view.camera_from_world, motion), trust=trust * view.trust)
        for view in views
    ]


def seen_points(crop: Crop, law: Law) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Return the (N, 3) world points of the crop's mask and their (N, 3) colours, without outliers."""
    depth = smoothed_depth(crop.depth_m, crop.mask, law)
    valid = np.isfinite(depth)
    if not valid.any():
        return np.empty((0, 3)), np.empty((0, 3), np.uint8)
    points = apply(crop.world_from_camera, backproject(depth, crop.camera)[valid].astype(np.float64))
    low, high = np.quantile(points, [0.005, 0.995], axis=0)
    slack = 0.05 * (high - low) + 0.01
    kept = ((points >= low - slack) & (points <= high + slack)).all(axis=1)
    return points[kept], crop.rgb[valid][kept]


def noise_m(points_world: NDArray[np.float64], view: DepthView, volume: VolumeConfig) -> float:
    """Return three sigma of the depth of (N, 3) points in a view, at least two voxels."""
    median_z = float(np.median(apply(view.camera_from_world, points_world)[:, 2]))
    return max(3 * sigma_at(median_z, view.law), 2 * volume.min_voxel_m)


def reconstruct_views(inputs: ShapeInputs, views: list[DepthView], volume: VolumeConfig) -> Reconstruction | NoShape:
    """Return the mesh of the surface in `views` and the points of `inputs`, within the box of `inputs`."""
    block = block_over(inputs.box, inputs.support_z_m, volume)
    grid = block.grid
    evidence = integrate(grid, views)
    cells = grid.cells(inputs.points_world)
    states = classify(evidence, cells[grid.contains(cells)])
    solid = solid_of(states, block.fillable, block.support_index, block.max_gap)
    if not solid.any():
        return NoShape(reason="no voxel of the object's box is solid: its views contradict one another")
    return mesh_of_field(surface_field(solid, evidence), grid, inputs)


@dataclass(frozen=True, kw_only=True, slots=True)
class Block:
    """The grid of one object."""

    grid: VoxelGrid
    #: the object's box, outside which nothing is completed
    fillable: tuple[slice, slice, slice]
    #: the lowest layer above the support surface, None without one
    support_index: int | None
    #: layers above the support within which columns are continued down to it
    max_gap: int


def block_over(box: OrientedBox, support_z_m: float | None, volume: VolumeConfig) -> Block:
    """Return the grid over the box and a margin, extended down to the support surface if that is close."""
    half = box.half_extents_m
    low_z = float(-half[2])
    float_m = 0.0 if support_z_m is None else max(low_z + float(box.center[2]) - support_z_m, 0.0)
    rests = support_z_m is not None and float_m <= _MAX_SUPPORT_GAP_M
    if rests and support_z_m is not None:
        low_z = min(low_z, support_z_m - float(box.center[2]))
    voxel = voxel_over(half, volume)
    low = np.array([-half[0], -half[1], low_z]) - _MARGIN_VOXELS * voxel
    counts = [int(n) for n in np.ceil((half - low) / voxel) + _MARGIN_VOXELS + 1]
    world_from_grid = box.world_from_box.copy()
    world_from_grid[:3, 3] += portable.matmul(box.world_from_box[:3, :3], low)
    support_index = None
    if rests and support_z_m is not None:
        support_index = max(int(np.ceil((support_z_m - world_from_grid[2, 3]) / voxel - 1e-6)), 0)
    inner = [slice(_MARGIN_VOXELS, n - _MARGIN_VOXELS) for n in counts]
    return Block(
        grid=VoxelGrid(world_from_grid=world_from_grid, voxel_m=voxel, shape=(counts[0], counts[1], counts[2])),
        fillable=(inner[0], inner[1], inner[2]),
        support_index=support_index,
        max_gap=int(np.ceil((float_m + _MAX_SUPPORT_GAP_M) / voxel)) + 1 if rests else 0,
    )


def voxel_over(half_m: NDArray[np.float64], volume: VolumeConfig) -> float:
    """Return the side of voxels over a box of half extents (3,), metres."""
    area = 8 * (half_m[0] * half_m[1] + half_m[1] * half_m[2] + half_m[2] * half_m[0])
    # Marching cubes yields about two faces per voxel face.
    voxel = max(2 * float(half_m.max()) / volume.cells, float(np.sqrt(2 * area / MAX_FACES)))
    return float(np.clip(voxel, volume.min_voxel_m, volume.max_voxel_m))


def mesh_of_field(field: NDArray[np.float32], grid: VoxelGrid, inputs: ShapeInputs) -> Reconstruction:
    """Return the smoothed, coloured mesh of the zero of a field in voxels."""
    vertices, faces = extract(field, grid)
    vertices = taubin_smoothed(vertices, faces, SMOOTHING)
    reach = SEEN_VOXELS * grid.voxel_m
    colors, is_seen = painted(vertices, inputs.crops, inputs.points_world, inputs.colors, reach)
    return in_object_frame(vertices, faces, colors, is_seen)
