"""Cloth: draped over a table, hung over a bar, curtains; each is one thin closed sheet."""

import numpy as np
from numpy.typing import NDArray

from hickory_stream.worlds.object_models import Model, Part
from hickory_stream.worlds.textures import Texture
from tools.worlds.clutter.draws import count, uniform
from tools.worlds.clutter.objects.solids import block, cylinder, sheet

_THICK_M = 0.003


def tablecloth(rng: np.random.Generator, half_m: tuple[float, float], fall_m: float, texture: Texture) -> Model:
    """Return a cloth over a level top of a half size, falling down its sides in folds; the top is at z = 0."""
    lines = [_lines(half, fall_m) for half in half_m]
    u, v = np.meshgrid(*lines, indexing="ij")
    out = np.stack([np.maximum(np.abs(u) - half_m[0], 0.0), np.maximum(np.abs(v) - half_m[1], 0.0)])
    down = np.minimum(out.max(axis=0), fall_m)
    waves = uniform(rng, 0.2, 1.0) * 0.12 * down * (1 + np.sin(uniform(rng, 9, 30) * (u + v) + uniform(rng, 0, 6)))
    points = np.empty((*u.shape, 3))
    for axis, at in enumerate((u, v)):
        # Beyond the edge it hangs, away from the side by its folds; at corners both sides stand out.
        flat = np.clip(at, -half_m[axis], half_m[axis])
        points[..., axis] = flat + np.sign(at) * np.minimum(out[axis], 0.006 + waves + 0.35 * out.min(axis=0))
    points[..., 2] = _THICK_M - down
    return Model(kind="tablecloth", parts=(sheet(points, _THICK_M, texture),))


def _lines(half: float, fall: float) -> NDArray[np.float64]:
    side = half + np.concatenate([[0.0], np.linspace(0.004, fall, 9)])
    return np.concatenate([-side[::-1], np.linspace(-half, half, 9)[1:-1], side])


def hung_cloth(rng: np.random.Generator, width_m: float, falls_m: tuple[float, float], texture: Texture) -> Model:
    """Return a cloth folded over a bar along y at z = 0: it falls before (+x) and behind it."""
    along = np.linspace(-width_m / 2, width_m / 2, 17)
    bow = np.linspace(0, np.pi, 7)
    radius = uniform(rng, 0.012, 0.03)
    front = np.linspace(falls_m[0], 0.02, 10)
    back = np.linspace(0.02, falls_m[1], 10)
    x = np.concatenate([np.full(10, radius), radius * np.cos(bow), np.full(10, -radius)])
    z = np.concatenate([-front, radius * np.sin(bow), -back])
    depth = np.concatenate([front, np.zeros(7), back])
    wave = np.sin(uniform(rng, 10, 45) * along + uniform(rng, 0, 6)) + 0.5 * np.sin(uniform(rng, 40, 70) * along)
    points = np.empty((len(x), len(along), 3))
    points[..., 0] = x[:, None] + np.sign(x)[:, None] * np.minimum(depth, 0.3)[:, None] * 0.08 * (1.5 + wave)[None]
    # It narrows a little as it falls.
    points[..., 1] = along[None] * (1.0 - uniform(rng, 0.0, 0.25) * np.minimum(depth, 0.5)[:, None])
    points[..., 2] = z[:, None]
    return Model(kind="hung_cloth", parts=(sheet(points, _THICK_M, texture),))


def curtain(rng: np.random.Generator, size_m: tuple[float, float], texture: Texture) -> Model:
    """Return a curtain of (width, height) in folds, hanging in the plane of y and z, its foot at z = 0."""
    width, height = size_m
    folds, deep = count(rng, 4, 14), uniform(rng, 0.015, 0.06)
    y, z = np.meshgrid(np.linspace(-0.5, 0.5, 8 * folds + 1), np.linspace(0, 1, 6), indexing="ij")
    phase = 2 * np.pi * folds * y + 0.8 * np.sin(5 * y + uniform(rng, 0, 6))
    x = deep * np.sin(phase) * (0.6 + 0.4 * (1 - z))
    points = np.stack([x, y * width, z * height], axis=-1)
    return Model(kind="curtain", parts=(sheet(points, _THICK_M, texture),))


def rail(rng: np.random.Generator, length_m: float, height_m: float, texture: Texture) -> tuple[Part, ...]:
    """Return a bar along y on two posts with feet: what clothes hang on."""
    thick = uniform(rng, 0.008, 0.016)
    parts = [block((2 * thick, length_m, 2 * thick), texture, at=(0, 0, height_m), radius_m=thick * 0.9)]
    for s in (-1, 1):
        parts.append(cylinder(thick, height_m, texture, at=(0, s * length_m / 2, 0), segments=12))
        parts.append(block((0.45, 0.04, 0.03), texture, at=(0, s * length_m / 2, 0.015)))
    return tuple(parts)


def crumpled(rng: np.random.Generator, size: tuple[float, float], height: float, texture: Texture) -> Part:
    """Return a wavy sheet that is flat at its irregular border and up to `height` high within it."""
    grid = 26
    s, t = np.meshgrid(np.linspace(-1, 1, grid), np.linspace(-1, 1, grid), indexing="ij")
    # A square that is pressed towards a disc, its border frayed.
    angle = np.arctan2(t, s)
    fray = 1.0 + 0.12 * np.sin(3 * angle + rng.uniform(0, 6.3)) + 0.08 * np.sin(5 * angle + rng.uniform(0, 6.3))
    waves = np.zeros_like(s)
    for _ in range(7):
        k = rng.normal(0, 4.0, size=2)
        waves += np.abs(np.sin(k[0] * s + k[1] * t + rng.uniform(0, 6.3)))
    window = np.clip((1 - s**4) * (1 - t**4), 0.0, 1.0) ** 0.5
    z = height * window * (0.25 + 0.75 * waves / waves.max())
    points = np.stack([s * fray * size[0] / 2, t * fray * size[1] / 2, z + 0.003], axis=-1)
    return sheet(points, 0.003, texture)
