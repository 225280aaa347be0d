"""Connected pieces: of cells that touch by a face, and of triangles that share a vertex."""

import numpy as np
import scipy
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.disjoint_sets import root_of


def pieces_of(cells: NDArray[np.bool_]) -> tuple[NDArray[np.int32], NDArray[np.int64], list[tuple[slice, ...]]]:
    """Return the pieces of the set ones of (nx, ny, nz) cells, numbered from 1 in the order of their first cells."""
    # int32 labels, 0 for other cells; (N,) sizes and bounds.
    labels, count = scipy.ndimage.label(cells)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    return labels, sizes, scipy.ndimage.find_objects(labels) if count else []


def piece_around(cells: NDArray[np.bool_], i: int, j: int, k: int) -> NDArray[np.bool_]:
    """Return whether each of (nx, ny, nz) cells is in the piece of a set one."""
    labels, _ = scipy.ndimage.label(cells)
    return np.asarray(labels == labels[i, j, k])


@kernel
def joined_faces(faces, num_vertices):
    """Return the piece of each of (F, 3) faces, and whether one of its edges is passed more often one way."""
    # A piece is called by its least vertex. In a closed piece each edge is passed as often one way as the other.
    count = len(faces)
    root = np.arange(num_vertices)
    for f in range(count):
        for c in range(2):
            a, b = root_of(root, faces[f, c]), root_of(root, faces[f, c + 1])
            root[max(a, b)] = min(a, b)
    # The edges that leave each vertex, and those that reach it.
    leaving, reaching = np.zeros(num_vertices + 1, np.int64), np.zeros(num_vertices + 1, np.int64)
    for f in range(count):
        for c in range(3):
            leaving[faces[f, c] + 1] += 1
            reaching[faces[f, (c + 1) % 3] + 1] += 1
    leaving, reaching = np.cumsum(leaving), np.cumsum(reaching)
    to, of, at_leaving, at_reaching = (
        np.empty(3 * count, np.int64),
        np.empty(3 * count, np.int64),
        leaving.copy(),
        reaching.copy(),
    )
    for f in range(count):
        for c in range(3):
            a, b = faces[f, c], faces[f, (c + 1) % 3]
            to[at_leaving[a]], of[at_reaching[b]] = b, a
            at_leaving[a] += 1
            at_reaching[b] += 1
    balance = np.zeros(num_vertices, np.int64)
    is_open = np.zeros(num_vertices, np.bool_)
    for a in range(num_vertices):
        for n in range(leaving[a], leaving[a + 1]):
            balance[to[n]] += 1
        for n in range(reaching[a], reaching[a + 1]):
            balance[of[n]] -= 1
        for n in range(leaving[a], leaving[a + 1]):
            if balance[to[n]] != 0:
                is_open[root_of(root, a)] = True
        for n in range(leaving[a], leaving[a + 1]):
            balance[to[n]] = 0
        for n in range(reaching[a], reaching[a + 1]):
            balance[of[n]] = 0
    pieces, are_open = np.empty(count, np.int64), np.empty(count, np.bool_)
    for f in range(count):
        pieces[f] = root_of(root, faces[f, 0])
        are_open[f] = is_open[pieces[f]]
    return pieces, are_open
