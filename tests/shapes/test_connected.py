import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy import ndimage
from hickory_stream.shapes.connected import joined_faces, piece_around, pieces_of
from hickory_stream.shapes.fit.seeds import chessboard_depth
from hickory_stream.shapes.inflate.cover import undominated
from hickory_stream.shapes.reconstruct.meshing import rough_distance


@given(st.integers(0, 1000), st.floats(0.2, 0.8), st.tuples(*[st.integers(1, 12)] * 3))
def test_pieces_of_cells_are_labelled_in_their_order(seed, share, shape):
    cells = np.random.default_rng(seed).random(shape) < share
    labels, sizes, windows = pieces_of(cells)
    truth, count = ndimage.label(cells)
    assert np.array_equal(labels, truth)
    assert sizes.tolist() == [(truth == label).sum() for label in range(1, count + 1)]
    for label, window in enumerate(windows, start=1):
        assert (truth[window] == label).sum() == (truth == label).sum()
        assert all((truth[window] == label).any(axis=axis).any() for axis in range(3))
    for cell in np.argwhere(cells)[:3]:
        assert np.array_equal(piece_around(cells, *cell), truth == truth[tuple(cell)])


def edges_by_count(faces):
    balance = {}
    for face in faces.tolist():
        for a, b in zip(face, face[1:] + face[:1], strict=True):
            balance[a, b] = balance.get((a, b), 0) + 1
            balance[b, a] = balance.get((b, a), 0) - 1
    return balance


@given(st.integers(0, 1000), st.integers(1, 40), st.integers(3, 30))
def test_faces_join_at_vertices_and_open_at_unpaired_edges(seed, num_faces, num_vertices):
    faces = np.random.default_rng(seed).integers(0, num_vertices, (num_faces, 3))
    pieces, are_open = joined_faces(faces, num_vertices)
    balance = edges_by_count(faces)
    together = [set(face) for face in faces.tolist()]
    for f in range(num_faces):
        piece = set(faces[f].tolist())
        while any(piece & other and not other <= piece for other in together):
            piece = piece.union(*(other for other in together if piece & other))
        assert pieces[f] == min(piece)
        assert are_open[f] == any(count != 0 for (a, _), count in balance.items() if a in piece)


@given(arrays.arrays(bool, arrays.array_shapes(min_dims=3, max_dims=3, max_side=8), elements=st.booleans()))
def test_depth_is_the_chessboard_distance_to_what_is_not_solid(solid):
    assert np.array_equal(chessboard_depth(solid), ndimage.distance_transform_cdt(solid, "chessboard"))


@given(st.integers(0, 1000), st.integers(1, 12), st.tuples(*[st.integers(1, 14)] * 3))
def test_distances_are_those_of_the_transform_up_to_the_reach(seed, reach, shape):
    rng = np.random.default_rng(seed)
    solid = ndimage.uniform_filter(rng.random(shape), 3) > rng.uniform(0.35, 0.65)
    found = rough_distance(solid, reach)
    far = np.full(shape, float(reach))
    away = ndimage.distance_transform_edt(~solid) if solid.any() else far
    deep = ndimage.distance_transform_edt(solid) if not solid.all() else far
    truth = np.where(solid, 0.5 - np.minimum(deep, reach), np.minimum(away, reach) - 0.5)
    assert np.array_equal(found, truth.astype(np.float32))


def by_definition(points):
    """Return (N,) which points have no other one beyond them in all three coordinates."""
    beyond = (points[None] >= points[:, None]).all(axis=2) & (points[None] > points[:, None]).any(axis=2)
    return np.asarray(~beyond.any(axis=1))


@pytest.mark.parametrize("steps", [4, 1000])
def test_a_point_is_left_out_exactly_if_another_lies_beyond(steps):
    points = np.floor(np.random.default_rng(7).random((400, 3)) * steps) / steps
    # On steps so coarse many points share a coordinate: whatever is left out still has one that stands for it.
    kept = undominated(points)
    expected = by_definition(points)
    assert {tuple(point) for point in points[expected]} <= {tuple(point) for point in points[kept]}
    if steps == 1000:
        np.testing.assert_array_equal(kept, expected)


def test_few_points_of_a_box_decide_and_all_of_a_ball_do():
    rng = np.random.default_rng(8)
    ball = np.abs(rng.normal(size=(500, 3)))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    box = rng.random((500, 3))
    box[np.arange(500), rng.integers(3, size=500)] = 1.0
    assert undominated(ball).all()
    assert undominated(np.concatenate([box, np.full((1, 3), 1.001)])).sum() == 1
