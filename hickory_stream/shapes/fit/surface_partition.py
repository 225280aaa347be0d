"""Partition of an object's surface: each triangle is owned by the primitive nearest to its farthest corner.

Triangles far outside are bisected: one from a seat down to a leg must not make the seat's primitive grow.
"""

from __future__ import annotations

import numpy as np

from hickory_stream.base.compiled import kernel
from hickory_stream.shapes.fit.quadric_lm import tangent_distance
from hickory_stream.shapes.fit.tangent_planes import distances_of

_MOST_PIECES = 20_000


@kernel
def owned_pieces(vertices, faces, rows, tolerance, min_edge):
    """Return vertices, with those that bisection adds, (P, 3) triangles, and owner and distance (P,) of each."""
    # `rows` (K, 17) as in `quadric_lm`. The distance is the farthest corner's, negative inside. A triangle is bisected
    # while that is more than `tolerance` outside of all primitives, until its edges are shorter than `min_edge`.
    most = len(faces) + _MOST_PIECES
    points = np.empty((len(vertices) + most, 3))
    distances = np.empty((len(vertices) + most, len(rows)))
    num_points = len(vertices)
    points[:num_points] = vertices
    for k in range(len(rows)):
        distances[:num_points, k] = distances_of(rows[k], vertices, np.inf)
    pieces, owners, outsides = np.empty((most, 3), np.int64), np.empty(most, np.int64), np.empty(most)
    count = 0
    stack = np.empty((64, 3), np.int64)
    for f in range(len(faces)):
        # Most triangles are not outside.
        owner, outside = _owner(distances, faces[f, 0], faces[f, 1], faces[f, 2])
        if outside <= tolerance:
            pieces[count, 0], pieces[count, 1], pieces[count, 2] = faces[f, 0], faces[f, 1], faces[f, 2]
            owners[count], outsides[count] = owner, outside
            count += 1
            continue
        depth = 1
        stack[0] = faces[f]
        while depth > 0:
            depth -= 1
            corners = stack[depth].copy()
            owner, outside = _owner(distances, corners[0], corners[1], corners[2])
            longest, length = _longest_edge(points, corners)
            has_room = depth < 60 and count + depth + len(faces) - f + 2 < most
            if outside <= tolerance or length <= min_edge or not has_room:
                pieces[count], owners[count], outsides[count] = corners, owner, outside
                count += 1
                continue
            after = (longest + 1) % 3
            points[num_points] = 0.5 * (points[corners[longest]] + points[corners[after]])
            _distances(points[num_points], rows, distances[num_points])
            stack[depth, after] = num_points
            stack[depth + 1] = corners
            stack[depth + 1, longest] = num_points
            num_points += 1
            depth += 2
    return points[:num_points], pieces[:count], owners[:count], outsides[:count]


@kernel
def owners_of(points, rows):
    """Return (N,) the primitive that each of (N, 3) points is nearest to, and (N,) its distance, negative inside."""
    owners, nearest = np.zeros(len(points), np.int64), np.full(len(points), np.inf)
    for k in range(len(rows)):
        distances = distances_of(rows[k], points, np.inf)
        for n in range(len(points)):
            if distances[n] < nearest[n]:
                owners[n], nearest[n] = k, distances[n]
    return owners, nearest


@kernel
def _distances(point, rows, out):
    local, gradient, shape = np.empty(3), np.empty(3), np.empty(5)
    for k in range(len(rows)):
        out[k] = tangent_distance(rows[k], point[0], point[1], point[2], local, gradient, shape, False, np.inf)


@kernel
def _owner(distances, a, b, c):
    best, least = 0, 1e300
    for k in range(distances.shape[1]):
        farthest = max(distances[a, k], distances[b, k], distances[c, k])
        if farthest < least:
            best, least = k, farthest
    return best, least


@kernel
def _longest_edge(points, corners):
    longest, most = 0, -1.0
    for c in range(3):
        d = (c + 1) % 3
        squared = 0.0
        for i in range(3):
            squared += (points[corners[c], i] - points[corners[d], i]) ** 2
        if squared > most:
            longest, most = c, squared
    return longest, np.sqrt(most)
