"""Heaps without physics: each thing drops onto a height map and tips about its contacts until it rests."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.worlds.object_models import Model, model_triangles
from tools.worlds.clutter.draws import about_x, about_y, about_z, chance

_CELLS = 96
_SAMPLES = 400
_TRIES, _TIPS = 4, 8
_TIP_RAD = 0.1
_CONTACT_M = 0.004


def heap(
    rng: np.random.Generator, models: Sequence[Model], half_m: tuple[float, float]
) -> list[tuple[Model, NDArray[np.float64]]]:
    """Return models with poses in the frame of a horizontal surface, within about `half_m` of its centre."""
    ground = _Ground(half_m, max(float(np.linalg.norm(m.bounds_m()[1] - m.bounds_m()[0])) for m in models))
    placed = []
    for model in models:
        points = _samples(model, rng)
        best: tuple[float, NDArray[np.float64], NDArray[np.float64]] | None = None
        for _ in range(_TRIES):
            turned = _tossed(rng)
            at = np.array([*rng.uniform(-1, 1, size=2) * half_m])
            pose, rest = _settled(turned, at, points, ground)
            if best is None or rest[:, 2].mean() < best[0]:
                best = (float(rest[:, 2].mean()), pose, rest)
        assert best is not None
        ground.pile(best[2])
        placed.append((model, best[1]))
    return placed


def _tossed(rng: np.random.Generator) -> NDArray[np.float64]:
    side = about_x(np.pi / 2 * int(rng.integers(4))) @ about_y(np.pi / 2 * int(rng.integers(4)))
    if chance(rng, 0.3):
        side = about_x(float(rng.normal(0, 0.3))) @ side
    return np.asarray(about_z(float(rng.uniform(0, 2 * np.pi))) @ side)


def _samples(model: Model, rng: np.random.Generator) -> NDArray[np.float64]:
    vertices, faces = model_triangles(model)
    corners = vertices[faces].astype(np.float64)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen = corners[rng.choice(len(faces), size=_SAMPLES, p=areas / areas.sum())]
    u, v = rng.random((2, _SAMPLES, 1))
    fold = u + v > 1
    u, v = np.where(fold, 1 - u, u), np.where(fold, 1 - v, v)
    on = chosen[:, 0] + u * (chosen[:, 1] - chosen[:, 0]) + v * (chosen[:, 2] - chosen[:, 0])
    some = vertices[:: max(1, len(vertices) // 150)].astype(np.float64)
    points = np.concatenate([on, some])
    return points


class _Ground:
    def __init__(self, half_m: tuple[float, float], largest_m: float) -> None:
        self._reach = max(half_m) + largest_m
        self._cell = 2 * self._reach / _CELLS
        self._height = np.zeros((_CELLS, _CELLS))

    def under(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        i, j = self._cells(points)
        return np.asarray(self._height[i, j])

    def pile(self, points: NDArray[np.float64]) -> None:
        i, j = self._cells(points)
        np.maximum.at(self._height, (i, j), points[:, 2])

    def _cells(self, points: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        cells = np.clip(((points[:, :2] + self._reach) / self._cell).astype(np.intp), 0, _CELLS - 1)
        return cells[:, 0], cells[:, 1]


def _settled(
    rotation: NDArray[np.float64], at: NDArray[np.float64], points: NDArray[np.float64], ground: _Ground
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    middle = points.mean(axis=0)
    for tip in range(_TIPS):
        turned = (points - middle) @ rotation.T + [*at, 0.0]
        gap = turned[:, 2] - ground.under(turned)
        drop = float(gap.min())
        touching = turned[gap < drop + _CONTACT_M, :2] - at
        lean = _lean(touching)
        if lean is None or tip == _TIPS - 1:
            break
        # Tip towards the unsupported side, about the horizontal axis across that direction.
        axis = np.array([-lean[1], lean[0], 0.0])
        rotation = _about(axis, _TIP_RAD) @ rotation
    rest = turned - [0.0, 0.0, drop - 0.0005]
    translation = np.array([*at, 0.0005 - drop]) - rotation @ middle
    return from_rotation_translation(rotation, translation), rest


def _lean(touching: NDArray[np.float64]) -> NDArray[np.float64] | None:
    # The direction in which a thing with contacts (K, 2) about its centre tips; None where they surround the centre.
    reach = np.linalg.norm(touching, axis=1)
    mean = touching.mean(axis=0)
    size = float(np.linalg.norm(mean))
    if size < 1e-3:
        return None
    towards = -mean / size
    if float((touching @ towards).max()) > 0.15 * float(reach.max()):
        return None
    return np.asarray(towards)


def _about(axis: NDArray[np.float64], angle_rad: float) -> NDArray[np.float64]:
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle_rad) * cross + (1 - np.cos(angle_rad)) * cross @ cross)
