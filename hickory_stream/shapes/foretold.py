"""What a generated shape said of surface that it was not shown, checked by the views that it was not made from.

What is joined with the measured surface agrees with it, whoever made the rest. How far the rest can be trusted is told
by surface that other views saw and the generator's own did not: the shape, placed but not corrected, lies there or not.
The embedded shape is asked the same: made from those first views alone. No view, no answer.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.voxels import centers_of_keys, keys_of_points
from hickory_stream.ports import Reconstruction
from hickory_stream.shapes.distance_field import even_samples
from hickory_stream.shapes.judgement import JudgementConfig, Verdict
from hickory_stream.shapes.placement_evidence import noise_of, shown_surface_of, surface_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.ports import Reconstructor, ShapeInputs

_SAMPLES = 30_000
# As shares of what was seen: surface is new so far from that of the first views, and is looked at in such cells.
_NEW, _CELL = 0.03, 0.01
# Fewer cells may be the noise at an edge.
_LEAST_CELLS = 20
_MIN_HALF_EXTENT_M = 0.01


def by_other_views(
    placed: Reconstruction, inputs: ShapeInputs, num_made_from: int, embedded: Reconstructor, config: JudgementConfig
) -> Verdict | None:
    """Return whether a placed shape foretold the surface that other views saw as well as the embedded one would have.

    The shape was made from the first `num_made_from` views; None where the others saw nothing new.
    """
    found = newly_seen(inputs, num_made_from)
    if found is None:
        return None
    first, new, size_m = found
    reach_m = config.tolerance_share * size_m + 2 * max(noise_of(crop) for crop in inputs.crops)
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
    told = f"foretold {ours:.2f} of what other views saw first, the embedded one {theirs:.2f}"
    is_trusted = ours >= theirs - config.most_less_foretold
    return Verdict(is_accepted=is_trusted, reason=told if is_trusted else f"refused: {told}")


def newly_seen(
    inputs: ShapeInputs, num_made_from: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], float] | None:
    """Return the surface of the first views, what the others saw beside it, both (N, 3), and the size of all in metres.

    None where that is next to nothing.
    """
    # Of what was shown all, to the edges of masks; what is asked for leaves them out: they may be another thing's.
    shown = np.concatenate([np.empty((0, 3)), *(shown_surface_of(crop) for crop in inputs.crops[:num_made_from])])
    asked = np.concatenate([np.empty((0, 3)), *(surface_of(crop) for crop in inputs.crops[num_made_from:])])
    if not len(shown) or not len(asked):
        return None
    size_m = float(np.sqrt(np.square(np.ptp(np.concatenate([shown, asked]), axis=0)).sum()))
    cell_m = _CELL * size_m
    shown, asked = _cells(shown, cell_m), _cells(asked, cell_m)
    new = asked[cKDTree(shown).query(asked)[0] > _NEW * size_m]
    return (shown, new, size_m) if len(new) >= _LEAST_CELLS else None


def _cells(points: NDArray[np.float64], cell_m: float) -> NDArray[np.float64]:
    """Return the (N, 3) centres of the cells that hold points."""
    return centers_of_keys(np.unique(keys_of_points(points, cell_m)), cell_m).astype(np.float64)


def _share_at(shape: Reconstruction, points: NDArray[np.float64], reach_m: float) -> float:
    samples, _ = even_samples(shape.mesh.vertices, shape.mesh.faces, _SAMPLES)
    return float((cKDTree(apply(shape.world_from_object, samples)).query(points)[0] <= reach_m).mean())
