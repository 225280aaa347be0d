"""The certificate of layer 4: does it contain the object and its margin? Checked from the result alone.

Every triangle, bisected as needed, and every point of layer 1 must lie in one primitive with a ball of the margin's
radius: since primitives are convex, the balls around three corners suffice. Every cell of the interior, split as
needed, must lie in one primitive, unless all of it is within the margin of the surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.portable_kernels import exp, log
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.superquadric import Superquadrics
from hickory_stream.records import ObjectShape
from hickory_stream.shapes.inflate.cover import (
    NET,
    NET_FACTOR,
    local_abs,
    log_gauge,
    log_gauge_of_ball,
    new_stairs,
    place_of,
    put,
)
from hickory_stream.shapes.mesh_validation import used_surface
from hickory_stream.shapes.sdf import distance_grid

# By how much ln G must stay below its limit: several orders of magnitude above the rounding error of its evaluation.
NUMERICAL_MARGIN = 1e-9
# How often a triangle is bisected before it counts as uncovered.
_MAX_BISECTIONS = 18
_HALF_DIAGONAL = float(np.sqrt(0.75))
# The maximum depth of the split of an interior cell into eight, plus one.
_CELL_LEVELS = 4
# Only cells at seams between primitives need splitting. If more than this are uncovered, whole parts are uncovered, and
# splitting would not help.
_MOST_SPLIT = 2000
# The fewest and the most cells along the longest side.
_CELLS = (16, 96)
_EIGHTHS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)


@dataclass(frozen=True, kw_only=True, slots=True)
class Certificate:
    """The numbers of checked and of uncovered elements."""

    num_triangles: int
    #: triangles after bisection
    num_pieces: int
    #: of layer 1
    num_points: int
    #: of the interior
    num_cells: int
    uncovered_triangles: int
    uncovered_points: int
    uncovered_cells: int
    #: an upper bound of G over what is covered
    max_g: float
    #: unchecked thickness under the surface, 0 for margins of at least 2 % of the longest side
    shell_m: float

    @property
    def holds(self) -> bool:
        """Whether everything is covered."""
        return self.uncovered_triangles + self.uncovered_points + self.uncovered_cells == 0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Inside:
    """The cells inside the solid, beyond the margin of the surface."""

    #: (N, 3)
    centers: NDArray[np.float64]
    #: (N,) the last cell of the row without a gap
    row_ends: NDArray[np.int64]
    #: half the side of a cell
    half_m: float
    #: (N,) truncated signed distances of the centres
    distances_m: NDArray[np.float64]
    margin_m: float
    #: the thickness of the unchecked layer between the margin and the cells
    shell_m: float


def certify(
    primitives: Superquadrics,
    vertices_world: NDArray[np.float64],
    faces: NDArray[np.int32],
    points_world: NDArray[np.float64],
    inside: Inside,
    *,
    r_safe_m: float,
    g: float,
) -> Certificate:
    """Return whether the union of the primitives, each with G <= g, contains the object and its margin.

    (V, 3) vertices, (F, 3) faces and (N, 3) points of layer 1 in the frame of the primitives.
    """
    arguments = (primitives.exponents, primitives.semi_axes_m, primitives.world_from_local)
    log_g = float(log(g)) - NUMERICAL_MARGIN
    pieces, uncovered, worst = _triangles(vertices_world, faces, *arguments, r_safe_m, log_g, NET, NET_FACTOR)
    out_points, worst_point = _balls(points_world, *arguments, r_safe_m, log_g, NET, NET_FACTOR)
    out_cells = len(uncovered_cells(primitives, inside, g))
    return Certificate(
        num_triangles=len(faces),
        num_pieces=pieces,
        num_points=len(points_world),
        num_cells=len(inside.centers),
        uncovered_triangles=uncovered,
        uncovered_points=out_points,
        uncovered_cells=out_cells,
        max_g=float(exp(min(max(worst, worst_point), 700.0))),
        shell_m=inside.shell_m,
    )


def inside_of(vertices_world: NDArray[np.float64], faces: NDArray[np.int32], *, r_safe_m: float) -> Inside:
    """Return the interior of a used surface (`used_surface`) that must be covered, besides the surface and its margin.

    A cell is entirely inside the solid, or within two half diagonals of the surface; up to a limit the lattice is so
    fine that the margin covers the latter (else `shell_m`). Overlapping parts are one solid; a plane has no interior.
    """
    extent = np.ptp(vertices_world, axis=0) if len(faces) else np.zeros(3)
    if not extent.min() > 1e-6 * extent.max():
        no_cells = np.empty(0, np.int64)
        return Inside(
            centers=np.empty((0, 3)),
            row_ends=no_cells,
            half_m=0.0,
            distances_m=np.empty(0),
            margin_m=r_safe_m,
            shell_m=0.0,
        )
    longest = float(extent.max())
    wanted = 2.02 * _HALF_DIAGONAL * longest / max(r_safe_m, longest / _CELLS[1])
    cells = int(np.ceil(np.clip(wanted, *_CELLS)))
    step = longest / cells
    grid = distance_grid(vertices_world, faces, cells=cells, band_cells=1.0)
    half_diagonal = _HALF_DIAGONAL * step
    covered_by_margin = np.abs(grid.values) + half_diagonal <= min(r_safe_m, grid.band_m)
    deep = np.flatnonzero((grid.values <= -half_diagonal) & ~covered_by_margin)
    # Restricted to the bounds: winding numbers of an open mesh can be large outside of them.
    centers = grid.points(deep)
    low, high = vertices_world.min(axis=0) + 0.49 * step, vertices_world.max(axis=0) - 0.49 * step
    is_within = ((centers >= low) & (centers <= high)).all(axis=1)
    deep = deep[is_within]
    return Inside(
        centers=centers[is_within],
        row_ends=_row_ends(deep, grid.values.shape[2]),
        half_m=step / 2,
        distances_m=grid.values.ravel()[deep].astype(np.float64),
        margin_m=r_safe_m,
        shell_m=max(2 * half_diagonal - r_safe_m, 0.0),
    )


def uncovered_cells(primitives: Superquadrics, inside: Inside, g: float) -> NDArray[np.float64]:
    """Return (N, 4) the centres and half sides of the cells, or parts of cells, that lie in no primitive.

    Cells are split into eight, up to a few times: at a seam each part lies in one primitive. Parts within the margin of
    the surface are dropped.
    """
    log_g = float(log(g)) - NUMERICAL_MARGIN
    left = np.column_stack([inside.centers, inside.distances_m])
    half = inside.half_m
    row_ends = inside.row_ends
    for level in range(_CELL_LEVELS):
        shape = (primitives.exponents, primitives.semi_axes_m, primitives.world_from_local)
        left = left[_cells(np.ascontiguousarray(left[:, :3]), row_ends, half, *shape, log_g)]
        if len(left) == 0 or level == _CELL_LEVELS - 1 or len(left) > _MOST_SPLIT:
            break
        half /= 2
        left = _parts(left, half, inside.margin_m)
        row_ends = np.arange(len(left))
    return np.column_stack([left[:, :3], np.full(len(left), half)])


def _row_ends(cells: NDArray[np.int64], row: int) -> NDArray[np.int64]:
    # Sorted indices in a grid with rows of `row`.
    is_last = np.ones(len(cells), bool)
    is_last[:-1] = (np.diff(cells) != 1) | (cells[1:] % row == 0)
    last = np.flatnonzero(is_last)
    return last[np.searchsorted(last, np.arange(len(cells)))]


def _parts(cells: NDArray[np.float64], half: float, margin_m: float) -> NDArray[np.float64]:
    # (M, 4) eighths of cells, with bounds of their distances, that may reach beyond the margin.
    # The distance function is 1-Lipschitz: between two centres it changes by at most their distance.
    way = half * np.sqrt(3)
    parts = cells[:, None, :3] + half * _EIGHTHS[None]
    farthest = np.repeat(cells[:, 3] - way, 8)
    return np.column_stack([parts.reshape(-1, 3), farthest])[way - farthest > margin_m]


@kernel
def _body(exponents, axes, pose):
    # Centre, rotation, semi-axes, exponents as numbers: counting references to an array takes longer than the rest.
    return (
        (pose[0, 3], pose[1, 3], pose[2, 3]),
        (pose[0, 0], pose[0, 1], pose[0, 2], pose[1, 0], pose[1, 1], pose[1, 2], pose[2, 0], pose[2, 1], pose[2, 2]),
        (axes[0], axes[1], axes[2]),
        (exponents[0], exponents[1]),
    )


@kernel
def _local(body, x, y, z):
    center, r, _, _ = body
    dx, dy, dz = x - center[0], y - center[1], z - center[2]
    return r[0] * dx + r[3] * dy + r[6] * dz, r[1] * dx + r[4] * dy + r[7] * dz, r[2] * dx + r[5] * dy + r[8] * dz


@kernel
def _ball_in(x, y, z, body, radius, log_g, net, factor):
    # An upper bound of ln G over a ball; infinity if the ball may protrude.
    x, y, z = _local(body, x, y, z)
    return _local_ball_in(abs(x), abs(y), abs(z), body[2], body[3], radius, log_g, net, factor)


@kernel
def _local_ball_in(x, y, z, axes, exponents, radius, log_g, net, factor):
    if x + radius > axes[0] or y + radius > axes[1] or z + radius > axes[2]:
        return np.inf
    e1, e2 = exponents[0], exponents[1]
    limit = 0.5 * e1 * log_g
    value = log_gauge_of_ball(x, y, z, radius, axes, e1, e2, limit, net, factor)
    return 2.0 / e1 * value if value <= limit else np.inf


@kernel
def _balls_in(points, exponents, axes, pose, radius, log_g, net, factor):
    # (N,) bounds as `_ball_in`; a dominated point has the bound of the one that dominates it.
    local = local_abs(points, pose)
    sizes, powers = (axes[0], axes[1], axes[2]), (exponents[0], exponents[1])
    out = np.empty(len(points))
    stairs, count = new_stairs(len(points)), 0
    for n in np.argsort(-local[:, 0], kind="mergesort"):
        x, y, z = local[n, 0], local[n, 1], local[n, 2]
        at = place_of(stairs, count, y)
        if at < count and stairs[at, 1] >= z:
            out[n] = stairs[at, 2]
            continue
        out[n] = _local_ball_in(x, y, z, sizes, powers, radius, log_g, net, factor)
        if out[n] < np.inf:
            count = put(stairs, count, at, y, z, out[n])
    return out


@kernel
def _balls(points, exponents, axes, poses, radius, log_g, net, factor):
    out, worst, last = 0, -700.0, 0
    for n in range(len(points)):
        best = np.inf
        for i in range(len(axes)):
            k = (last + i) % len(axes)
            body = _body(exponents[k], axes[k], poses[k])
            best = _ball_in(points[n, 0], points[n, 1], points[n, 2], body, radius, log_g, net, factor)
            if best < np.inf:
                last = k
                break
        if best == np.inf:
            out += 1
        else:
            worst = max(worst, best)
    return out, worst


@kernel
def _triangles(vertices, faces, exponents, axes, poses, radius, log_g, net, factor):
    # The pieces, the uncovered triangles, and the largest ln G of a covered one.
    count = len(axes)
    bounds = np.empty((len(vertices), count))
    for k in range(count):
        bounds[:, k] = _balls_in(vertices, exponents[k], axes[k], poses[k], radius, log_g, net, factor)
    corners = np.empty((_MAX_BISECTIONS + 2, 3, 3))
    values = np.empty((_MAX_BISECTIONS + 2, 3, count))
    depths = np.empty(_MAX_BISECTIONS + 2, np.int64)
    pieces, uncovered, worst = 0, 0, -700.0
    for f in range(len(faces)):
        # Most triangles are covered as they are.
        best = np.inf
        for k in range(count):
            best = min(best, max(bounds[faces[f, 0], k], bounds[faces[f, 1], k], bounds[faces[f, 2], k]))
        if best < np.inf:
            pieces += 1
            worst = max(worst, best)
            continue
        size = 1
        for c in range(3):
            corners[0, c] = vertices[faces[f, c]]
            values[0, c] = bounds[faces[f, c]]
        depths[0] = 0
        while size > 0:
            size -= 1
            best = np.inf
            for k in range(count):
                best = min(best, max(values[size, 0, k], values[size, 1, k], values[size, 2, k]))
            if best < np.inf:
                pieces += 1
                worst = max(worst, best)
                continue
            if depths[size] == _MAX_BISECTIONS or _is_lost(values[size]):
                uncovered += 1
                break
            first, most = 0, -1.0
            for c in range(3):
                squared = ((corners[size, c] - corners[size, (c + 1) % 3]) ** 2).sum()
                if squared > most:
                    first, most = c, squared
            second = (first + 1) % 3
            middle = 0.5 * (corners[size, first] + corners[size, second])
            corners[size + 1], values[size + 1] = corners[size], values[size]
            corners[size, second], corners[size + 1, first] = middle, middle
            for k in range(count):
                body = _body(exponents[k], axes[k], poses[k])
                bound = _ball_in(middle[0], middle[1], middle[2], body, radius, log_g, net, factor)
                values[size, second, k], values[size + 1, first, k] = bound, bound
            depths[size] += 1
            depths[size + 1] = depths[size]
            size += 2
    return pieces, uncovered, worst


@kernel
def _is_lost(values):
    # No bisection helps a corner that lies in no primitive.
    for c in range(3):
        if values[c].min() == np.inf:
            return True
    return False


@kernel
def _cells(centers, row_ends, half, exponents, axes, poses, log_g):
    # Primitives are convex: one that contains two cells of a row contains those between them.
    out = np.ones(len(centers), np.bool_)
    reach = np.empty((len(axes), 3))
    for k in range(len(axes)):
        for i in range(3):
            reach[k, i] = half * (abs(poses[k, 0, i]) + abs(poses[k, 1, i]) + abs(poses[k, 2, i]))
    last, n = 0, 0
    while n < len(centers):
        end = n
        for step in range(len(axes)):
            k = (last + step) % len(axes)
            body, around = _body(exponents[k], axes[k], poses[k]), (reach[k, 0], reach[k, 1], reach[k, 2])
            if not _holds(centers[n, 0], centers[n, 1], centers[n, 2], half, around, body, log_g):
                continue
            # The farthest cell of the row that it contains too.
            end, beyond = row_ends[n], row_ends[n] + 1
            if not _holds(centers[end, 0], centers[end, 1], centers[end, 2], half, around, body, log_g):
                end, beyond = n, end
                while beyond - end > 1:
                    middle = (end + beyond) // 2
                    x, y, z = centers[middle, 0], centers[middle, 1], centers[middle, 2]
                    if _holds(x, y, z, half, around, body, log_g):
                        end = middle
                    else:
                        beyond = middle
            out[n : end + 1] = False
            last = k
            break
        n = end + 1
    return out


@kernel
def _holds(x, y, z, half, reach, body, log_g):
    center = _local(body, x, y, z)
    x, y, z = abs(center[0]), abs(center[1]), abs(center[2])
    axes, exponents = body[2], body[3]
    if x > axes[0] or y > axes[1] or z > axes[2]:
        return False
    e1, e2 = exponents[0], exponents[1]
    limit = 0.5 * e1 * log_g
    # Cheap test first, sufficient for most cells: the axis-aligned box around the rotated cell.
    around = log_gauge(x + reach[0], y + reach[1], z + reach[2], axes, e1, e2)
    return around <= limit or _holds_corners(center, half, body, limit)


@kernel
def _holds_corners(center, half, body, limit):
    _, r, axes, exponents = body
    for corner in range(8):
        dx = half if corner & 1 else -half
        dy = half if corner & 2 else -half
        dz = half if corner & 4 else -half
        x = abs(center[0] + r[0] * dx + r[3] * dy + r[6] * dz)
        y = abs(center[1] + r[1] * dx + r[4] * dy + r[7] * dz)
        z = abs(center[2] + r[2] * dx + r[5] * dy + r[8] * dz)
        if log_gauge(x, y, z, axes, exponents[0], exponents[1]) > limit:
            return False
    return True


# Collision checks treat a primitive as solid up to this value of G.
_G = 1.0


def certified_again(shape: ObjectShape, mesh: Mesh, points_world: NDArray[np.floating]) -> Certificate:
    """Return the certificate of a stored layer 4, checked again from mesh, points (N, 3) and primitives.

    Raises:
        ValueError: the margin is negative or not finite, or the mesh has no surface.
    """
    margin_m = shape.containment.margin_m
    if not 0 <= margin_m < np.inf:
        raise ValueError(f"a margin of {margin_m} m")
    vertices = apply(shape.world_from_object, mesh.vertices.astype(np.float64))
    is_used, faces = used_surface(vertices, mesh.faces)
    if len(faces) == 0:
        raise ValueError("a mesh without a surface")
    vertices = vertices[is_used]
    inside = inside_of(vertices, faces, r_safe_m=margin_m)
    points = np.ascontiguousarray(points_world, dtype=np.float64)
    return certify(shape.inflated, vertices, faces, points, inside, r_safe_m=margin_m, g=_G)
