import numpy as np
import pytest
from hickory_stream.geometry.voxels import cells_of_keys, keys_of_cells
from hickory_stream.mapping.entities.observed_space import (
    WALL_M,
    add,
    as_record,
    column_sizes,
    column_starts,
    empty_space,
    false_floor,
    is_wall_column,
)
from hickory_stream.mapping.floor_warnings import tilt_warning
from tests.mapping.mapping_fixtures import space

VOXEL_M = 0.05


def block(width, length, height, below=0):
    """The sorted keys of a block of voxels that begins at height 0, or so many below."""
    steps = np.meshgrid(np.arange(width), np.arange(length), np.arange(-below, height), indexing="ij")
    return np.sort(keys_of_cells(np.stack(steps, axis=-1).reshape(-1, 3)))


def test_columns_begin_where_x_or_y_changes_and_nothing_has_none():
    cells = np.array([(0, 0, 1), (0, 0, 2), (0, 1, 0), (2, 1, 5), (2, 1, 6), (2, 1, 7)])
    starts = column_starts(cells)
    assert starts.tolist() == [0, 2, 3]
    assert column_sizes(starts, len(cells)).tolist() == [2, 1, 3]
    starts = column_starts(np.empty((0, 3), dtype=np.int64))
    assert starts.tolist() == column_sizes(starts, 0).tolist() == []


@pytest.mark.parametrize("voxel_m", [0.02, 0.05, 0.1])
def test_a_column_with_structure_along_half_its_height_is_a_wall(voxel_m):
    enough = round(WALL_M / 2 / voxel_m)
    assert is_wall_column(np.array([1, enough - 1, enough, 2 * enough]), voxel_m).tolist() == [False, False, True, True]


@pytest.mark.parametrize(("height", "is_wall"), [(2, False), (5, False), (6, True), (12, True)])
def test_the_core_and_the_map_leave_out_the_same_columns(height, is_wall):
    # 3 m by 3 m: no table, so that it is a floor for good unless its columns are a wall's.
    keys = block(60, 60, height)
    state = empty_space(VOXEL_M)
    for _ in range(2):
        state = add(state, space(structure=keys, floor_z_m=0.0))
    assert (false_floor(state, -0.5) is not None) == is_wall
    record = as_record(state)
    assert cells_of_keys(record.structure)[:, 2].max() == height - 1
    # Of a wall no slope is told, however it leans; of a floor that rises by 5 degrees it is.
    rising = cells_of_keys(keys) + np.array([0, 0, 1]) * (cells_of_keys(keys)[:, :1] // 11)
    tilted = empty_space(VOXEL_M)
    for _ in range(2):
        tilted = add(tilted, space(structure=np.sort(keys_of_cells(rising)), floor_z_m=0.1))
    assert (tilt_warning(as_record(tilted)) is None) == is_wall
