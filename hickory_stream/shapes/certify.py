"""The certificate of layer 4: does it contain the object and its margin? Checked from the result alone.

Every triangle, bisected as needed, and every point of layer 1 must lie in one primitive with a ball of the margin's
radius: since primitives are convex, the balls around three corners suffice. Every cell of the interior, split as
needed, must lie in one primitive, unless all of it is within the margin of the surface.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry import portable
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.portable_kernels import exp, log
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.superquadric import Superquadrics
from hickory_stream.records import ObjectShape
from hickory_stream.shapes.inflate.cover import NET, NET_FACTOR, log_gauge, log_gauge_of_ball, place_of, put
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
    bodies = _bodies(primitives)
    log_g = float(log(g)) - NUMERICAL_MARGIN
    pieces, uncovered, worst = _triangles(vertices_world, faces, bodies, r_safe_m, log_g)
    out_points, worst_point = _balls(points_world, bodies, r_safe_m, log_g, NET, NET_FACTOR)
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
    row_ends, bodies = inside.row_ends, _bodies(primitives)
    # Per axis of a primitive, the reach of a cell of half a side of 1.
    turned = np.abs(primitives.world_from_local[:, :3, :3])
    reach = turned[:, 0] + turned[:, 1] + turned[:, 2]
    for level in range(_CELL_LEVELS):
        are_out = np.ones(len(left), bool)
        _drop_covered(left, row_ends, half, bodies, half * reach, log_g, are_out)
        left = left[are_out]
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


def _bodies(primitives: Superquadrics) -> NDArray[np.float64]:
    # (K, 17) centres, rotations, semi-axes and exponents.
    poses = primitives.world_from_local
    parts = (poses[:, :3, 3], poses[:, :3, :3].reshape(-1, 9), primitives.semi_axes_m, primitives.exponents)
    return np.concatenate(parts, axis=1)


def _triangles(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], bodies: NDArray[np.float64], radius: float, log_g: float
) -> tuple[int, int, float]:
    # The pieces, the uncovered triangles, and the largest ln G of a covered one.
    bounds = np.full((len(bodies), len(vertices)), np.inf)
    for body, own in zip(bodies, bounds, strict=True):
        local = np.abs(portable.matmul(vertices - body[:3], body[3:12].reshape(3, 3)))
        order, stairs = np.argsort(-local[:, 0], kind="stable"), np.empty((len(vertices), 3))
        _fill_bounds(local, order, stairs, body, radius, log_g, NET, NET_FACTOR, own)
    # Most triangles are covered as they are.
    a, b, c = (bounds[:, faces[:, i]] for i in range(3))
    best = np.maximum(np.maximum(a, b), c).min(axis=0)
    is_in = best < np.inf
    corners = np.concatenate([vertices, bounds.T], axis=1)
    stack = np.empty((_MAX_BISECTIONS + 2, 3, corners.shape[1]))
    depths = np.zeros(len(stack), np.int64)
    left = faces[~is_in].astype(np.int64)
    pieces, uncovered, worst = _bisect(corners, left, stack, depths, bodies, radius, log_g, NET, NET_FACTOR)
    return pieces + int(is_in.sum()), uncovered, max(worst, float(best[is_in].max(initial=-700.0)))


@kernel(error_model="numpy")
def _local_ball_in(x, y, z, body, radius, log_g, net, factor):
    # An upper bound of ln G over a ball around a local point >= 0; infinity if the ball may protrude.
    a, b, c, e1, e2 = body[12], body[13], body[14], body[15], body[16]
    if x + radius > a or y + radius > b or z + radius > c:
        return np.inf
    limit = 0.5 * e1 * log_g
    value = log_gauge_of_ball(x, y, z, radius, a, b, c, e1, e2, limit, net, factor)
    return 2.0 / e1 * value if value <= limit else np.inf


@kernel
def _ball_in(x, y, z, body, radius, log_g, net, factor):
    # The same around a point in the world.
    dx, dy, dz = x - body[0], y - body[1], z - body[2]
    x = abs(body[3] * dx + body[6] * dy + body[9] * dz)
    y = abs(body[4] * dx + body[7] * dy + body[10] * dz)
    z = abs(body[5] * dx + body[8] * dy + body[11] * dz)
    return _local_ball_in(x, y, z, body, radius, log_g, net, factor)


@kernel
def _fill_bounds(local, order, stairs, body, radius, log_g, net, factor, out):
    # (N,) bounds as `_local_ball_in`; a dominated point has the bound of the one that dominates it.
    count = np.int64(0)
    for n in order:
        x, y, z = local[n, 0], local[n, 1], local[n, 2]
        at = place_of(stairs, count, y)
        if at < count and stairs[at, 1] >= z:
            out[n] = stairs[at, 2]
            continue
        out[n] = _local_ball_in(x, y, z, body, radius, log_g, net, factor)
        if out[n] < np.inf:
            count = put(stairs, count, at, y, z, out[n])


@kernel(error_model="numpy")
def _balls(points, bodies, radius, log_g, net, factor):
    out, worst, last = 0, -700.0, 0
    for n in range(len(points)):
        best = np.inf
        for i in range(len(bodies)):
            k = (last + i) % len(bodies)
            best = _ball_in(points[n, 0], points[n, 1], points[n, 2], bodies[k], radius, log_g, net, factor)
            if best < np.inf:
                last = k
                break
        if best == np.inf:
            out += 1
        else:
            worst = max(worst, best)
    return out, worst


@kernel(error_model="numpy")
def _bisect(points, faces, stack, depths, bodies, radius, log_g, net, factor):
    # `points` (V, 3 + K): places, and the bounds for the primitives.
    width = points.shape[1]
    pieces, uncovered, worst = 0, 0, -700.0
    for f in range(len(faces)):
        for c in range(3):
            for i in range(width):
                stack[0, c, i] = points[faces[f, c], i]
        size, depths[0] = 1, 0
        while size > 0:
            size -= 1
            best, least_0, least_1, least_2 = np.inf, np.inf, np.inf, np.inf
            for i in range(3, width):
                of_0, of_1, of_2 = stack[size, 0, i], stack[size, 1, i], stack[size, 2, i]
                best = min(best, max(of_0, of_1, of_2))
                least_0, least_1, least_2 = min(least_0, of_0), min(least_1, of_1), min(least_2, of_2)
            if best < np.inf:
                pieces += 1
                worst = max(worst, best)
                continue
            # No bisection helps a corner that lies in no primitive.
            if depths[size] == len(stack) - 2 or max(least_0, least_1, least_2) == np.inf:
                uncovered += 1
                break
            first, most = 0, -1.0
            for c in range(3):
                squared = 0.0
                for i in range(3):
                    squared += (stack[size, c, i] - stack[size, (c + 1) % 3, i]) ** 2
                if squared > most:
                    first, most = c, squared
            second = (first + 1) % 3
            for c in range(3):
                for i in range(width):
                    stack[size + 1, c, i] = stack[size, c, i]
            for i in range(3):
                middle = 0.5 * (stack[size, first, i] + stack[size, second, i])
                stack[size, second, i], stack[size + 1, first, i] = middle, middle
            x, y, z = stack[size, second, 0], stack[size, second, 1], stack[size, second, 2]
            for k in range(len(bodies)):
                bound = _ball_in(x, y, z, bodies[k], radius, log_g, net, factor)
                stack[size, second, 3 + k], stack[size + 1, first, 3 + k] = bound, bound
            depths[size] += 1
            depths[size + 1] = depths[size]
            size += 2
    return pieces, uncovered, worst


@kernel(error_model="numpy")
def _drop_covered(centers, row_ends, half, bodies, reach, log_g, are_out):
    # Primitives are convex: one that contains two cells of a row contains those between them.
    last, n = 0, 0
    while n < len(centers):
        end = n
        for step in range(len(bodies)):
            k = (last + step) % len(bodies)
            if not _holds(centers[n], half, bodies[k], reach[k], log_g):
                continue
            # The farthest cell of the row that it contains too: the last one is tried first.
            middle, beyond = row_ends[n], row_ends[n] + 1
            while beyond - end > 1:
                if _holds(centers[middle], half, bodies[k], reach[k], log_g):
                    end = middle
                else:
                    beyond = middle
                middle = (end + beyond) // 2
            for m in range(n, end + 1):
                are_out[m] = False
            last = k
            break
        n = end + 1


@kernel(error_model="numpy")
def _holds(center, half, body, reach, log_g):
    dx, dy, dz = center[0] - body[0], center[1] - body[1], center[2] - body[2]
    x = body[3] * dx + body[6] * dy + body[9] * dz
    y = body[4] * dx + body[7] * dy + body[10] * dz
    z = body[5] * dx + body[8] * dy + body[11] * dz
    a, b, c, e1, e2 = body[12], body[13], body[14], body[15], body[16]
    if abs(x) > a or abs(y) > b or abs(z) > c:
        return False
    limit = 0.5 * e1 * log_g
    # Cheap test first, sufficient for most cells: the axis-aligned box around the rotated cell; then the corners.
    if log_gauge((abs(x) + reach[0]) / a, (abs(y) + reach[1]) / b, (abs(z) + reach[2]) / c, e1, e2) <= limit:
        return True
    for corner in range(8):
        dx = half if corner & 1 else -half
        dy = half if corner & 2 else -half
        dz = half if corner & 4 else -half
        u = abs(x + body[3] * dx + body[6] * dy + body[9] * dz)
        v = abs(y + body[4] * dx + body[7] * dy + body[10] * dz)
        w = abs(z + body[5] * dx + body[8] * dy + body[11] * dz)
        if log_gauge(u / a, v / b, w / c, e1, e2) > limit:
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
