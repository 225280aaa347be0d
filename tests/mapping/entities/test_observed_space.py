from dataclasses import replace
from functools import reduce
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.geometry.voxels import cells_of_keys, keys_of_cells, keys_of_points
from hickory_stream.mapping.entities import observed_space
from hickory_stream.mapping.floor_warnings import tilt_warning
from tests.mapping.mapping_fixtures import space

key_sets = st.lists(st.integers(0, 30), max_size=20, unique=True).map(lambda keys: np.array(sorted(keys), np.int64))


observed = st.builds(lambda a, b, c: space(a, b, None, np.setdiff1d(c, b)), key_sets, key_sets, key_sets)


def after(*seen):
    return reduce(observed_space.add, seen, observed_space.empty_space(0.05))


def keys(*values):
    return np.array(values, dtype=np.int64)


@given(st.lists(observed, max_size=6))
def test_the_space_equals_counting_in_sets(frames):
    record = observed_space.as_record(after(*frames))
    hits, misses = np.zeros((2, 31), dtype=int)
    for frame in frames:
        hits[frame.structure_keys] += 1
        misses[frame.surface_keys] += 1
    structure = set(np.flatnonzero((hits >= 2) & (hits > misses)).tolist())
    free = {int(key) for frame in frames for key in frame.free_keys} - structure
    assert record.structure.tolist() == sorted(structure)
    assert record.free.tolist() == sorted(free)


def test_old_beliefs_are_unlearned_and_endless_looks_add_nothing():
    state = after(*[space(structure=keys(2))] * 2000)
    for _ in range(260):
        state = observed_space.add(state, space(surface=keys(2)))
    assert observed_space.as_record(state).structure.tolist() == []
    frame = space(free=keys(1, 2), structure=keys(7))
    record = observed_space.as_record(after(*[frame] * 600))
    assert (record.free.tolist(), record.structure.tolist()) == ([1, 2], [7])


def test_the_floor_goes_down_at_once_and_up_slowly():
    def floor(*heights):
        return after(*(space(floor_z_m=z) for z in heights)).floor_z_m

    assert floor() is None
    assert floor(None, None) is None
    assert floor(0.7, None) == 0.7
    # A table top was taken for the floor until the floor came into sight.
    assert floor(0.7, 0.0) == 0.0
    risen = floor(0.0, 0.7)
    assert risen is not None
    assert 0.0 < risen < 0.35
    assert floor(*[0.0] * 3, *[0.02] * 60) == pytest.approx(0.02, abs=1e-3)


def level(z_m, side_m):
    """The sorted voxels of a level square."""
    x, y = np.meshgrid(np.arange(0.0, side_m, 0.05) + 0.02, np.arange(0.0, side_m, 0.05) + 0.02)
    return np.unique(keys_of_points(np.stack([x, y, np.full(x.shape, z_m)], axis=-1).reshape(-1, 3), 0.05))


@pytest.mark.parametrize(
    ("below_m", "side_m", "is_false"),
    [(0.74, 1.5, True), (0.45, 1.0, True), (0.74, 3.0, False), (0.17, 1.5, False), (2.8, 1.5, False)],
    ids=["a table", "a low table", "a level of the room", "a step", "the storey below"],
)
def test_a_small_floor_above_a_true_one_is_withdrawn(below_m, side_m, *, is_false):
    on_it = space(structure=level(0.76, side_m), floor_z_m=0.76)
    state = after(on_it, on_it)
    assert (observed_space.false_floor(state, 0.76 - below_m) is not None) == is_false
    now = observed_space.add(state, space(floor_z_m=0.76 - below_m))
    assert now.floor_z_m == pytest.approx(0.76 - below_m)
    assert len(observed_space.as_record(now).structure) == (0 if is_false else len(level(0.76, side_m)))
    assert (
        observed_space.floor_change(state, 0.76 - below_m, observed_space.false_floor(state, 0.76 - below_m))
        is not None
    ) == (is_false or below_m > 2)


