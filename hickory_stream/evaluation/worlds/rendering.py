"""Ray-cast images of a world: lit colour, exact depth, exact instances.

Geometries are numbered with the structure first and the objects after it; colour is sampled four times per pixel, depth
and instances once, through the pixel's centre.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numba
import numpy as np

from hickory_stream.evaluation.open3d_import import import_open3d
from hickory_stream.evaluation.worlds.parts import model_mesh
from hickory_stream.evaluation.worlds.textures import albedo, texture_table
from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.rigid import apply, invert

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.evaluation.worlds.parts import Model
    from hickory_stream.evaluation.worlds.scene import World
    from hickory_stream.geometry.camera import Camera

# Height and place of the two lamps under the ceiling, as shares of the half room; the first throws shadows.
_MAIN_LIGHT = (0.25, -0.2, 2.45)
_FILL_LIGHT = (-0.7, 0.6, 2.2)
_SHADOW = 0.45


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Rendered:
    """What a camera without defects sees.

    `rgb` (H, W, 3) uint8; `depth_m` (H, W) float32 along the optical axis, NaN without a hit; `instances` (H, W)
    uint16, 0 = no object; `cosine` (H, W) float32 of the angle between ray and surface normal.
    """

    rgb: NDArray[np.uint8]
    depth_m: NDArray[np.float32]
    instances: NDArray[np.uint16]
    cosine: NDArray[np.float32]

    def __post_init__(self) -> None:
        size = self.depth_m.shape
        freeze(self, "rgb", np.uint8, (*size, 3))
        freeze(self, "depth_m", np.float32, size)
        freeze(self, "instances", np.uint16, size)
        freeze(self, "cosine", np.float32, size)


class Renderer:
    """A world loaded into the ray caster."""

    def __init__(self, world: World) -> None:
        o3d = import_open3d()
        self._scene = o3d.t.geometry.RaycastingScene()
        self._tensor = o3d.core.Tensor
        models: list[tuple[Model, NDArray[np.float64]]] = [(model, np.eye(4)) for model in world.structure]
        models += [(item.model, item.world_from_object) for item in world.objects]
        self._instance_of = np.array([0] * len(world.structure) + [item.id for item in world.objects], dtype=np.uint16)
        self._object_from_world = np.stack([invert(world_from_object) for _, world_from_object in models])
        for model, world_from_object in models:
            mesh = model_mesh(model)
            vertices = apply(world_from_object, mesh.vertices.astype(np.float64)).astype(np.float32)
            self._scene.add_triangles(self._tensor(vertices), self._tensor(mesh.faces.astype(np.uint32)))
        parts = [part for model, _ in models for part in model.parts]
        self._textures = texture_table([part.texture for part in parts])
        self._texture_of_face = np.repeat(np.arange(len(parts)), [len(part.faces) for part in parts])
        counts = [sum(len(part.faces) for part in model.parts) for model, _ in models]
        self._first_face = np.concatenate([[0], np.cumsum(counts)[:-1]])
        x0, y0, x1, y1 = world.interior_m
        half = np.array([(x1 - x0) / 2, (y1 - y0) / 2, 1.0])
        self._lights = np.array([_MAIN_LIGHT, _FILL_LIGHT]) * half

    def render(self, camera: Camera, world_from_camera: NDArray[np.float64]) -> Rendered:
        """Return what the camera sees, without any defect."""
        size = (camera.height, camera.width)
        rays = _rays(camera, world_from_camera)
        hit = self._cast(rays)
        is_hit = np.isfinite(hit["t_hit"])
        instances = np.zeros(is_hit.shape, dtype=np.uint16)
        instances[is_hit] = self._instance_of[hit["geometry_ids"][is_hit]]
        length = np.linalg.norm(rays[:, 3:], axis=1)
        cosine = np.abs(np.einsum("ij,ij->i", hit["primitive_normals"], rays[:, 3:])) / length
        return Rendered(
            rgb=self._color(camera, world_from_camera),
            depth_m=np.where(is_hit, hit["t_hit"], np.nan).reshape(size),
            instances=instances.reshape(size),
            cosine=cosine.reshape(size),
        )

    def _cast(self, rays: NDArray[np.float32]) -> dict[str, NDArray[Any]]:
        return {key: value.numpy() for key, value in self._scene.cast_rays(self._tensor(rays)).items()}

    def _color(self, camera: Camera, world_from_camera: NDArray[np.float64]) -> NDArray[np.uint8]:
        fine = camera.scaled(2.0)
        rays = _rays(fine, world_from_camera)
        hit = self._cast(rays)
        reach: NDArray[np.float32] = np.nan_to_num(hit["t_hit"], posinf=0.0)
        points = rays[:, :3] + reach[:, None] * rays[:, 3:]
        # Faces look outwards, but a ray may graze one from inside by rounding: light the side that is seen.
        normals = hit["primitive_normals"]
        normals = np.where(np.einsum("ij,ij->i", normals, rays[:, 3:])[:, None] > 0, -normals, normals)
        colors = _shade(
            points,
            normals,
            hit["geometry_ids"],
            hit["primitive_ids"],
            self._is_lit(points, normals),
            self._object_from_world,
            self._first_face,
            self._texture_of_face,
            self._textures,
            self._lights,
        )
        image = colors.reshape(fine.height, fine.width, 3)
        small = cv2.resize(image, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
        return (np.clip(small, 0.0, 1.0) * 255 + 0.5).astype(np.uint8)

    def _is_lit(self, points: NDArray[np.float32], normals: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Return for each (N, 3) point whether the main light reaches it."""
        start = points + 0.002 * normals
        rays = np.concatenate([start, self._lights[0].astype(np.float32) - start], axis=1).astype(np.float32)
        return ~self._scene.test_occlusions(self._tensor(rays), tfar=1.0).numpy()


