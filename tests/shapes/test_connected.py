import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage
from hickory_stream.shapes.connected import joined_faces, piece_around, pieces_of


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
