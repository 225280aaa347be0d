"""The share of the place of a true object that frames see, whether the object is there or not."""

from collections.abc import Sequence

import numpy as np

from hickory_stream.evaluation.match import structure_surfaces, surface_of
from hickory_stream.evaluation.truth import Truth, TruthFrame, TruthObject
from hickory_stream.geometry.camera import project
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.pictures.raycast import Scene

_SAMPLES = 150
_RANGE_M = (0.3, 6.0)
# Something else may stand there by then: it counts as seen, too.
_SLACK_M = 0.2


def scene_of(truth: Truth) -> Scene:
    """Return the true surfaces of a world; raises `RecordingError` where a mesh cannot be read."""
    return Scene([*(surface_of(truth, item) for item in truth.objects), *structure_surfaces(truth)])


def seen_share(truth: Truth, item: TruthObject, frames: Sequence[TruthFrame], scene: Scene) -> float:
    vertices = surface_of(truth, item).vertices
    points = vertices[np.linspace(0, len(vertices) - 1, min(_SAMPLES, len(vertices))).astype(int)].astype(np.float64)
    is_seen = np.zeros(len(points), bool)
    for frame in frames:
        left = np.flatnonzero(~is_seen)
        in_camera = apply(invert(frame.world_from_camera), points[left])
        is_before = (in_camera[:, 2] > _RANGE_M[0]) & (in_camera[:, 2] < _RANGE_M[1])
        left, in_camera = left[is_before], in_camera[is_before]
        uv = project(in_camera, truth.camera)
        left = left[((uv >= 0) & (uv <= (truth.camera.width - 1, truth.camera.height - 1))).all(axis=1)]
        if len(left):
            eye = frame.world_from_camera[:3, 3]
            rays = points[left] - eye
            away_m = np.linalg.norm(rays, axis=1)
            hits = scene.cast(np.tile(eye, (len(left), 1)), rays / away_m[:, None])
            is_seen[left[hits.distance_m > away_m - _SLACK_M]] = True
    return float(is_seen.mean())
