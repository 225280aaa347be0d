"""Partition of an object's surface: each triangle is owned by the primitive nearest to its farthest corner.

Triangles far outside are bisected: one from a seat down to a leg must not make the seat's primitive grow.
"""

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.shapes.fit.cell_shares import DISTANCE, X, Y, Z, fill_exact_distances, new_block
from hickory_stream.shapes.fit.tangent_planes import distances_of

_MOST_PIECES = 20_000


def owned_pieces(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int64],
    rows: NDArray[np.float64],
    tolerance: float,
    min_edge: float,
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Return vertices, with those that bisection adds, (P, 3) triangles, and owner and distance (P,) of each."""
    # `rows` (K, 17) as in `quadric_lm`. The distance is the farthest corner's, negative inside. A triangle is bisected
    # while that is more than `tolerance` outside of all primitives, until its edges are shorter than `min_edge`.
    most = len(faces) + _MOST_PIECES
    points, distances = np.empty((len(vertices) + most, 3)), np.empty((len(vertices) + most, len(rows)))
    near = _distances(vertices, rows)
    points[: len(vertices)], distances[: len(vertices)] = vertices, near.T
    # Most triangles are not outside.
    a, b, c = faces.T.copy()
    farthest = np.maximum(np.maximum(near[:, a], near[:, b]), near[:, c])
    owners, outsides = farthest.argmin(axis=0), farthest.min(axis=0)
    is_out = outsides > tolerance
    # How many pieces there is room for when it is a triangle's turn.
    room = most - 2 - np.arange(len(faces), 0, -1) - np.cumsum(~is_out)
    pieces, numbers = np.empty((_MOST_PIECES + len(faces), 3), np.int64), np.empty((3, most))
    num_points, count = _bisect(
        points, distances, len(vertices), faces, np.flatnonzero(is_out), room, rows, tolerance, min_edge,
        np.empty((64, 3), np.int64), new_block(), pieces, numbers,
    )  # fmt: skip
    of_face = np.concatenate([np.flatnonzero(~is_out), numbers[0, :count].astype(np.int64)])
    order = np.argsort(of_face, kind="stable")
    return (
        points[:num_points],
        np.concatenate([faces[~is_out], pieces[:count]])[order],
        np.concatenate([owners[~is_out], numbers[1, :count].astype(np.int64)])[order],
        np.concatenate([outsides[~is_out], numbers[2, :count]])[order],
    )


def owners_of(points: NDArray[np.float64], rows: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return (N,) the primitive that each of (N, 3) points is nearest to, and (N,) its distance, negative inside."""
    distances = _distances(points, rows)
    return distances.argmin(axis=0), distances.min(axis=0)


def _distances(points: NDArray[np.float64], rows: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([distances_of(row, points, np.inf) for row in rows])


@kernel
def _bisect(
    points, distances, num_points, faces, which, room, rows, tolerance, min_edge, stack, block, pieces, numbers
):
    # Fills pieces, and for each its face, owner and distance; returns how many points and pieces there are.
    count, one = 0, np.int64(1)
    for f in which:
        depth = 1
        for c in range(3):
            stack[0, c] = faces[f, c]
        while depth > 0:
            depth -= 1
            a, b, c = stack[depth, 0], stack[depth, 1], stack[depth, 2]
            owner, outside = 0, 1e300
            for k in range(len(rows)):
                farthest = max(distances[a, k], distances[b, k], distances[c, k])
                if farthest < outside:
                    owner, outside = k, farthest
            longest, most = 0, -1.0
            for side in range(3):
                squared = 0.0
                for i in range(3):
                    squared += (points[stack[depth, side], i] - points[stack[depth, (side + 1) % 3], i]) ** 2
                if squared > most:
                    longest, most = side, squared
            has_room = depth < len(stack) - 4 and count + depth < room[f]
            if outside <= tolerance or np.sqrt(most) <= min_edge or not has_room:
                pieces[count, 0], pieces[count, 1], pieces[count, 2] = a, b, c
                numbers[0, count], numbers[1, count], numbers[2, count] = f, owner, outside
                count += 1
                continue
            after = (longest + 1) % 3
            for c in range(3):
                stack[depth + 1, c] = stack[depth, c]
            stack[depth, after], stack[depth + 1, longest] = num_points, num_points
            for i in range(3):
                points[num_points, i] = 0.5 * (points[stack[depth, longest], i] + points[stack[depth + 1, after], i])
            for k in range(len(rows)):
                block[X], block[Y], block[Z] = points[num_points, 0], points[num_points, 1], points[num_points, 2]
                fill_exact_distances(block, one, rows[k], np.inf)
                distances[num_points, k] = block[DISTANCE]
            num_points += 1
            depth += 2
    return num_points, count
