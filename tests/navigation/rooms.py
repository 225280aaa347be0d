"""A room of 6 x 4 m to plan in: a wall across with a door of 1 m, and a table; all of it seen, or not."""

from dataclasses import replace
from functools import cache
import numpy as np
from hickory_stream.geometry.superquadric import Superquadrics
from hickory_stream.geometry.voxels import keys_of_cells
from hickory_stream.records import MapSnapshot, ObservedSpace, Submap
from tests.engine.snapshot_fixtures import box_mesh, make_object, make_shape, placed

VOXEL_M = 0.05
TABLE_AT = (1.5, 2.0)


def boxes(*parts):
    """Superquadrics with sharp edges: (centre, half extents) each."""
    return Superquadrics(
        exponents=np.full((len(parts), 2), 0.1),
        semi_axes_m=np.array([half for _, half in parts]),
        world_from_local=np.stack([placed(*center) for center, _ in parts]),
    )


def table(x=TABLE_AT[0], y=TABLE_AT[1]):
    """A top of 1.2 x 0.8 m at 0.7 m, 2 cm thick, on four legs."""
    legs = [((x + a, y + b, 0.35), (0.03, 0.03, 0.34)) for a in (-0.55, 0.55) for b in (-0.35, 0.35)]
    return boxes(((x, y, 0.7), (0.6, 0.4, 0.01)), *legs)


def tracked(object_id, inflated, *, with_shape=True):
    low = (inflated.world_from_local[:, :3, 3] - inflated.semi_axes_m).min(axis=0)
    high = (inflated.world_from_local[:, :3, 3] + inflated.semi_axes_m).max(axis=0)
    mesh, pose = box_mesh(tuple(high - low), (120, 90, 60)), placed(*((low + high) / 2))
    shape = make_shape(mesh, pose, tuple((high - low) / 2), revision=object_id)
    shape = replace(shape, inflated=inflated)
    return make_object(object_id, mesh, pose, shape=shape if with_shape else None)


@cache
def seen_room(*, door_m=(1.5, 2.5), dark_m=None):
    """The room's voxels; `dark_m` are the ends, along x, of what nobody saw."""
    cells = np.stack(np.meshgrid(np.arange(-1, 121), np.arange(-1, 81), np.arange(-1, 40), indexing="ij"), axis=-1)
    i, j, k = np.moveaxis(cells, -1, 0)
    is_outer = (i < 0) | (i >= 120) | (j < 0) | (j >= 80) | (k < 0)
    x, y = (i + 0.5) * VOXEL_M, (j + 0.5) * VOXEL_M
    is_inner = (np.abs(x - 3.0) < VOXEL_M) & ((y < door_m[0]) | (y > door_m[1]))
    is_seen = np.ones(x.shape, bool) if dark_m is None else (x < dark_m[0]) | (x > dark_m[1])
    is_wall = is_outer | is_inner

    def keys(mask):
        return np.sort(keys_of_cells(cells[mask]))

    return ObservedSpace(
        voxel_m=VOXEL_M, free=keys(~is_wall & is_seen), structure=keys(is_wall & is_seen), floor_z_m=0.0
    )


def snapshot(*objects, space=None, world_from_submap=None):
    pose = np.eye(4) if world_from_submap is None else world_from_submap
    submap = Submap(id=0, world_from_submap=pose, observed_space=space or seen_room())
    return MapSnapshot(revision=1, stamp_ns=1_700_000_000_000_000_000, submaps=(submap,), objects=objects)
