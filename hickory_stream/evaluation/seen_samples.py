"""The visible samples of true surfaces: which of them a log shows, from the truth folder alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.evaluation.truth import instances_of
from hickory_stream.geometry.camera import project
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.pictures.raycast import Scene, Surface

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from hickory_stream.evaluation.surface_score import TrueSurface
    from hickory_stream.evaluation.truth import Truth, TruthFrame
    from hickory_stream.geometry.mesh import Mesh

_FRAMES = 120
_RANGE_M = (0.3, 8.0)
_OFF_SURFACE_M = 0.003


def seen_samples(
    truth: Truth, surfaces: Mapping[int, TrueSurface], structure: Sequence[Mesh]
) -> dict[int, NDArray[np.bool_]]:
    """Return for every true object which of its samples some frame shows.

    At most 120 frames, evenly spread over the log, are examined. A sample is seen in a frame if its pixel shows its
    object, its distance is 0.3 to 8 m, and nothing lies between it and the camera.

    Raises:
        RecordingError: an instance image is missing or torn.
    """
    solids = [surface.mesh for surface in surfaces.values()] + list(structure)
    scene = Scene([Surface(vertices=m.vertices, faces=m.faces, colors=m.colors, owner=0) for m in solids])
    seen = {i: np.zeros(len(surface.samples), dtype=bool) for i, surface in surfaces.items()}
    shown = {item.id: set(item.frames) for item in truth.objects}
    last = len(truth.frames) - 1
    for k in sorted({round(place) for place in np.linspace(0, last, _FRAMES).tolist()} if last >= 0 else ()):
        frame = truth.frames[k]
        ids = [i for i in surfaces if frame.index in shown[i] and not seen[i].all()]
        if ids:
            _mark(truth, frame, {i: surfaces[i] for i in ids}, scene, seen)
    return seen


def _mark(
    truth: Truth,
    frame: TruthFrame,
    surfaces: Mapping[int, TrueSurface],
    scene: Scene,
    seen: dict[int, NDArray[np.bool_]],
) -> None:
    instances = instances_of(truth, frame)
    camera_from_world, eye = invert(frame.world_from_camera), frame.world_from_camera[:3, 3]
    for i, surface in surfaces.items():
        open_ = np.flatnonzero(~seen[i])
        points_camera = apply(camera_from_world, surface.samples[open_])
        near = (points_camera[:, 2] > _RANGE_M[0]) & (points_camera[:, 2] < _RANGE_M[1])
        open_, points_camera = open_[near], points_camera[near]
        uv = np.round(project(points_camera, truth.camera)).astype(np.int64)
        inside = (uv >= 0).all(axis=1) & (uv < (truth.camera.width, truth.camera.height)).all(axis=1)
        open_, uv = open_[inside], uv[inside]
        shows = instances[uv[:, 1], uv[:, 0]] == i
        open_ = open_[shows]
        if len(open_) == 0:
            continue
        towards = eye - surface.samples[open_]
        length = np.linalg.norm(towards, axis=1)
        towards = towards / length[:, None]
        # No surface between the camera and the sample; samples that face away are occluded by their own object.
        free_m = scene.distances_m(surface.samples[open_] + _OFF_SURFACE_M * towards, towards)
        seen[i][open_[free_m > length - 2 * _OFF_SURFACE_M]] = True
