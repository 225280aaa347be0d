"""Connected pieces: of cells that touch by a face, and of triangles that share a vertex."""

from __future__ import annotations

import numpy as np

from hickory_stream.base.compiled import kernel


@kernel
def pieces_of(cells):
    """Return the pieces of the set ones of (nx, ny, nz) cells, numbered from 1 in the order of their first cells."""
    # int32 labels, (N + 1,) sizes, (N + 1, 2, 3) first cells and ends of bounds; other cells have label and size 0.
    nx, ny, nz = cells.shape
    labels, stack = np.zeros(cells.shape, np.int32), np.empty(cells.size, np.int64)
    count = 0
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if cells[i, j, k] and labels[i, j, k] == 0:
                    count += 1
                    _flood(cells, labels, stack, i, j, k, count)
    sizes, bounds = np.zeros(count + 1, np.int64), np.zeros((count + 1, 2, 3), np.int64)
    bounds[:, 0] = max(nx, ny, nz)
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                n = labels[i, j, k]
                if n > 0:
                    sizes[n] += 1
                    bounds[n, 0, 0], bounds[n, 1, 0] = min(bounds[n, 0, 0], i), i + 1
                    bounds[n, 0, 1], bounds[n, 1, 1] = min(bounds[n, 0, 1], j), max(bounds[n, 1, 1], j + 1)
                    bounds[n, 0, 2], bounds[n, 1, 2] = min(bounds[n, 0, 2], k), max(bounds[n, 1, 2], k + 1)
    return labels, sizes, bounds


@kernel
def piece_around(cells, i, j, k):
    """Return whether each of (nx, ny, nz) cells is in the piece of a set one."""
    labels = np.zeros(cells.shape, np.int32)
    _flood(cells, labels, np.empty(cells.size, np.int64), i, j, k, 1)
    return labels == 1


@kernel
def _flood(cells, labels, stack, i, j, k, label):
    nx, ny, nz = cells.shape
    labels[i, j, k] = label
    stack[0] = (i * ny + j) * nz + k
    waiting = 1
    while waiting > 0:
        waiting -= 1
        line = stack[waiting] // nz
        k = stack[waiting] - line * nz
        i = line // ny
        j = line - i * ny
        for way in range(6):
            u, v, w = i, j, k
            if way < 2:
                u += 2 * way - 1
            elif way < 4:
                v += 2 * way - 5
            else:
                w += 2 * way - 9
            if u < 0 or v < 0 or w < 0 or u >= nx or v >= ny or w >= nz:
                continue
            if cells[u, v, w] and labels[u, v, w] == 0:
                labels[u, v, w] = label
                stack[waiting] = (u * ny + v) * nz + w
                waiting += 1


@kernel
def joined_faces(faces, num_vertices):
    """Return the piece of each of (F, 3) faces, and whether one of its edges is passed more often one way."""
    # A piece is called by its least vertex. In a closed piece each edge is passed as often one way as the other.
    count = len(faces)
    root = np.arange(num_vertices)
    for f in range(count):
        for c in range(2):
            a, b = _root(root, faces[f, c]), _root(root, faces[f, c + 1])
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
                is_open[_root(root, a)] = True
        for n in range(leaving[a], leaving[a + 1]):
            balance[to[n]] = 0
        for n in range(reaching[a], reaching[a + 1]):
            balance[of[n]] = 0
    pieces, are_open = np.empty(count, np.int64), np.empty(count, np.bool_)
    for f in range(count):
        pieces[f] = _root(root, faces[f, 0])
        are_open[f] = is_open[pieces[f]]
    return pieces, are_open


@kernel
def _root(root, vertex):
    while root[vertex] != vertex:
        root[vertex] = root[root[vertex]]
        vertex = root[vertex]
    return vertex
