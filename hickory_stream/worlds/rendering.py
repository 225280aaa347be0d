"""Ray-cast images of a world: lit colour, exact depth, exact instances.

Geometries are numbered with the structure first and the objects after it. Depth and instances are sampled once, through
the pixel's centre. Colour is sampled four times at edges, and inside a face twice, without casting further rays.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.arrays import freeze, freeze_all
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.pictures.ray_caster import CasterName, Crossings, ray_caster
from hickory_stream.worlds.lighting import Lighting, lamp_table, usual_lighting
from hickory_stream.worlds.object_models import Model, model_triangles
from hickory_stream.worlds.scene import World
from hickory_stream.worlds.textures import albedo, texture_table

GLASS = "window"
"""The kind of structure that shows in colour and gives no depth."""
# Below this specular share of a lamp's light, stereo matching still works.
_GLARE = 0.45


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Rendered:
    """The images of a camera without defects.

    `rgb` (H, W, 3) uint8; `depth_m` (H, W) float32 along the optical axis, NaN without a hit; `instances` (H, W)
    uint16, 0 = no object; `cosine` (H, W) float32 of the angle between ray and surface normal; `is_structure` (H, W)
    bool; `is_blind` (H, W) bool, where stereo matching fails: glass and highlights.
    """

    rgb: NDArray[np.uint8]
    depth_m: NDArray[np.float32]
    instances: NDArray[np.uint16]
    cosine: NDArray[np.float32]
    is_structure: NDArray[np.bool_]
    is_blind: NDArray[np.bool_]

    def __post_init__(self) -> None:
        size = self.depth_m.shape
        freeze(self, "rgb", np.uint8, (*size, 3))
        freeze(self, "depth_m", np.float32, size)
        freeze(self, "instances", np.uint16, size)
        freeze(self, "cosine", np.float32, size)
        freeze_all(self, np.bool_, is_structure=size, is_blind=size)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Probe:
    """The hits of N rays: depth along the optical axis (inf: none), instance, whether a face is hit from its back."""

    depth_m: NDArray[np.float32]
    instances: NDArray[np.uint16]
    is_within: NDArray[np.bool_]

    def __post_init__(self) -> None:
        freeze(self, "depth_m", np.float32, (None,))
        freeze(self, "instances", np.uint16, self.depth_m.shape)
        freeze(self, "is_within", np.bool_, self.depth_m.shape)


class Renderer:
    """A world loaded into the ray caster."""

    def __init__(self, world: World, caster: CasterName | None = None) -> None:
        self.caster = caster
        self._scene = ray_caster(caster)
        models: list[tuple[Model, NDArray[np.float64]]] = [(model, np.eye(4)) for model in world.structure]
        models += [(item.model, item.world_from_object) for item in world.objects]
        self._instance_of = np.array([0] * len(world.structure) + [item.id for item in world.objects], dtype=np.uint16)
        self._object_from_world = np.stack([invert(world_from_object) for _, world_from_object in models])
        for model, world_from_object in models:
            vertices, faces = model_triangles(model)
            self._scene.add(apply(world_from_object, vertices.astype(np.float64)).astype(np.float32), faces)
        parts = [part for model, _ in models for part in model.parts]
        self._textures = texture_table([part.texture for part in parts])
        self._texture_of_face = np.repeat(np.arange(len(parts)), [len(part.faces) for part in parts])
        counts = [sum(len(part.faces) for part in model.parts) for model, _ in models]
        self._first_face = np.concatenate([[0], np.cumsum(counts)[:-1]])
        self._rooms = np.array(world.rooms_m)
        lighting: Lighting = world.lighting or usual_lighting(world.rooms_m)
        self._num_shadows = lighting.num_shadows
        self._lamps = lamp_table(lighting)
        self._ambient = np.array(lighting.ambient)
        self._sky = np.array(lighting.sky, dtype=np.float32)
        self._is_glass = np.array([model.kind == GLASS for model, _ in models])

    def render(self, camera: Camera, world_from_camera: NDArray[np.float64]) -> Rendered:
        """Return the images of the camera, without defects."""
        size = (camera.height, camera.width)
        rays = rays_of(camera, world_from_camera)
        hit = self._scene.cast(rays)
        is_hit = np.isfinite(hit.t)
        instances = np.zeros(is_hit.shape, dtype=np.uint16)
        instances[is_hit] = self._instance_of[hit.geometry[is_hit]]
        is_glass = np.zeros(is_hit.shape, dtype=bool)
        is_glass[is_hit] = self._is_glass[hit.geometry[is_hit]]
        length = np.linalg.norm(rays[:, 3:], axis=1)
        cosine = np.abs(np.einsum("ij,ij->i", hit.normals, rays[:, 3:])) / length
        rgb, glare = self._color(camera, world_from_camera, rays, hit)
        return Rendered(
            rgb=rgb,
            depth_m=np.where(is_hit, hit.t, np.nan).reshape(size),
            instances=instances.reshape(size),
            cosine=cosine.reshape(size),
            is_structure=(is_hit & (instances == 0)).reshape(size),
            is_blind=is_glass.reshape(size) | (glare > _GLARE),
        )

    def probe(self, camera: Camera, world_from_camera: NDArray[np.float64]) -> Probe:
        """Return the hits of a view without colours, for the choice of views with a camera of few pixels."""
        rays = rays_of(camera, world_from_camera)
        hit = self._scene.cast(rays)
        is_hit = np.isfinite(hit.t)
        instances = np.zeros(is_hit.shape, dtype=np.uint16)
        instances[is_hit] = self._instance_of[hit.geometry[is_hit]]
        is_within = np.einsum("ij,ij->i", hit.normals, rays[:, 3:]) > 0
        return Probe(depth_m=hit.t, instances=instances, is_within=is_within & is_hit)

    def _color(
        self, camera: Camera, world_from_camera: NDArray[np.float64], rays: NDArray[np.float32], hit: Crossings
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Return the image, and the specular share (H, W) of its light.

        Inside a face, the light is that at the pixel's centre; at edges, further rays are cast.
        """
        size = (camera.height, camera.width)
        lamps, is_lit = self._light(rays, hit)
        table = (self._object_from_world, self._first_face, self._texture_of_face, self._textures)
        colors, is_edge, glare = _shade_faces(
            rays.reshape(*size, 6),
            hit.t.reshape(size),
            hit.normals.reshape(*size, 3),
            hit.geometry.reshape(size),
            hit.triangle.reshape(size),
            is_lit.reshape(size),
            lamps.reshape(size),
            self._lamps,
            self._ambient,
            *table,
        )
        edges = np.flatnonzero(is_edge)
        fine = rays_of(camera.scaled(2.0), world_from_camera).reshape(size[0], 2, size[1], 2, 6)
        sub = np.ascontiguousarray(fine.transpose(0, 2, 1, 3, 4).reshape(-1, 4, 6)[edges].reshape(-1, 6))
        sub_hit = self._scene.cast(sub)
        sub_lamps, sub_lit = self._light(sub, sub_hit)
        sub_colors = _shade(
            sub,
            sub_hit.t,
            sub_hit.normals,
            sub_hit.geometry,
            sub_hit.triangle,
            sub_lit,
            sub_lamps,
            self._lamps,
            self._ambient,
            *table,
        )
        sub_colors[~np.isfinite(sub_hit.t)] = self._sky
        colors.reshape(-1, 3)[edges] = sub_colors.reshape(-1, 4, 3).mean(axis=1)
        return (np.clip(colors, 0.0, 1.0) * 255 + 0.5).astype(np.uint8), glare

    def _light(self, rays: NDArray[np.float32], hit: Crossings) -> tuple[NDArray[np.intp], NDArray[np.uint8]]:
        """Return for each ray the room whose lamps light what it hits, and which lamps reach it: bit k for lamp k."""
        reach: NDArray[np.float32] = np.nan_to_num(hit.t, posinf=0.0)
        points = rays[:, :3] + reach[:, None] * rays[:, 3:]
        normals = hit.normals
        facing = np.einsum("ij,ij->i", normals, rays[:, 3:])[:, None] > 0
        start = points + np.where(facing, np.float32(-0.002), np.float32(0.002)) * normals
        rooms = _nearest_room(start, self._rooms)
        reached = np.full(len(rays), 0xFF, dtype=np.uint8)
        for k in range(self._num_shadows):
            lamps = self._lamps[rooms, k, :3].astype(np.float32)
            shadow = np.concatenate([start, lamps - start], axis=1)
            reached[self._scene.is_occluded(shadow, 1.0)] &= np.uint8(0xFF ^ (1 << k))
        return rooms, reached


