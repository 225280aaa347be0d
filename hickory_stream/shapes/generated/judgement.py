"""Whether a placed shape is true: each view is compared with a drawing of the shape as points with their depth.

A pixel agrees, or the shape is missing there, lies behind the measured surface, before it, or beside the object's mask.

How far the unseen rest can be trusted shows on surface that only views other than the generator's saw: the shape, not
yet corrected, lies there or not. The embedded shape made from those first views alone is judged alike.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.base.ranges import Ranged, number
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.voxels import centers_of_keys, keys_of_points
from hickory_stream.ports import Reconstruction, Reconstructor, ShapeInputs
from hickory_stream.shapes.generated.distance_field import even_samples
from hickory_stream.shapes.generated.placement_evidence import (
    Evidence,
    evidence_of,
    noise_of,
    shown_surface_of,
    surface_of,
)

_SAMPLES = 30_000
_AGREES, _MISSING, _BEHIND, _BEFORE, _BESIDE, _OVERLAP = range(6)
_NUM_FATES = 6
# A depth agrees within this share of the object's size.
_TOLERANCE_SHARE = 0.03
# Minimum share of the seen surface that a generated shape explains, and maximum share of what the views would see of
# it in free space.
_MIN_EXPLAINED = 0.67
_MAX_VIOLATED = 0.3
# Minimum overlap of the silhouettes over all views, and in each view that the shape was not made from.
_MIN_SILHOUETTE = 0.6
_MIN_OTHER_SILHOUETTE = 0.5
# The shape ends within this share of its size over or under what it stands on.
_MAX_SUPPORT_GAP = 0.1
# The embedded shape may foretell more of the surface that other views saw by at most this.
_MAX_LESS_FORETOLD = 0.1


@dataclass(frozen=True, kw_only=True, slots=True)
class JudgementConfig(Ranged):
    """When a generated shape takes the place of the embedded one."""

    #: The embedded shape may be worth more by at most this: it does not contain what no view has seen.
    max_less: float = number(0.1, 0, 2, "share")


@dataclass(frozen=True, kw_only=True, slots=True)
class ShapeEvidence:
    """The views' evidence of a shape: shares in 0..1, None where nothing was seen that could say it."""

    #: of the measured surface, agrees
    explained: float
    #: of the shape's surface in view, before the measured surface or beside the mask
    violated: float
    #: the IoU of masks over all views
    silhouette: float
    #: the least of the views that the shape was not made from
    other_silhouette: float | None
    #: from its foot to the support, as a share of its size
    support_gap: float | None

    @property
    def worth(self) -> float:
        """The explained less the violated share, by which two shapes of one object are compared."""
        return self.explained - self.violated


@dataclass(frozen=True, kw_only=True, slots=True)
class Verdict:
    """Whether a shape earned its place; `reason` says by which numbers."""

    is_accepted: bool
    reason: str


def judged(shape: ShapeEvidence) -> Verdict:
    """Return whether a placed shape can be the object that was seen."""
    faults = []
    if shape.explained < _MIN_EXPLAINED:
        faults.append(f"explains {shape.explained:.2f} of the seen surface (at least {_MIN_EXPLAINED:g})")
    if shape.violated > _MAX_VIOLATED:
        faults.append(f"{shape.violated:.2f} of it in free space (at most {_MAX_VIOLATED:g})")
    if shape.silhouette < _MIN_SILHOUETTE:
        faults.append(f"silhouettes overlap by {shape.silhouette:.2f} (at least {_MIN_SILHOUETTE:g})")
    if shape.other_silhouette is not None and shape.other_silhouette < _MIN_OTHER_SILHOUETTE:
        faults.append(f"by {shape.other_silhouette:.2f} in another view (at least {_MIN_OTHER_SILHOUETTE:g})")
    if shape.support_gap is not None and shape.support_gap > _MAX_SUPPORT_GAP:
        faults.append(f"{shape.support_gap:.2f} of its size off its support (at most {_MAX_SUPPORT_GAP:g})")
    if faults:
        return Verdict(is_accepted=False, reason="refused: " + ", ".join(faults))
    return Verdict(is_accepted=True, reason="accepted: " + shape_text(shape))


