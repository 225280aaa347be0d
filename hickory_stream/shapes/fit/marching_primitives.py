"""Layer 3: Marching-Primitives (Liu et al., 2023), a mesh as a few superquadrics.

Primitives are fitted one by one to a truncated signed distance field, from which the explained volume is removed.
Unlike in the paper, candidates also grow from deep seeds, since thin parts that touch form one component, and a
candidate's score is its increase of the intersection over union, which also stops the fit. All lengths are in cells.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.ranges import Ranged, number
from hickory_stream.geometry import portable
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.portable_kernels import exp_each
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.geometry.superquadric import Superquadrics, canonical, moved, volumes_m3
from hickory_stream.records import FitKind
from hickory_stream.shapes.connected import pieces_of
from hickory_stream.shapes.fit.bounding_superquadric import around_all
from hickory_stream.shapes.fit.canonical_frame import object_axes
from hickory_stream.shapes.fit.envelope import filled
from hickory_stream.shapes.fit.fit_field import FitField
from hickory_stream.shapes.fit.joint import jointly_refined, refined_beside, simplified
from hickory_stream.shapes.fit.panels import panels, sheet_thickness, with_thin_parts
from hickory_stream.shapes.fit.quadric_lm import ROW, row_of
from hickory_stream.shapes.fit.seeds import bounds_along, chessboard_depth, grown_box, principal_axes
from hickory_stream.shapes.mesh_validation import usable
from hickory_stream.shapes.sdf import DistanceGrid, adapted_cells, distance_grid

SEEDS_PER_COMPONENT = 2
# What is thinner than this share of its length is flat, and a primitive is no thinner.
_THINNEST = 1e-3
# Panels are preferred to a body around all of it that takes more than twice their volume.
_MUCH_LESS = 0.5
# Distances are truncated at this many cells.
_BAND_CELLS = 3.0
# The grid is refined if the thinnest part is below this.
_MIN_THICKNESS_CELLS = 3.5
# A primitive is kept if it adds at least this share of the object's volume; volume outside the object is penalised.
_MIN_GAIN = 0.015
_WASTE_WEIGHT = 1.5
# Pairs are merged if that loses at most this share of the volume.
_MERGE_LOSS = 0.02
# Rounds of refinement, and sweeps of the joint refinement in each.
_NUM_ROUNDS = 1
_JOINT_SWEEPS = 15
# Exponents are rounded to simple shapes if the misfit rises by no more than this many cells.
_SIMPLE_TOLERANCE = 0.03
# Numbers of cells, in total and for each primitive, and sweeps of that refinement.
_SIMPLE_SAMPLES = 40_000
_SIMPLE_SAMPLES_EACH = 600
_SIMPLE_SWEEPS = 5
# A fit that explains less than this share of the volume is rejected; one with a smaller intersection over union is
# kept only if the object is neither thin nor hollow.
_MIN_EXPLAINED = 0.5
_MIN_OVERLAP = 0.7
# Parts that reach more than this many cells (at `cells` along the longest side) beyond all primitives get up to this
# many primitives of their own.
_PROTRUDING_CELLS = 3.0
_MAX_PROTRUDING = 4


@dataclass(frozen=True, kw_only=True, slots=True)
class FitConfig(Ranged):
    """The parameters of the fit of superquadrics to a mesh."""

    #: Cells along the longest side, up to twice as many for thin parts.
    cells: int = number(64, 8, 512, "cells")
    #: Boxes are grown in this many of the largest components.
    num_seeds: int = number(3, 1, 100, "components")
    #: Number of the most promising starts that are fitted.
    num_candidates: int = number(4, 1, 100, "candidates")
    #: Maximum number of primitives.
    max_primitives: int = number(12, 1, 1000, "primitives")
    #: Number of cells with which each start is fitted.
    coarse_samples: int = number(200, 1, 1_000_000, "cells")
    #: Iterations of the fit of each start.
    coarse_iterations: int = number(5, 0, 1000, "iterations")
    #: Number of cells with which the best two starts are fitted.
    fine_samples: int = number(800, 1, 1_000_000, "cells")
    #: Iterations of the fit of the best two starts.
    fine_iterations: int = number(8, 0, 1000, "iterations")
    #: Number of cells on which gains are measured.
    gain_samples: int = number(6000, 1, 10_000_000, "cells")
    #: Number of cells with which all primitives are refined jointly.
    joint_samples: int = number(4500, 1, 10_000_000, "cells")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Fitted:
    """Layer 3 of the "solid", of thin "panels" (sheets, rods), or of a hollow thing's "envelope", its cavity filled."""

    primitives: Superquadrics
    kind: FitKind


