"""Layer 2 from the best view alone, in place of a network: completed by the support plane and mirror symmetry.

A mirrored view is a view of a mirrored camera, so that it is fused like any other (`fused`).
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.ranges import Ranged
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.rigid import apply, compose, invert
from hickory_stream.ports import Crop, NoShape, Reconstruction, ShapeInputs
from hickory_stream.shapes.reconstruct.fused import (
    VolumeConfig,
    moved_views,
    noise_m,
    reconstruct_views,
    seen_points,
    view_of,
)
from hickory_stream.shapes.reconstruct.symmetry import GROWTH_PENALTY, SymmetryConfig, mirror_plane
from hickory_stream.shapes.reconstruct.tsdf import DepthView

_MIN_POINTS = 20
# Weight of a mirrored view relative to the view itself.
_MIRROR_TRUST = 0.2
# Minimum score of a second plane.
_MIN_SECOND_SCORE = 0.25


@dataclass(frozen=True, kw_only=True, slots=True)
class SingleViewConfig(Ranged):
    """How one view is completed."""

    #: The grid.
    volume: VolumeConfig = field(default_factory=VolumeConfig)
    #: How mirror planes are searched.
    symmetry: SymmetryConfig = field(default_factory=SymmetryConfig)


class SingleViewReconstructor:
    """Completes the best view."""

    name = "single_view"

    def __init__(self, config: SingleViewConfig) -> None:
        self._config = config

    def reconstruct(self, inputs: ShapeInputs) -> Reconstruction | NoShape:
        """Return the closed mesh that the best view suggests, or why there is none."""
        if not inputs.crops:
            return NoShape(reason="no view is kept")
        crop, config = inputs.crops[0], self._config
        points, colors = seen_points(crop, view_of(crop).law)
        if len(points) < _MIN_POINTS:
            return NoShape(reason=f"{len(points)} pixels with depth; a surface needs at least {_MIN_POINTS}")
        views = with_mirrored(crop, points, config)
        around = np.concatenate(
            [apply(compose(invert(v.camera_from_world), views[0].camera_from_world), points) for v in views]
        )
        alone = ShapeInputs(
            crops=(crop,),
            points_world=points.astype(np.float32),
            colors=colors,
            box=gravity_aligned_box(around, 2 * config.volume.min_voxel_m),
            support_z_m=inputs.support_z_m,
        )
        return reconstruct_views(alone, views, config.volume)


def with_mirrored(crop: Crop, points: NDArray[np.float64], config: SingleViewConfig) -> list[DepthView]:
    """Return the view of a crop and its mirror images: about the best plane, then about the best one for both."""
    view = view_of(crop)
    views = [view]
    seen = points
    tolerance = noise_m(points, view, config.volume)
    # Any first plane is better than an open back; a second plane must have enough evidence.
    for min_score in (-GROWTH_PENALTY - 0.2, _MIN_SECOND_SCORE):
        reflection = mirror_plane(seen, [view], tolerance, min_score, config.symmetry)
        if reflection is None:
            break
        views += moved_views(views, reflection, _MIRROR_TRUST)
        seen = np.concatenate([seen, apply(reflection, seen)])
    return views
