"""The thirteen test meshes of the shapes, and two hollow ones: made with trimesh, in metres, standing on z = 0."""

from functools import cache
from typing import Any

import numpy as np
import trimesh


def _box(size: tuple[float, float, float], middle: tuple[float, float, float]) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(size)
    mesh.apply_translation(middle)
    return mesh


def _upright(mesh: trimesh.Trimesh, bottom: float) -> trimesh.Trimesh:
    mesh.apply_translation([0, 0, bottom - mesh.bounds[0, 2]])
    return mesh


def _torus(major: float, minor: float) -> trimesh.Trimesh:
    return trimesh.creation.torus(major, minor, major_sections=48, minor_sections=24)


def _handle(x: float, z: float) -> trimesh.Trimesh:
    handle = _torus(0.032, 0.007)
    handle.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    handle.apply_translation([x, 0, z])
    return handle


def _organic() -> trimesh.Trimesh:
    from skimage.measure import marching_cubes

    axis = np.linspace(-0.4, 0.4, 81)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    field = np.zeros_like(x)
    for center, radii in (
        ((0, 0, -0.1), (0.2, 0.16, 0.14)),
        ((0.08, 0, 0.1), (0.1, 0.1, 0.13)),
        ((-0.16, 0.05, 0), (0.1, 0.08, 0.08)),
    ):
        squared = sum(((c - m) / r) ** 2 for c, m, r in zip((x, y, z), center, radii, strict=True))
        field += np.exp(-squared)
    vertices, faces, _, _ = marching_cubes(field, np.exp(-1.0), spacing=(0.01,) * 3, gradient_direction="ascent")
    return trimesh.Trimesh(vertices - 0.4, faces)


@cache
def test_mesh(name: str) -> trimesh.Trimesh:
    """Return one of the thirteen meshes, standing on z = 0; those of several parts overlap, as modelled objects do."""
    cylinder, creation = trimesh.creation.cylinder, trimesh.creation
    joined, legs = trimesh.util.concatenate, [(x, y) for x in (-1, 1) for y in (-1, 1)]
    makers: dict[str, Any] = {
        "box": lambda: creation.box((0.5, 0.35, 0.3)),
        "cylinder": lambda: cylinder(radius=0.15, height=0.45, sections=48),
        "sphere": lambda: creation.icosphere(subdivisions=4, radius=0.15),
        "capsule": lambda: creation.capsule(height=0.3, radius=0.1, count=(32, 32)),
        "torus": lambda: _torus(0.2, 0.06),
        "ellipsoid": lambda: creation.icosphere(subdivisions=4).apply_scale((0.3, 0.2, 0.12)),
        "bottle": lambda: joined(
            [
                cylinder(radius=0.04, segment=[[0, 0, 0], [0, 0, 0.16]], sections=48),
                creation.cone(radius=0.04, height=0.08, sections=48).apply_translation([0, 0, 0.16]),
                cylinder(radius=0.014, segment=[[0, 0, 0.16], [0, 0, 0.26]], sections=48),
            ]
        ),
        "mug": lambda: joined(
            [cylinder(radius=0.04, segment=[[0, 0, 0], [0, 0, 0.1]], sections=48), _handle(0.036, 0.05)]
        ),
        "chair": lambda: joined(
            [_box((0.04, 0.04, 0.45), (0.2 * x, 0.2 * y, 0.225)) for x, y in legs]
            + [_box((0.45, 0.45, 0.04), (0, 0, 0.45)), _box((0.04, 0.45, 0.45), (-0.205, 0, 0.68))]
        ),
        "table": lambda: joined(
            [_box((0.05, 0.05, 0.71), (0.54 * x, 0.34 * y, 0.355)) for x, y in legs]
            + [_box((1.2, 0.8, 0.04), (0, 0, 0.73))]
        ),
        "shelf": lambda: joined([_box((0.6, 0.3, 0.03), (0, 0, 0.015)), _box((0.6, 0.03, 0.4), (0, -0.135, 0.2))]),
        "monitor": lambda: joined(
            [
                _box((0.55, 0.04, 0.33), (0, 0, 0.32)),
                _box((0.06, 0.04, 0.2), (0, 0, 0.1)),
                _box((0.24, 0.18, 0.02), (0, 0, 0.01)),
            ]
        ),
        "organic": _organic,
    }
    return _upright(makers[name](), 0.0)


test_mesh.__test__ = False  # type: ignore[attr-defined]

MESH_NAMES = tuple("box cylinder sphere capsule torus ellipsoid bottle mug chair table shelf monitor organic".split())


@cache
def hollow_mesh(name: str) -> trimesh.Trimesh:
    """Return the hollow mug or the bowl: what convex primitives cannot be expected to explain."""
    if name == "hollow mug":
        ring = trimesh.creation.annulus(r_min=0.035, r_max=0.04, height=0.1, sections=48)
        bottom = trimesh.creation.cylinder(radius=0.04, height=0.006, sections=48)
        bottom.apply_translation([0, 0, -0.047])
        return _upright(trimesh.util.concatenate([ring, bottom, _handle(0.036, 0.0)]), 0.0)
    outline = [(np.cos(a), np.sin(a)) for a in np.linspace(-np.pi / 2, 0, 16)]
    outer = [(0.12 * c, 0.12 * s) for c, s in outline]
    inner = [(0.112 * c, 0.112 * s) for c, s in reversed(outline)]
    return _upright(trimesh.creation.revolve(np.array(outer + inner), sections=48), 0.0)