def fit_superquadrics(mesh: Mesh, config: FitConfig) -> Superquadrics:
    """Return the primitives of `fitted_shape` for any mesh; raises ValueError if it is not `usable`."""
    return fitted_shape(usable(mesh), config).primitives


def fitted_shape(mesh: Mesh, config: FitConfig) -> Fitted:
    """Return the primitives of a `usable` mesh in its own frame, largest first, at least one, and their kind.

    A shape that primitives explain badly on the grid is too thin for it (`panels`), or hollow: then no union of few
    convex bodies, its envelope is fitted. Else one superquadric goes around all of it.
    """
    vertices = mesh.vertices.astype(np.float64)
    # Centred, since precision is lost far from the origin.
    offset = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    vertices = vertices - offset
    axes = object_axes(vertices, mesh.faces)
    found = _fitted(portable.matmul(vertices, axes), mesh.faces, config)
    return Fitted(
        primitives=canonical(moved(found.primitives, from_rotation_translation(axes, offset))), kind=found.kind
    )


def _fitted(vertices: NDArray[np.float64], faces: NDArray[np.int32], config: FitConfig) -> Fitted:
    extent = np.ptp(vertices, axis=0)
    longest = float(extent.max())
    solid, overlap = None, 0.0
    # A flat mesh has no inside, and one thinner than a few thousandths of its length would need too fine a grid.
    if extent.min() > _THINNEST * longest:
        cells = adapted_cells(
            vertices, faces, cells=config.cells, min_thickness_cells=_MIN_THICKNESS_CELLS, max_cells=2 * config.cells
        )
        solid, overlap = marched(distance_grid(vertices, faces, cells=cells, band_cells=_BAND_CELLS), config)
        if solid is not None:
            solid = with_thin_parts(
                solid,
                vertices,
                faces,
                step_m=longest / cells,
                most=config.max_primitives + _MAX_PROTRUDING,
                least_area=_MIN_GAIN,
            )
        # What is thinner than a cell may agree with the grid and yet not with the mesh.
        if solid is not None and overlap >= _MIN_OVERLAP and sheet_thickness(vertices, faces) > longest / cells:
            return Fitted(primitives=solid, kind="solid")
    thin = panels(vertices, faces, most=config.max_primitives, min_size_m=_THINNEST * longest)
    if thin.share >= max(_MIN_OVERLAP, overlap):
        return Fitted(primitives=thin.primitives, kind="panels")
    if solid is not None and overlap >= _MIN_OVERLAP:
        return Fitted(primitives=solid, kind="solid")
    whole = filled(distance_grid(vertices, faces, cells=config.cells, band_cells=_BAND_CELLS))
    if whole is not None:
        envelope, overlap = marched(whole, config)
        if envelope is not None and overlap >= _MIN_OVERLAP:
            return Fitted(primitives=envelope, kind="envelope")
    if solid is not None:
        return Fitted(primitives=solid, kind="solid")
    around = around_all(vertices, faces, _THINNEST * longest)
    if thin.volume_m3 < _MUCH_LESS * float(volumes_m3(around).sum()):
        return Fitted(primitives=thin.primitives, kind="panels")
    return Fitted(primitives=around, kind="envelope")


def marched(grid: DistanceGrid, config: FitConfig) -> tuple[Superquadrics | None, float]:
    """Return the primitives and their intersection over union with the grid's solid; None below half of its volume."""
    field = FitField(grid, _WASTE_WEIGHT)
    rows = marching(field, config)
    if not rows:
        return None, 0.0
    field.cover_with(rows)
    if field.unexplained() > (1 - _MIN_EXPLAINED) * field.volume:
        return None, 0.0
    return _superquadrics(rows, grid), field.overlap()


def marching(field: FitField, config: FitConfig) -> list[NDArray[np.float64]]:
    """Return the rows (`quadric_lm`) of the primitives, in units of cells."""
    rows: list[NDArray[np.float64]] = []
    least = _MIN_GAIN * field.volume
    # The gain of a primitive is at most the unexplained volume.
    while len(rows) < config.max_primitives and field.unexplained() >= least:
        best = best_candidate(field, config)
        if best is None or field.gain(best, config.gain_samples) < least:
            break
        rows.append(best)
        field.consume(best)
    before = rows
    for _ in range(_NUM_ROUNDS):
        before = rows = polished(field, rows, config)
        rows = pruned(field, merged(field, rows, config), config)
    rows = with_protruding(field, rows, config)
    if len(rows) != len(before) or any(row is not other for row, other in zip(rows, before, strict=True)):
        rows = polished(field, rows, config)
    return rows