def _rays(camera: Camera, world_from_camera: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return (H * W, 6) rays in the world whose parameter is the depth along the optical axis."""
    u = (np.arange(camera.width) - camera.cx) / camera.fx
    v = (np.arange(camera.height) - camera.cy) / camera.fy
    rays = np.empty((camera.height, camera.width, 6), dtype=np.float32)
    for i in range(3):
        right, down, forward = world_from_camera[i, :3]
        rays[..., i] = world_from_camera[i, 3]
        rays[..., 3 + i] = right * u[None, :] + (down * v + forward)[:, None]
    return rays.reshape(-1, 6)


@numba.njit(cache=True)
def _shade(  # type: ignore[no-untyped-def] # pragma: no cover
    points, normals, geometry, primitive, is_lit, object_from_world, first_face, texture_of_face, textures, lights
):
    """Return the (N, 3) float32 colours of hits: texture times ambient light and two lamps; black without a hit."""
    colors = np.zeros((len(points), 3), dtype=np.float32)
    for i in range(len(points)):
        g = geometry[i]
        if g >= len(first_face):
            continue
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        m = object_from_world[g]
        ox = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
        oy = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
        oz = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
        red, green, blue = albedo(ox, oy, oz, textures[texture_of_face[first_face[g] + primitive[i]]])
        light = 0.50 + 0.10 * normals[i, 2]
        for k in range(2):
            dx, dy, dz = lights[k, 0] - x, lights[k, 1] - y, lights[k, 2] - z
            distance = (dx * dx + dy * dy + dz * dz) ** 0.5
            cosine = (dx * normals[i, 0] + dy * normals[i, 1] + dz * normals[i, 2]) / distance
            strength = (0.95 if k == 0 else 0.4) / (0.6 + 0.16 * distance * distance)
            if k == 0 and not is_lit[i]:
                strength *= _SHADOW
            light += strength * max(cosine, 0.0)
        # A soft shoulder instead of clipping keeps texture in what is close to a lamp.
        light = light if light < 1.0 else 1.0 + 0.35 * (light - 1.0)
        colors[i, 0], colors[i, 1], colors[i, 2] = red * light, green * light, blue * light
    return colors
