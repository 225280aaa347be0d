"""Layers 3 and 4 of the true objects of a scene: fitted once, kept in the user's cache by what they were made of."""

from __future__ import annotations

import hashlib
import io
import os
from dataclasses import asdict
from pathlib import Path

import numpy as np

from hickory_stream.base.caches import cache_folder
from hickory_stream.evaluation.truth import Truth, mesh_of
from hickory_stream.geometry.mesh import Mesh, sha256_of
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.superquadric import Superquadrics, moved
from hickory_stream.shapes.fit.marching_primitives import FitConfig, fit_superquadrics
from hickory_stream.shapes.inflate.inflation import InflateConfig, inflated

_ROOT = Path(__file__).resolve().parents[2]
_NO_POINTS = np.empty((0, 3))


def true_inflated(truth: Truth, config: InflateConfig) -> dict[int, Superquadrics]:
    """Return layer 4 of every true object, in the world, by id."""
    return {item.id: _cached(mesh_of(truth, item), item.world_from_object, config) for item in truth.objects}


def _cached(mesh: Mesh, world_from_object: np.ndarray, config: InflateConfig) -> Superquadrics:
    key = hashlib.sha256(f"{sha256_of(mesh)} {world_from_object.tobytes().hex()} {asdict(config)} {_code()}".encode())
    path = cache_folder("true-shapes") / f"{key.hexdigest()}.npz"
    if path.is_file():
        with np.load(path) as kept:
            return Superquadrics(**{name: kept[name] for name in kept.files})
    fitted = moved(fit_superquadrics(mesh, FitConfig()), world_from_object)
    vertices = apply(world_from_object, mesh.vertices.astype(np.float64))
    found = inflated(fitted, vertices, mesh.faces, _NO_POINTS, config).primitives
    data = io.BytesIO()
    np.savez(
        data,
        exponents=found.exponents,
        semi_axes_m=found.semi_axes_m,
        world_from_local=found.world_from_local,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    partial.write_bytes(data.getvalue())
    partial.rename(path)
    return found


def _code() -> str:
    digest = hashlib.sha256()
    for package in ("geometry", "shapes"):
        for path in sorted((_ROOT / "hickory_stream" / package).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()