def rays_of(camera: Camera, world_from_camera: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return (H * W, 6) rays in the world, parametrised by the depth along the optical axis."""
    u = (np.arange(camera.width) - camera.cx) / camera.fx
    v = (np.arange(camera.height) - camera.cy) / camera.fy
    rays = np.empty((camera.height, camera.width, 6), dtype=np.float32)
    for i in range(3):
        right, down, forward = world_from_camera[i, :3]
        rays[..., i] = world_from_camera[i, 3]
        rays[..., 3 + i] = right * u[None, :] + (down * v + forward)[:, None]
    return rays.reshape(-1, 6)


@kernel
def _nearest_room(points, rooms):
    """Return the index of the room (x0, y0, x1, y1) that contains each (N, 3) point, or of the nearest one."""
    nearest = np.zeros(len(points), dtype=np.intp)
    for i in range(len(points)):
        best = np.inf
        for r in range(len(rooms)):
            dx = max(rooms[r, 0] - points[i, 0], 0.0, points[i, 0] - rooms[r, 2])
            dy = max(rooms[r, 1] - points[i, 1], 0.0, points[i, 1] - rooms[r, 3])
            if dx * dx + dy * dy < best:
                best = dx * dx + dy * dy
                nearest[i] = r
    return nearest


@kernel
def _shade_faces(
    rays,
    t_hit,
    normals,
    geometry,
    primitive,
    is_lit,
    room,
    lamps,
    ambient,
    object_from_world,
    first_face,
    texture_of_face,
    textures,
):
    """Return (H, W, 3) float32 colours, (H, W) whether a pixel lies at an edge of faces, textures or shadows, glare.

    Away from edges the texture is sampled twice in a pixel, on the plane of its face, and the light once.
    """
    height, width = t_hit.shape
    colors = np.zeros((height, width, 3), dtype=np.float32)
    is_edge = np.zeros((height, width), dtype=np.bool_)
    glare = np.zeros((height, width), dtype=np.float32)
    for v in range(height):
        for u in range(width):
            g = geometry[v, u]
            if g >= len(first_face):
                is_edge[v, u] = True
                continue
            texture = texture_of_face[first_face[g] + primitive[v, u]]
            nx, ny, nz = normals[v, u, 0], normals[v, u, 1], normals[v, u, 2]
            edge = False
            for dv in range(-1, 2):
                for du in range(-1, 2):
                    y, x = min(max(v + dv, 0), height - 1), min(max(u + du, 0), width - 1)
                    k = geometry[y, x]
                    if (
                        k != g
                        or is_lit[y, x] != is_lit[v, u]
                        or texture_of_face[first_face[k] + primitive[y, x]] != texture
                        or nx * normals[y, x, 0] + ny * normals[y, x, 1] + nz * normals[y, x, 2] < 0.9
                    ):
                        edge = True
            ray = rays[v, u]
            cosine = nx * ray[3] + ny * ray[4] + nz * ray[5]
            if edge or abs(cosine) < 0.05:
                is_edge[v, u] = True
                continue
            t = t_hit[v, u]
            px, py, pz = ray[0] + t * ray[3], ray[1] + t * ray[4], ray[2] + t * ray[5]
            light = _light_at(px, py, pz, nx, ny, nz, cosine, is_lit[v, u], lamps[room[v, u]], ambient)
            across, below = rays[v, min(u + 1, width - 1)], rays[min(v + 1, height - 1), u]
            red, green, blue = 0.0, 0.0, 0.0
            for sign in (-0.25, 0.25):
                dx = ray[3] + sign * (across[3] - ray[3]) - sign * (below[3] - ray[3])
                dy = ray[4] + sign * (across[4] - ray[4]) - sign * (below[4] - ray[4])
                dz = ray[5] + sign * (across[5] - ray[5]) - sign * (below[5] - ray[5])
                k = t * cosine / (nx * dx + ny * dy + nz * dz)
                r, g2, b = _albedo_at(
                    ray[0] + k * dx, ray[1] + k * dy, ray[2] + k * dz, object_from_world[g], textures[texture]
                )
                red, green, blue = red + r, green + g2, blue + b
            colors[v, u, 0], colors[v, u, 1] = red * light[0] / 2, green * light[1] / 2
            colors[v, u, 2] = blue * light[2] / 2
            if textures[texture, 10] > 0:
                shine = _shine_at(px, py, pz, nx, ny, nz, ray, is_lit[v, u], lamps[room[v, u]], textures[texture, 10])
                colors[v, u, 0] += shine[0]
                colors[v, u, 1] += shine[1]
                colors[v, u, 2] += shine[2]
                glare[v, u] = (shine[0] + shine[1] + shine[2]) / 3
    return colors, is_edge, glare


@kernel
def _shade(
    rays,
    t_hit,
    normals,
    geometry,
    primitive,
    is_lit,
    room,
    lamps,
    ambient,
    object_from_world,
    first_face,
    texture_of_face,
    textures,
):
    """Return the (N, 3) float32 colours of hits; black without a hit."""
    colors = np.zeros((len(rays), 3), dtype=np.float32)
    for i in range(len(rays)):
        g = geometry[i]
        if g >= len(first_face):
            continue
        t, ray = t_hit[i], rays[i]
        nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
        x, y, z = ray[0] + t * ray[3], ray[1] + t * ray[4], ray[2] + t * ray[5]
        texture = textures[texture_of_face[first_face[g] + primitive[i]]]
        red, green, blue = _albedo_at(x, y, z, object_from_world[g], texture)
        cosine = nx * ray[3] + ny * ray[4] + nz * ray[5]
        light = _light_at(x, y, z, nx, ny, nz, cosine, is_lit[i], lamps[room[i]], ambient)
        colors[i, 0], colors[i, 1], colors[i, 2] = red * light[0], green * light[1], blue * light[2]
        if texture[10] > 0:
            shine = _shine_at(x, y, z, nx, ny, nz, ray, is_lit[i], lamps[room[i]], texture[10])
            colors[i, 0] += shine[0]
            colors[i, 1] += shine[1]
            colors[i, 2] += shine[2]
    return colors


@kernel
def _albedo_at(x, y, z, m, texture):
    """Return the texture's colour at a point of the world; `m` is object_from_world."""
    ox = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
    oy = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
    oz = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
    return albedo(ox, oy, oz, texture)


@kernel
def _light_at(x, y, z, nx, ny, nz, cosine, is_lit, lamps, ambient):
    """Return ambient light and that of a room's lamps (red, green, blue) on the side of a face that the ray meets."""
    # Faces point outwards, but by rounding a grazing ray may hit one from inside: the visible side is lit.
    side = -1.0 if cosine > 0 else 1.0
    sky = 0.10 * side * nz
    red, green, blue = ambient[0] + sky, ambient[1] + sky, ambient[2] + sky
    for k in range(len(lamps)):
        lamp = lamps[k]
        dx, dy, dz = lamp[0] - x, lamp[1] - y, lamp[2] - z
        distance = (dx * dx + dy * dy + dz * dz) ** 0.5
        towards = max(side * (dx * nx + dy * ny + dz * nz) / distance, 0.0)
        fall = lamp[6] + lamp[7] * distance * distance
        shadow = 1.0 if is_lit & (1 << k) else lamp[8]
        red += lamp[3] / fall * shadow * towards
        green += lamp[4] / fall * shadow * towards
        blue += lamp[5] / fall * shadow * towards
    return _shoulder(red), _shoulder(green), _shoulder(blue)


@kernel
def _shoulder(light):
    """Return the light with highlights compressed, so that texture close to a lamp is not clipped."""
    return light if light < 1.0 else 1.0 + 0.35 * (light - 1.0)


@kernel
def _shine_at(x, y, z, nx, ny, nz, ray, is_lit, lamps, gloss):
    """Return the specular light (red, green, blue) of the lamps that reach a point, along a ray (Blinn-Phong)."""
    red, green, blue = 0.0, 0.0, 0.0
    length = (ray[3] * ray[3] + ray[4] * ray[4] + ray[5] * ray[5]) ** 0.5
    vx, vy, vz = -ray[3] / length, -ray[4] / length, -ray[5] / length
    side = -1.0 if vx * nx + vy * ny + vz * nz < 0 else 1.0
    # The highlight of a glossier surface is smaller.
    exponent = 8.0 + 120.0 * gloss
    for k in range(len(lamps)):
        if not is_lit & (1 << k):
            continue
        lamp = lamps[k]
        dx, dy, dz = lamp[0] - x, lamp[1] - y, lamp[2] - z
        distance = (dx * dx + dy * dy + dz * dz) ** 0.5
        hx, hy, hz = vx + dx / distance, vy + dy / distance, vz + dz / distance
        half = max(side * (hx * nx + hy * ny + hz * nz) / (hx * hx + hy * hy + hz * hz) ** 0.5, 0.0)
        shine = gloss * half**exponent
        red, green, blue = red + lamp[3] * shine, green + lamp[4] * shine, blue + lamp[5] * shine
    return red, green, blue