def polished(field: FitField, rows: list[NDArray[np.float64]], config: FitConfig) -> list[NDArray[np.float64]]:
    """Return the primitives refined jointly, with simple exponents where these fit nearly as well."""
    if not rows:
        return rows
    points, distances = field.samples(config.joint_samples)
    band, longest = field.band, field.max_log_axis
    stacked = jointly_refined(np.stack(rows), points, distances, band=band, sweeps=_JOINT_SWEEPS, max_log_axis=longest)
    stacked = simplified(
        stacked,
        *field.samples(_SIMPLE_SAMPLES),
        per_primitive=_SIMPLE_SAMPLES_EACH,
        sweeps=_SIMPLE_SWEEPS,
        tolerance=_SIMPLE_TOLERANCE,
        band=band,
        max_log_axis=longest,
    )
    return list(
        jointly_refined(stacked, points, distances, band=band, sweeps=4, max_log_axis=longest, with_exponents=False)
    )


def best_candidate(field: FitField, config: FitConfig) -> NDArray[np.float64] | None:
    """Return the primitive with the highest gain on the unexplained volume; None if there is nothing to start from."""
    starts = starting_rows(field, config.num_seeds)
    starts = _best_by_gain(field, starts, config.num_candidates, config.fine_samples)
    return _refined_best(field, starts, config) if starts else None


