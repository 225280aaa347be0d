import itertools
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.geometry import voxels
from tests.strategies import integer_cells, seeds

few_cells = integer_cells(largest=6, max_size=20)


def sorted_keys(cells):
    return np.unique(voxels.keys_of_cells(cells))


def neighbours(cells):
    steps = list(itertools.product((-1, 0, 1), repeat=3))
    return {tuple(int(v) for v in np.add(cell, step)) for cell in cells for step in steps}


@given(integer_cells())
def test_cells_survive_their_keys_negative_ones_too(cells):
    assert np.array_equal(voxels.cells_of_keys(voxels.keys_of_cells(cells)), cells)


@given(integer_cells())
def test_sorted_keys_are_sorted_cells(cells):
    by_key = voxels.cells_of_keys(np.sort(voxels.keys_of_cells(cells)))
    assert [tuple(c) for c in by_key] == sorted(tuple(c) for c in cells)


@given(seeds, st.sampled_from([0.01, 0.05, 0.3]))
def test_a_point_lies_in_its_voxel(seed, voxel_m):
    points = np.random.default_rng(seed).uniform(-3, 3, (50, 3))
    away = np.abs(voxels.centers_of_keys(voxels.keys_of_points(points, voxel_m), voxel_m) - points)
    assert (away <= voxel_m / 2 + 1e-6).all()


def test_the_lattice_starts_at_the_origin_with_half_open_cells():
    points = np.array([[0, 0, 0], [0.0999, 0.05, 0.01], [-0.0001, 0, 0], [0.1, -0.1, -0.1001]])
    assert voxels.cells_of_keys(voxels.keys_of_points(points, 0.1)).tolist() == [
        [0, 0, 0],
        [0, 0, 0],
        [-1, 0, 0],
        [1, -1, -2],
    ]


@given(few_cells, few_cells)
def test_a_key_is_contained_when_its_cell_is_in_the_set(cells, queries):
    known = {tuple(c) for c in cells}
    expected = [tuple(q) in known for q in queries]
    assert voxels.contains(sorted_keys(cells), voxels.keys_of_cells(queries)).tolist() == expected


@given(few_cells, few_cells)
def test_a_cell_is_near_a_set_when_it_or_a_neighbour_is_in_it(cells, queries):
    expected = [tuple(cell) in neighbours(cells) for cell in queries.tolist()]
    assert voxels.are_near(sorted_keys(cells), voxels.keys_of_cells(queries)).tolist() == expected


@given(few_cells)
def test_dilation_adds_the_26_neighbours_and_nothing_else(cells):
    dilated = voxels.dilate(sorted_keys(cells))
    assert (np.diff(dilated) > 0).all()
    assert {tuple(int(v) for v in c) for c in voxels.cells_of_keys(dilated)} == neighbours(cells)


def test_stray_points_have_no_company_and_a_tables_leg_has():
    rng = np.random.default_rng(5)
    top = rng.uniform((0, 0, 0.7), (1, 0.6, 0.74), (3000, 3))
    leg = rng.uniform((0.04, 0.04, 0.0), (0.08, 0.08, 0.7), (300, 3))
    kept = voxels.without_outliers(np.concatenate([top, leg, np.array([[0.5, 0.3, 1.2], [2, 2, 2], [-1, 0, 0.4]])]))
    assert kept[3000:3300].all()
    assert not kept[3300:].any()


@given(seeds, st.integers(1, 30))
def test_where_few_points_have_company_all_of_them_are_kept(seed, count):
    spread = np.random.default_rng(seed).permutation(1000)[:count, None] * np.array([[0.2, 0.1, 0.3]])
    assert voxels.without_outliers(spread).all()


key_lists = st.lists(st.integers(-(2**40), 2**40) | st.integers(0, 12), max_size=40).map(
    lambda keys: np.array(keys, dtype=np.int64)
)


@given(key_lists, key_lists)
def test_places_equal_a_binary_search_in_any_order_of_queries(keys, queries):
    assert np.array_equal(voxels.places(np.sort(keys), queries), np.searchsorted(np.sort(keys), queries))


@given(key_lists, key_lists, key_lists)
def test_exchanging_keys_is_taking_a_difference_and_then_a_union(a, gone, new):
    a, gone, new = np.unique(a), np.unique(gone), np.unique(new)
    assert np.array_equal(voxels.union(a, new), np.union1d(a, new))
    assert np.array_equal(voxels.difference(a, gone), np.setdiff1d(a, gone))
    assert np.array_equal(voxels.exchanged(a, gone, new), np.union1d(np.setdiff1d(a, gone), new))


@given(key_lists, key_lists, key_lists)
def test_keys_that_do_not_ascend_are_exchanged_within_memory(a, gone, new):
    # A journal may come from anybody. What comes of it means nothing; that nothing else is written to counts.
    a = np.unique(a)
    repeated, shuffled = np.repeat(gone, 3), np.concatenate([new[::-1], new])
    found = voxels.exchanged(a, repeated, shuffled)
    assert len(a) - len(gone) <= len(found) <= len(a) + len(shuffled)
    assert np.isin(found, np.concatenate([a, new])).all()


@given(key_lists)
def test_equal_keys_are_one_group_numbered_as_it_comes(keys):
    groups, distinct = voxels.groups_of(keys)
    assert np.array_equal(distinct[groups], keys)
    assert list(distinct) == list(dict.fromkeys(keys.tolist()))
    assert np.array_equal(voxels.sorted_unique(keys), np.unique(keys))


@given(key_lists, seeds)
def test_the_sums_of_equal_keys_are_those_over_all_of_them(keys, seed):
    weights = np.random.default_rng(seed).integers(0, 9, len(keys))
    equal = keys[:, None] == keys[None]
    assert np.array_equal(voxels.sums_of_equal(keys), equal.sum(axis=1))
    assert np.array_equal(voxels.sums_of_equal(keys, weights), equal @ weights)
