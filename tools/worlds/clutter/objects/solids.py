"""Watertight parts that random shapes are composed of, their faces counter-clockwise seen from outside."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.worlds.object_models import Model, Part, Surface, lathe, rounded_box
from hickory_stream.worlds.textures import Texture

_GREY = Texture(pattern="plain", first=(0.5, 0.5, 0.5), second=(0.5, 0.5, 0.5))


def block(
    size_m: Sequence[float] | NDArray[Any], texture: Texture, *, at: Sequence[float] | NDArray[Any] = (0.0, 0.0, 0.0),
    radius_m: float = 0.004, rotation: NDArray[Any] | None = None,
) -> Part:  # fmt: skip
    """Return a box with rounded edges, centred at `at`, without the cells that `rounded_box` divides its sides into."""
    sign, outward, faces = _block_template()
    half = np.asarray(size_m, dtype=np.float64) / 2
    radius = min(radius_m, 0.49 * float(half.min()))
    return Part(vertices=sign * (half - radius) + radius * outward, faces=faces, texture=texture).moved(at, rotation)


@cache
def _block_template() -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]]:
    # For each vertex of a rounded box its corner, its direction from there, and faces.
    radius = 0.25
    part = rounded_box((2.0, 2.0, 2.0), _GREY, radius_m=radius, cell_m=10.0)
    sign = np.sign(part.vertices)
    return sign, (part.vertices - sign * (1.0 - radius)) / radius, part.faces


def cylinder(
    radius_m: float, height_m: float, texture: Texture, *, top_radius_m: float | None = None,
    at: Sequence[float] = (0.0, 0.0, 0.0), segments: int = 32,
) -> Part:  # fmt: skip
    """Return a standing cylinder or a blunt cone with its base at `at`; few segments give a prism."""
    top = radius_m if top_radius_m is None else max(top_radius_m, 1e-4)
    return lathe([(0, 0), (radius_m, 0), (top, height_m), (0, height_m)], texture, segments=segments).moved(at)


def torus(
    ring_m: float, bar_m: float, texture: Texture, *, flat: float = 1.0, segments: tuple[int, int] = (36, 14)
) -> Part:
    """Return a ring about z, its middle at the origin; `flat` scales the bar's height."""
    around = 2 * np.pi * np.arange(segments[0]) / segments[0]
    section = 2 * np.pi * np.arange(segments[1]) / segments[1]
    reach = ring_m + bar_m * np.cos(section)
    vertices = np.empty((*segments, 3))
    vertices[..., 0] = np.cos(around)[:, None] * reach[None]
    vertices[..., 1] = np.sin(around)[:, None] * reach[None]
    vertices[..., 2] = (flat * bar_m * np.sin(section))[None]
    index = np.arange(vertices.shape[0] * vertices.shape[1], dtype=np.int32).reshape(segments)
    a, b = index, np.roll(index, -1, axis=0)
    c, d = np.roll(b, -1, axis=1), np.roll(index, -1, axis=1)
    return Part(vertices=vertices.reshape(-1, 3), faces=_quads(a, b, c, d), texture=texture)


def superellipsoid(
    semi_axes_m: Sequence[float] | NDArray[Any], exponents: tuple[float, float], texture: Texture, *, rings: int = 21,
    around: int = 40,
) -> Part:  # fmt: skip
    """Return a superellipsoid about the origin: exponents 0.1 is a box, 1 an ellipsoid, 2 a double pyramid."""
    polar = np.linspace(-np.pi / 2, np.pi / 2, rings)
    turn = 2 * np.pi * np.arange(around) / around
    flat, high = _signed_power(np.cos(polar), exponents[0]), _signed_power(np.sin(polar), exponents[0])
    unit = lathe([(float(r), float(z)) for r, z in zip(flat, high, strict=True)], texture, segments=around)
    vertices = unit.vertices.copy()
    side = np.stack([_signed_power(np.cos(turn), exponents[1]), _signed_power(np.sin(turn), exponents[1])], axis=1)
    sides = vertices[:-2].reshape(rings - 2, around, 3)
    sides[..., :2] = flat[1:-1, None, None] * side[None]
    return Part(vertices=vertices * np.asarray(semi_axes_m), faces=unit.faces, texture=texture)


def _signed_power(values: NDArray[np.float64], exponent: float) -> NDArray[np.float64]:
    return np.asarray(np.sign(values) * np.abs(values) ** exponent)


def prism(outline_m: NDArray[np.float64], height_m: float, texture: Texture) -> Part:
    """Return a standing prism over a (K, 2) outline, counter-clockwise and star-shaped about its centre."""
    return sweep(outline_m, [(0.0, 0.0, 0.0), (0.0, 0.0, height_m)], texture)


