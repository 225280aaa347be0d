"""Rays against triangles by Embree, from the wheel `embreex`, or from Open3D where that has none (Linux on ARM).

Their distances differ in the last bits: a recording that must have equal bytes everywhere names its library.
"""

import importlib.util
from dataclasses import dataclass
from typing import Literal, Protocol, assert_never

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.arrays import freeze, freeze_all
from hickory_stream.pictures.open3d_import import import_open3d

CasterName = Literal["embreex", "open3d"]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Crossings:
    """The first hits of N rays: `t` (N,) float32 in multiples of the direction vectors, inf without a hit.

    For rays with a hit: `geometry` and `triangle` (N,) uint32 in the order of adding; `uv` (N, 2) barycentric weights
    of the second and third corner; `normals` (N, 3), unit, oriented by the order of the corners.
    """

    t: NDArray[np.float32]
    geometry: NDArray[np.uint32]
    triangle: NDArray[np.uint32]
    uv: NDArray[np.float32]
    normals: NDArray[np.float32]

    def __post_init__(self) -> None:
        count = len(self.t)
        freeze(self, "t", np.float32, (count,))
        freeze_all(self, np.uint32, geometry=(count,), triangle=(count,))
        freeze_all(self, np.float32, uv=(count, 2), normals=(count, 3))


class RayCaster(Protocol):
    """A scene of meshes; rays are (N, 6) float32, origins and directions."""

    def add(self, vertices: NDArray[np.float32], faces: NDArray[np.int32]) -> None:
        """Add a mesh of (V, 3) vertices and (F, 3) faces; all meshes are added before the first ray is cast."""

    def cast(self, rays: NDArray[np.float32]) -> Crossings:
        """Return the first hits of the rays."""

    def is_occluded(self, rays: NDArray[np.float32], reach: float = np.inf) -> NDArray[np.bool_]:
        """Return (N,) whether the rays hit anything up to `reach`, in multiples of their direction vectors."""


def ray_caster(name: CasterName | None = None) -> RayCaster:
    """Return an empty scene of a library, by default the platform's; raises `InputError` if it is not installed."""
    if name is None:
        name = "embreex" if importlib.util.find_spec("embreex") is not None else "open3d"
    if name == "embreex":
        return _Embreex()
    if name == "open3d":
        return _Open3D()
    assert_never(name)


class _Embreex:
    def __init__(self) -> None:
        from embreex.rtcore_scene import EmbreeScene

        self._scene = EmbreeScene(robust=True)

    def add(self, vertices: NDArray[np.float32], faces: NDArray[np.int32]) -> None:
        from embreex.mesh_construction import TriangleMesh

        TriangleMesh(self._scene, np.array(vertices, np.float32), np.array(faces, np.int32))

    def cast(self, rays: NDArray[np.float32]) -> Crossings:
        found = self._scene.run(*_split(rays), dists=np.inf, query="INTERSECT", output=True)
        lengths = np.linalg.norm(found["Ng"], axis=1, keepdims=True)
        is_hit = found["primID"] >= 0
        return Crossings(
            t=np.where(is_hit, found["tfar"], np.float32(np.inf)),
            geometry=found["geomID"].astype(np.uint32),
            triangle=found["primID"].astype(np.uint32),
            uv=np.stack([found["u"], found["v"]], axis=1),
            normals=np.divide(found["Ng"], lengths, out=np.zeros_like(found["Ng"]), where=is_hit[:, None]),
        )

    def is_occluded(self, rays: NDArray[np.float32], reach: float = np.inf) -> NDArray[np.bool_]:
        return np.asarray(self._scene.run(*_split(rays), dists=reach, query="OCCLUDED") != -1)


class _Open3D:
    def __init__(self) -> None:
        open3d = import_open3d()
        self._tensor = open3d.core.Tensor
        self._scene = open3d.t.geometry.RaycastingScene()

    def add(self, vertices: NDArray[np.float32], faces: NDArray[np.int32]) -> None:
        self._scene.add_triangles(self._tensor(np.array(vertices)), self._tensor(faces.astype(np.uint32)))

    def cast(self, rays: NDArray[np.float32]) -> Crossings:
        found = {key: value.numpy() for key, value in self._scene.cast_rays(self._tensor(rays)).items()}
        return Crossings(
            t=found["t_hit"],
            geometry=found["geometry_ids"],
            triangle=found["primitive_ids"],
            uv=found["primitive_uvs"],
            normals=found["primitive_normals"],
        )

    def is_occluded(self, rays: NDArray[np.float32], reach: float = np.inf) -> NDArray[np.bool_]:
        return np.asarray(self._scene.test_occlusions(self._tensor(rays), tnear=0.0, tfar=reach).numpy())


def _split(rays: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    return np.ascontiguousarray(rays[:, :3]), np.ascontiguousarray(rays[:, 3:])