def replaces(shape: ShapeEvidence, embedded: ShapeEvidence, config: JudgementConfig) -> Verdict:
    """Return whether what was made of an accepted shape takes the place of the embedded one."""
    numbers = f"worth {shape.worth:.2f}, the embedded one {embedded.worth:.2f}"
    if shape.worth < embedded.worth - config.max_less:
        return Verdict(is_accepted=False, reason=f"refused: {numbers}")
    return Verdict(is_accepted=True, reason=f"{shape_text(shape)}; {numbers}")


def shape_text(shape: ShapeEvidence) -> str:
    """Return the numbers of a shape as text."""
    other = "" if shape.other_silhouette is None else f", in another view {shape.other_silhouette:.2f}"
    gap = "" if shape.support_gap is None else f", support gap {shape.support_gap:.2f}"
    shares = f"explains {shape.explained:.2f}, free space {shape.violated:.2f}, silhouettes {shape.silhouette:.2f}"
    return shares + other + gap


def shape_evidence(shape: Reconstruction, inputs: ShapeInputs, num_made_from: int) -> ShapeEvidence | None:
    """Return the views' evidence, None without measured surface; `num_made_from` first views made the shape."""
    evidence = evidence_of(inputs)
    if evidence is None or not len(evidence.depth):
        return None
    samples, _ = even_samples(shape.mesh.vertices, shape.mesh.faces, _SAMPLES)
    world = apply(shape.world_from_object, samples)
    size = float(np.sqrt(np.square(np.ptp(world, axis=0)).sum()))
    tolerance = _TOLERANCE_SHARE * max(size, evidence.size_m) + 2 * evidence.noise_m
    counts = np.array([_view_counts(world, evidence, k, tolerance) for k in range(len(evidence.depth))])
    total = counts.sum(axis=0)
    others = [_silhouette(one) for one in counts[num_made_from:]]
    gap = None
    if np.isfinite(evidence.support_z_m):
        gap = float(abs(np.quantile(world[:, 2], 0.002) - evidence.support_z_m) / max(size, 1e-9))
    measured = total[[_AGREES, _MISSING, _BEHIND, _BEFORE]].sum()
    drawn = total[[_AGREES, _BEHIND, _BEFORE, _BESIDE]].sum()
    return ShapeEvidence(
        explained=float(total[_AGREES] / max(measured, 1)),
        violated=float((total[_BEFORE] + total[_BESIDE]) / max(drawn, 1)),
        silhouette=_silhouette(total),
        other_silhouette=min(others) if others else None,
        support_gap=gap,
    )


def _silhouette(counts: np.ndarray[tuple[int, ...], np.dtype[np.int64]]) -> float:
    return float(counts[_OVERLAP] / max(counts[_OVERLAP] + counts[_MISSING] + counts[_BESIDE], 1))


def _view_counts(
    world: np.ndarray[tuple[int, ...], np.dtype[np.float64]], evidence: Evidence, k: int, tolerance: float
) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    rows, columns = evidence.sizes[k]
    drawn = np.full((rows, columns), np.inf)
    _draw(world, evidence.camera_from_world[k], evidence.intrinsics[k], drawn)
    depth, beside = evidence.depth[k, :rows, :columns], evidence.beside[k, :rows, :columns]
    return np.asarray(_counted(drawn, depth, beside, tolerance))


@kernel
def _draw(points, pose, intrinsics, out):
    # Each point covers the four pixels around its place.
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        depth = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
        if depth <= 0.05:
            continue
        right = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]
        down = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]
        u, v = right / depth * intrinsics[0] + intrinsics[2], down / depth * intrinsics[1] + intrinsics[3]
        column, row = int(np.floor(u)), int(np.floor(v))
        for r in (row, row + 1):
            for c in (column, column + 1):
                if 0 <= r < out.shape[0] and 0 <= c < out.shape[1] and depth < out[r, c]:
                    out[r, c] = depth