def test_walls_do_not_enlarge_a_table_and_stay_after_it():
    along, up = np.meshgrid(np.arange(-4.0, 4.0, 0.05) + 0.02, np.arange(0.0, 2.4, 0.05) + 0.02)
    walls = [np.stack([np.full(along.shape, x), along, up], axis=-1).reshape(-1, 3) for x in np.arange(-2.0, 4.0, 0.1)]
    wall = np.unique(keys_of_points(np.concatenate(walls), 0.05))
    table = np.setdiff1d(level(0.76, 1.5), wall)
    seen = space(structure=np.union1d(table, wall), floor_z_m=0.76)
    record = observed_space.as_record(after(seen, seen, space(floor_z_m=0.0)))
    assert record.structure.tolist() == wall.tolist()


def test_space_below_a_false_floor_is_free_where_rays_passed():
    table, wall = level(0.76, 1.0), level(1.6, 1.0)
    state = after(
        space(free=table[:40]), *[space(structure=np.union1d(table, wall), floor_z_m=0.76)] * 2, space(floor_z_m=0.0)
    )
    record = observed_space.as_record(state)
    assert record.structure.tolist() == wall.tolist()
    assert record.free.tolist() == table[:40].tolist()


def test_a_storey_higher_is_the_floor_at_once_and_a_step_slowly():
    state = after(space(floor_z_m=0.0))
    assert observed_space.add(state, space(floor_z_m=3.0)).floor_z_m == 3.0
    assert observed_space.add(state, space(floor_z_m=0.1)).floor_z_m == pytest.approx(0.02)


def test_a_space_with_votes_of_another_surface_is_refused():
    state = after(space(structure=level(0.0, 0.5)))
    for name in ("hits", "misses"):
        with pytest.raises(ValueError, match=rf"SpaceState.{name} has shape"):
            replace(state, **{name: np.zeros(len(state.surface) - 1, np.uint8)})
    with pytest.raises(ValueError, match=r"SpaceState.surface is of float64"):
        replace(state, surface=state.surface.astype(np.float64))


VOXEL_M = 0.05


def block(width, length, height, below=0):
    """The sorted keys of a block of voxels that begins at height 0, or so many below."""
    steps = np.meshgrid(np.arange(width), np.arange(length), np.arange(-below, height), indexing="ij")
    return np.sort(keys_of_cells(np.stack(steps, axis=-1).reshape(-1, 3)))


def test_columns_begin_where_x_or_y_changes_and_nothing_has_none():
    cells = np.array([(0, 0, 1), (0, 0, 2), (0, 1, 0), (2, 1, 5), (2, 1, 6), (2, 1, 7)])
    starts = observed_space.column_starts(cells)
    assert starts.tolist() == [0, 2, 3]
    assert observed_space.column_sizes(starts, len(cells)).tolist() == [2, 1, 3]
    starts = observed_space.column_starts(np.empty((0, 3), dtype=np.int64))
    assert starts.tolist() == observed_space.column_sizes(starts, 0).tolist() == []


@pytest.mark.parametrize("voxel_m", [0.02, 0.05, 0.1])
def test_a_column_with_structure_along_half_its_height_is_a_wall(voxel_m):
    enough = round(observed_space.WALL_M / 2 / voxel_m)
    assert observed_space.is_wall_column(np.array([1, enough - 1, enough, 2 * enough]), voxel_m).tolist() == [
        False,
        False,
        True,
        True,
    ]


@pytest.mark.parametrize(("height", "is_wall"), [(2, False), (5, False), (6, True), (12, True)])
def test_the_core_and_the_map_leave_out_the_same_columns(height, is_wall):
    # 3 m by 3 m: no table, so that it is a floor for good unless its columns are a wall's.
    keys = block(60, 60, height)
    state = observed_space.empty_space(VOXEL_M)
    for _ in range(2):
        state = observed_space.add(state, space(structure=keys, floor_z_m=0.0))
    assert (observed_space.false_floor(state, -0.5) is not None) == is_wall
    record = observed_space.as_record(state)
    assert cells_of_keys(record.structure)[:, 2].max() == height - 1
    # Of a wall no slope is told, however it leans; of a floor that rises by 5 degrees it is.
    rising = cells_of_keys(keys) + np.array([0, 0, 1]) * (cells_of_keys(keys)[:, :1] // 11)
    tilted = observed_space.empty_space(VOXEL_M)
    for _ in range(2):
        tilted = observed_space.add(tilted, space(structure=np.sort(keys_of_cells(rising)), floor_z_m=0.1))
    assert (tilt_warning(observed_space.as_record(tilted)) is None) == is_wall
