"""A person who walks through the images and occludes objects, without being one."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import apply
from hickory_stream.pictures.ray_caster import CasterName, ray_caster
from hickory_stream.worlds.object_models import Model, Part, ellipsoid, model_mesh, rounded_box, tube
from hickory_stream.worlds.palettes import plain
from hickory_stream.worlds.rendering import Rendered, rays_of
from hickory_stream.worlds.shots import OCCLUDER_ID
from hickory_stream.worlds.textures import Texture
from hickory_stream.worlds.trajectory import Trajectory

_STRIDE_HZ = 0.9
_KEEPS_AWAY_M = 0.6


@dataclass(frozen=True, kw_only=True, slots=True)
class Person:
    """Walks along the ground track of a trajectory, `ahead_s` ahead of it in time."""

    track: Trajectory
    ahead_s: float = 0.0

    def model_at(self, time_s: float) -> tuple[Model, NDArray[np.float64]]:
        """Return the figure in its stride and its pose at a time; it faces where it goes."""
        last = float(self.track.times_s[-1]) - 0.3
        at = (time_s + self.ahead_s) % last
        here, there = (self.track.pose_at(t)[:2, 3] for t in (at, at + 0.25))
        heading = there - here
        yaw = float(np.arctan2(heading[1], heading[0]))
        c, s = np.cos(yaw), np.sin(yaw)
        world_from_person = np.eye(4)
        world_from_person[:2, :2], world_from_person[:2, 3] = [[c, -s], [s, c]], here
        return figure(2 * np.pi * _STRIDE_HZ * time_s), world_from_person

    def drawn_into(
        self, rendered: Rendered, camera: Camera, world_from_camera: NDArray[np.float64], time_s: float,
        caster: CasterName | None = None,
    ) -> Rendered:  # fmt: skip
        """Return an image with the person in front of the scene; close to the camera, the person steps aside."""
        model, world_from_person = self.model_at(time_s)
        if np.linalg.norm(world_from_person[:2, 3] - world_from_camera[:2, 3]) < _KEEPS_AWAY_M:
            return rendered
        mesh = model_mesh(model)
        scene = ray_caster(caster)
        vertices = apply(world_from_person, mesh.vertices.astype(np.float64)).astype(np.float32)
        scene.add(vertices, mesh.faces)
        rays = rays_of(camera, world_from_camera)
        hit = scene.cast(rays)
        depth = np.nan_to_num(rendered.depth_m, nan=np.inf).reshape(-1)
        nearer = np.flatnonzero(hit.t < depth)
        towards = rays[nearer, 3:] / np.linalg.norm(rays[nearer, 3:], axis=1, keepdims=True)
        cosine = np.abs((hit.normals[nearer] * towards).sum(axis=1))
        colors = mesh.colors[mesh.faces[hit.triangle[nearer]]].mean(axis=1) * (0.45 + 0.5 * cosine)[:, None]
        size = (camera.height, camera.width)
        rgb, depth_m = rendered.rgb.reshape(-1, 3).copy(), rendered.depth_m.reshape(-1).copy()
        instances, incidence = rendered.instances.reshape(-1).copy(), rendered.cosine.reshape(-1).copy()
        rgb[nearer] = np.clip(colors, 0, 255).astype(np.uint8)
        depth_m[nearer], instances[nearer], incidence[nearer] = hit.t[nearer], OCCLUDER_ID, cosine
        is_structure, is_blind = rendered.is_structure.reshape(-1).copy(), rendered.is_blind.reshape(-1).copy()
        is_structure[nearer], is_blind[nearer] = False, False
        return replace(
            rendered, rgb=rgb.reshape(*size, 3), depth_m=depth_m.reshape(size), instances=instances.reshape(size),
            cosine=incidence.reshape(size), is_structure=is_structure.reshape(size), is_blind=is_blind.reshape(size),
        )  # fmt: skip


def figure(stride_rad: float) -> Model:
    """Return a person of 1.72 m facing +x, arms and legs swung to a phase of the stride."""
    trousers, skin = plain((0.18, 0.2, 0.3)), plain((0.85, 0.66, 0.54))
    shirt = Texture(pattern="stripes", first=(0.75, 0.72, 0.6), second=(0.5, 0.25, 0.22), period_m=0.08, axis=2)
    swing = 0.45 * np.sin(stride_rad)
    parts = [
        rounded_box((0.22, 0.38, 0.6), shirt, at=(0, 0, 1.15), radius_m=0.09),
        tube([(0, 0, 1.4), (0, 0, 1.48), (0, 0, 1.53)], 0.055, skin),
        ellipsoid((0.1, 0.085, 0.125), skin, at=(0, 0, 1.6)),
    ]
    for side in (-1, 1):
        a = side * swing
        hip, knee = np.array([0, side * 0.1, 0.88]), np.array([0.44 * np.sin(a), side * 0.1, 0.88 - 0.42 * np.cos(a)])
        bent = a - 0.35 * max(0.0, -np.sin(stride_rad) * side)
        foot = knee + np.array([0.42 * np.sin(bent), 0.0, -0.42 * np.cos(bent)])
        parts += [
            _limb(hip, knee, 0.08, trousers),
            _limb(knee, foot, 0.06, trousers),
            ellipsoid((0.13, 0.05, 0.045), plain((0.1, 0.1, 0.1)), at=(float(foot[0]) + 0.05, *foot[1:].tolist())),
        ]
        shoulder = np.array([0, side * 0.23, 1.38])
        hand = shoulder + np.array([0.55 * np.sin(-a), side * 0.04, -0.55 * np.cos(a)])
        parts.append(_limb(shoulder, hand, 0.045, shirt))
        parts.append(ellipsoid((0.05, 0.05, 0.05), skin, at=hand.tolist()))
    return Model(kind="person", parts=tuple(parts))


def _limb(a: NDArray[np.float64], b: NDArray[np.float64], radius_m: float, texture: Texture) -> Part:
    return tube([a.tolist(), ((a + b) / 2).tolist(), b.tolist()], radius_m, texture)