@kernel
def _counted(drawn, depth, beside, tolerance):
    # (6,) pixels that agree, miss the shape, have it behind, before, beside; and those of both masks.
    counts = np.zeros(_NUM_FATES, np.int64)
    for r in range(drawn.shape[0]):
        for c in range(drawn.shape[1]):
            is_drawn, measured = drawn[r, c] < np.inf, depth[r, c]
            if beside[r, c] > 0.0:
                # Beside the mask; a nearer surface hides what is behind it.
                if is_drawn and not measured < drawn[r, c] - tolerance:
                    counts[_BESIDE] += 1
                continue
            if not is_drawn:
                counts[_MISSING] += 1
                continue
            counts[_OVERLAP] += 1
            if not measured > 0.0:
                continue
            # At an edge a pixel may be of either side: any of its neighbours may agree.
            least, most = measured, measured
            for i in range(max(r - 1, 0), min(r + 2, drawn.shape[0])):
                for j in range(max(c - 1, 0), min(c + 2, drawn.shape[1])):
                    if depth[i, j] > 0.0:
                        least, most = min(least, depth[i, j]), max(most, depth[i, j])
            if drawn[r, c] < least - tolerance:
                counts[_BEFORE] += 1
            elif drawn[r, c] > most + tolerance:
                counts[_BEHIND] += 1
            else:
                counts[_AGREES] += 1
    return counts


# As shares of what was seen: surface is new so far from that of the first views, and is looked at in such cells.
_NEW, _CELL = 0.03, 0.01
# Fewer cells may be the noise at an edge.
_LEAST_CELLS = 20
_MIN_HALF_EXTENT_M = 0.01


def by_other_views(
    placed: Reconstruction, inputs: ShapeInputs, num_made_from: int, embedded: Reconstructor
) -> Verdict | None:
    """Return whether a placed shape foretold the surface that other views saw as well as the embedded one would have.

    The shape was made from the first `num_made_from` views; None where the others saw nothing new.
    """
    found = newly_seen(inputs, num_made_from)
    if found is None:
        return None
    first, new, size_m = found
    reach_m = _TOLERANCE_SHARE * size_m + 2 * max(noise_of(crop) for crop in inputs.crops)
    ours = _share_at(placed, new, reach_m)
    shown = replace(
        inputs,
        crops=inputs.crops[:num_made_from],
        points_world=first.astype(np.float32),
        colors=np.zeros((len(first), 3), np.uint8),
        box=gravity_aligned_box(first, _MIN_HALF_EXTENT_M),
    )
    other = embedded.reconstruct(shown)
    theirs = _share_at(other, new, reach_m) if isinstance(other, Reconstruction) else 0.0
    text = f"foretold {ours:.2f} of what other views saw first, the embedded one {theirs:.2f}"
    is_trusted = ours >= theirs - _MAX_LESS_FORETOLD
    return Verdict(is_accepted=is_trusted, reason=text if is_trusted else f"refused: {text}")


def newly_seen(
    inputs: ShapeInputs, num_made_from: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], float] | None:
    """Return the surface (N, 3) of the first views, new surface (M, 3) of the others, and the size of all in metres.

    None where the new surface is next to nothing.
    """
    # Of what was shown all, to the edges of masks; what is asked for leaves them out: they may be another thing's.
    shown = np.concatenate([np.empty((0, 3)), *(shown_surface_of(crop) for crop in inputs.crops[:num_made_from])])
    asked = np.concatenate([np.empty((0, 3)), *(surface_of(crop) for crop in inputs.crops[num_made_from:])])
    if not len(shown) or not len(asked):
        return None
    size_m = float(np.sqrt(np.square(np.ptp(np.concatenate([shown, asked]), axis=0)).sum()))
    cell_m = _CELL * size_m
    shown, asked = _cells(shown, cell_m), _cells(asked, cell_m)
    new = asked[scipy.spatial.cKDTree(shown).query(asked)[0] > _NEW * size_m]
    return (shown, new, size_m) if len(new) >= _LEAST_CELLS else None


def _cells(points: NDArray[np.float64], cell_m: float) -> NDArray[np.float64]:
    return centers_of_keys(np.unique(keys_of_points(points, cell_m)), cell_m).astype(np.float64)


def _share_at(shape: Reconstruction, points: NDArray[np.float64], reach_m: float) -> float:
    samples, _ = even_samples(shape.mesh.vertices, shape.mesh.faces, _SAMPLES)
    return float((scipy.spatial.cKDTree(apply(shape.world_from_object, samples)).query(points)[0] <= reach_m).mean())