def _refined_best(field: FitField, starts: list[NDArray[np.float64]], config: FitConfig) -> NDArray[np.float64]:
    coarse = [field.fitted(row, config.coarse_samples, config.coarse_iterations) for row in starts]
    finalists = _best_by_gain(field, coarse, 2, config.fine_samples)
    fine = [field.fitted(row, config.fine_samples, config.fine_iterations) for row in finalists]
    # A grown box lies inside the object: if its fit diverges, the start itself is the better primitive.
    return _best_by_gain(field, fine + finalists + starts[:2], 1, config.gain_samples // 3)[0]


def merged(field: FitField, rows: list[NDArray[np.float64]], config: FitConfig) -> list[NDArray[np.float64]]:
    """Return the primitives, with pairs replaced by one if this loses less than the minimum gain of a primitive."""
    rows = list(rows)
    i = 0
    while i < len(rows):
        for j in range(i + 1, len(rows)):
            one = _merged_pair(field, rows, (i, j), config)
            if one is not None:
                rows[i] = one
                del rows[j]
                break
        else:
            i += 1
    return rows


def _merged_pair(
    field: FitField, rows: list[NDArray[np.float64]], pair: tuple[int, int], config: FitConfig
) -> NDArray[np.float64] | None:
    i, j = pair
    if not _touch(rows[i], rows[j]):
        return None
    field.cover_with([row for n, row in enumerate(rows) if n not in pair])
    starts = [_enclosing(rows[i], rows[j]), _enclosing(rows[j], rows[i])]
    starts = [row for row in starts if field.gain(row, config.fine_samples) > 0]
    if not starts:
        return None
    fits = [field.fitted(row, config.fine_samples, config.fine_iterations) for row in starts]
    one = _best_by_gain(field, fits, 1, config.gain_samples)[0]
    others = np.array([row for n, row in enumerate(rows) if n not in pair]).reshape(-1, ROW)
    points, distances = field.samples(_SIMPLE_SAMPLES)
    one = refined_beside(
        one,
        others,
        points,
        distances,
        band=field.band,
        steps=_JOINT_SWEEPS,
        max_log_axis=field.max_log_axis,
        max_samples=config.joint_samples // 4,
    )
    gain_of_one = field.gain(one, config.gain_samples)
    gain_of_two = field.gain(rows[i], config.gain_samples)
    field.consume(rows[i])
    gain_of_two += field.gain(rows[j], config.gain_samples)
    return one if gain_of_one >= gain_of_two - _MERGE_LOSS * field.volume else None


def with_protruding(field: FitField, rows: list[NDArray[np.float64]], config: FitConfig) -> list[NDArray[np.float64]]:
    """Return the primitives and more for small parts that protrude far, such as a handle.

    They add little volume, but without them layer 4 would have to grow a large primitive around them.
    """
    rows = list(rows)
    field.cover_with(rows)
    for _ in range(_MAX_PROTRUDING):
        cells = field.protruding_part(_PROTRUDING_CELLS * field.longest_side / config.cells)
        if cells is None:
            break
        best = _refined_best(field, _component_starts(cells), config)
        if field.gain(best, config.gain_samples) <= 0:
            break
        rows.append(best)
        field.consume(best)
    return rows


def pruned(field: FitField, rows: list[NDArray[np.float64]], config: FitConfig) -> list[NDArray[np.float64]]:
    """Return the primitives that add enough to the others; the least useful is dropped first."""
    rows = list(rows)
    while len(rows) > 1:
        gains = []
        for i in range(len(rows)):
            field.cover_with(rows[:i] + rows[i + 1 :])
            gains.append(field.gain(rows[i], config.gain_samples))
        least = int(np.argmin(gains))
        if gains[least] >= _MIN_GAIN * field.volume:
            break
        del rows[least]
    return rows


def starting_rows(field: FitField, num_seeds: int) -> list[NDArray[np.float64]]:
    """Return starts from the largest components of the unexplained volume, and from boxes grown in deep cells."""
    left = field.left
    first_cell, left = _cropped(left)
    labels, sizes, windows = pieces_of(left)
    if len(sizes) == 0:
        return []
    starts = []
    depth = chessboard_depth(left)
    for n in np.argsort(-sizes, kind="stable")[:num_seeds]:
        window = windows[n]
        first = np.array([side.start for side in window]) + first_cell
        mine = labels[window] == n + 1
        starts += _component_starts(np.argwhere(mine) + first)
        depth_here = depth[window] * mine
        for _ in range(SEEDS_PER_COMPONENT):
            seed = np.unravel_index(int(np.argmax(depth_here)), depth_here.shape)
            if depth_here[seed] == 0:
                break
            i, j, k = (int(n) for n in seed + first)
            box = grown_box(field.solid, (i, j, k), 0.8)
            starts += _box_starts(box)
            # The next seed lies outside of this box.
            (a, b, c), (d, e, f) = np.maximum(box[0] - first, 0), np.maximum(box[1] - first + 1, 0)
            depth_here[a:d, b:e, c:f] = 0
    return starts


def _cropped(cells: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    # Padded by one cell.
    first, window = np.zeros(3, np.int64), []
    for axis in range(3):
        others = tuple(other for other in range(3) if other != axis)
        used = np.flatnonzero(cells.any(axis=others))
        if len(used) == 0:
            return first, cells[:0]
        first[axis] = max(int(used[0]) - 1, 0)
        window.append(slice(int(first[axis]), int(used[-1]) + 2))
    return first, np.ascontiguousarray(cells[tuple(window)])


def _best_by_gain(
    field: FitField, rows: list[NDArray[np.float64]], count: int, max_samples: int
) -> list[NDArray[np.float64]]:
    gains = np.array([field.gain(row, max_samples) for row in rows])
    return [rows[i] for i in np.argsort(-gains, kind="stable")[:count]]


# Cyclic orders of the axes: each makes another one the axis of a cylinder.
_ORDERS = ([0, 1, 2], [2, 0, 1], [1, 2, 0])


def _component_starts(cells: NDArray[np.int64]) -> list[NDArray[np.float64]]:
    cells = np.ascontiguousarray(cells[:: len(cells) // 5000 + 1])
    starts = []
    for axes in (np.eye(3), principal_axes(cells)):
        low, high = bounds_along(cells, axes) + np.array([[-0.5], [0.5]])
        center = portable.matmul(axes, (low + high) / 2)
        half = (high - low) / 2
        starts += [row_of((0.6, 0.9), half[order], center, axes[:, order]) for order in _ORDERS]
    return starts


def _box_starts(box: NDArray[np.int64]) -> list[NDArray[np.float64]]:
    half = (box[1] - box[0] + 1) / 2.0
    center = box.mean(axis=0)
    return [row_of((0.4, 0.6), half[order], center, np.eye(3)[:, order]) for order in _ORDERS]


def _touch(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    reach = _reach(a, np.eye(3)) + _reach(b, np.eye(3)) + 1.0
    return bool((np.abs(a[5:8] - b[5:8]) <= reach).all())


def _enclosing(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    # With the orientation and exponents of `a`.
    axes = a[8:17].reshape(3, 3)
    center_a, center_b = portable.matmul(a[5:8], axes), portable.matmul(b[5:8], axes)
    reach_a, reach_b = exp_each(a[2:5]), _reach(b, axes)
    low = np.minimum(center_a - reach_a, center_b - reach_b)
    high = np.maximum(center_a + reach_a, center_b + reach_b)
    return row_of((a[0], a[1]), (high - low) / 2, portable.matmul(axes, (low + high) / 2), axes)


def _reach(row: NDArray[np.float64], axes: NDArray[np.float64]) -> NDArray[np.float64]:
    return portable.matmul(np.abs(portable.matmul(axes.T, row[8:17].reshape(3, 3))), exp_each(row[2:5]))


def _superquadrics(rows: list[NDArray[np.float64]], grid: DistanceGrid) -> Superquadrics:
    stacked = np.stack(rows)
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, :3] = stacked[:, 8:17].reshape(-1, 3, 3)
    poses[:, :3, 3] = grid.origin + grid.step_m * stacked[:, 5:8]
    return Superquadrics(
        exponents=stacked[:, :2], semi_axes_m=portable.exp(stacked[:, 2:5]) * grid.step_m, world_from_local=poses
    )