def sweep(
    outline_m: NDArray[np.float64], path_m: Sequence[Sequence[float]] | NDArray[np.float64], texture: Texture, *,
    scale: Sequence[float] | None = None,
) -> Part:  # fmt: skip
    """Return a (K, 2) outline drawn along a path, `scale` wide at each point, both ends closed."""
    # The outline is counter-clockwise; its frame is carried along the path without twist.
    path = np.asarray(path_m, dtype=np.float64)
    tangents = np.gradient(path, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    side = np.cross(np.eye(3)[int(np.argmin(np.abs(tangents[0])))], tangents[0])
    rings = []
    factors = np.ones(len(path)) if scale is None else np.asarray(scale, dtype=np.float64)
    for point, tangent, factor in zip(path, tangents, factors, strict=True):
        side = side - (side @ tangent) * tangent
        side /= np.linalg.norm(side)
        up = np.cross(tangent, side)
        rings.append(point + factor * (outline_m[:, :1] * side + outline_m[:, 1:] * up))
    around = len(outline_m)
    poles = [rings[0].mean(axis=0)[None], rings[-1].mean(axis=0)[None]]
    closed = lathe([(0, 0), *[(1.0, 1.0)] * len(rings), (0, 0)], texture, segments=around)
    return Part(vertices=np.concatenate([*rings, *poles]), faces=closed.faces, texture=texture)


def sheet(points_m: NDArray[np.float64], thickness_m: float, texture: Texture) -> Part:
    """Return a thin closed sheet over an (N, M, 3) grid; it thickens away from the normal: first axis cross second."""
    rows, columns = points_m.shape[:2]
    along, across = np.gradient(points_m, axis=0), np.gradient(points_m, axis=1)
    normals = np.cross(along, across)
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-12)
    vertices = np.concatenate([points_m.reshape(-1, 3), (points_m - thickness_m * normals).reshape(-1, 3)])
    index = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    over = _quads(index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    under = over[:, ::-1] + np.int32(rows * columns)
    rim = np.concatenate([index[:-1, 0], index[-1, :-1], index[:0:-1, -1], index[0, :0:-1]])
    following = np.roll(rim, -1)
    walls = _quads(rim, rim + rows * columns, following + rows * columns, following)
    return Part(vertices=vertices, faces=np.concatenate([over, under, walls]).astype(np.int32), texture=texture)


def _quads(*corners: NDArray[np.int32]) -> NDArray[np.int32]:
    a, b, c, d = (corner.ravel() for corner in corners)
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]).astype(np.int32)


def rough(part: Part, rng: np.random.Generator, depth_m: float, period_m: float) -> Part:
    """Return a part with smooth bumps and dents of up to about `depth_m` and a wavelength of `period_m`."""
    vertices = part.vertices
    moved = np.zeros_like(vertices)
    for _ in range(4):
        wave = rng.standard_normal(3) / period_m * 2.0
        moved += np.sin(vertices @ wave + rng.uniform(0, 6.3))[:, None] * rng.standard_normal(3)
    return Part(vertices=vertices + depth_m * 0.4 * moved, faces=part.faces, texture=part.texture)


def warped(part: Part, by: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Part:
    """Return a part with its (V, 3) vertices mapped by a continuous map without folds."""
    return Part(vertices=by(part.vertices), faces=part.faces, texture=part.texture)


def stretched(model: Model, factors: Sequence[float]) -> Model:
    """Return a model scaled about its origin by positive factors along x, y and z."""
    f = np.asarray(factors, dtype=np.float64)
    parts = tuple(Part(vertices=p.vertices * f, faces=p.faces, texture=p.texture) for p in model.parts)
    surfaces = tuple(
        replace(
            s,
            center_m=(s.center_m[0] * f[0], s.center_m[1] * f[1], s.center_m[2] * f[2]),
            half_m=(s.half_m[0] * f[0], s.half_m[1] * f[1]),
            headroom_m=s.headroom_m * f[2],
        )
        for s in model.surfaces
    )
    return replace(model, parts=parts, surfaces=surfaces)


def grounded(kind: str, parts: Sequence[Part]) -> Model:
    """Return parts as a model whose base is centred at the origin."""
    vertices = np.concatenate([part.vertices for part in parts])
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    by = (-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2])
    return Model(kind=kind, parts=tuple(part.moved(by) for part in parts))


def open_box(kind: str, size: tuple[float, float, float], wall: float, texture: Texture, lean: float = 0.0) -> Model:
    """Return a floor with four walls, which lean outwards; the floor inside is a surface."""
    x, y, z = size
    parts = [block((x, y, wall), texture, at=(0, 0, wall / 2), radius_m=0.001)]
    for sign in (-1, 1):
        parts.append(block((wall, y, z), texture, at=(sign * (x - wall) / 2, 0, z / 2), radius_m=0.001))
        parts.append(block((x, wall, z), texture, at=(0, sign * (y - wall) / 2, z / 2), radius_m=0.001))

    def leaning(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(vertices * (1, 1, 1) + vertices * (1, 1, 0) * lean * vertices[:, 2:] / z)

    floor = Surface(center_m=(0.0, 0.0, wall), half_m=(x / 2 - wall - 0.005, y / 2 - wall - 0.005), headroom_m=3 * z)
    return Model(kind=kind, parts=tuple(warped(part, leaning) for part in parts), surfaces=(floor,))


def regular(corners: int, radius: float) -> NDArray[np.float64]:
    """Return a regular (K, 2) outline, counter-clockwise."""
    turn = 2 * np.pi * (np.arange(corners) + 0.5) / corners
    return np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1)
