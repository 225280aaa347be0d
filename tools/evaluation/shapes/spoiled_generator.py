"""A generator that knows the truth, and spoils it by seed: `tools/bench layer2` places and judges its meshes."""
# Spoilt: stretched by up to 20 % an axis, unseen surface invented, smoothed, noisy; or another object of the class, or
# the mirror image. The transform of the true part stays known.

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import trimesh
from numpy.typing import NDArray

from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.camera import Camera, backproject
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.rigid import apply, rotation_from_quaternion, yaw_rotation
from hickory_stream.geometry.voxels import centers_of_keys, keys_of_points
from hickory_stream.pictures.raycast import Scene, Surface
from hickory_stream.ports import Crop, ShapeInputs

Fate = Literal["own", "other", "mirrored"]
_CAMERA = Camera(width=320, height=240, fx=260.0, fy=260.0, cx=159.5, cy=119.5)
_SIZE = (_CAMERA.height, _CAMERA.width)
_OBJECT, _OCCLUDER, _FLOOR = 1, 2, 3
_MARGIN_PX = 10
_MIN_PIXELS = 120


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Sighted:
    """An object in the world and its views: `made_from` for a job, `held_out` for its evaluation."""

    mesh_world: Mesh
    made_from: ShapeInputs
    held_out: tuple[Crop, ...]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Generated:
    """A mesh in a frame of its own; `mesh_from_true` (4, 4) is affine, as far as the mesh is true."""

    mesh: Mesh
    mesh_from_true: NDArray[np.float64]
    fate: Fate


def plain_mesh(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> Mesh:
    count = len(vertices)
    colors = np.full((count, 3), 150, np.uint8)
    return Mesh(vertices=vertices, faces=faces, colors=colors, is_seen=np.zeros(count, bool))


def sighted(mesh: Mesh, rng: np.random.Generator, num_views: int, *, num_held_out: int = 2) -> Sighted | None:
    """Return an object (its mesh stands on z = 0) somewhere on a floor, seen along an arc, at times behind a box."""
    # None where no view shows enough of it.
    turn = yaw_rotation(float(rng.uniform(0, 2 * np.pi)))
    place = np.array([*rng.uniform(-3, 3, 2), rng.uniform(0, 1)])
    vertices = mesh.vertices.astype(np.float64) @ turn.T + place
    world = replace(mesh, vertices=vertices)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    middle, size = (low + high) / 2, float(np.linalg.norm(high - low))
    distance = max(float(rng.uniform(1.3, 2.4)) * size, 0.5)
    first, arc, tilt = (float(rng.uniform(*limits)) for limits in ((0, 2 * np.pi), (0.3, 2 * np.pi), (0.15, 0.8)))
    scene = _scene(world, low, high, first, rng)
    crops = []
    for i in range(num_views + num_held_out):
        azimuth = first + arc * (i / max(num_views - 1, 1)) if i < num_views else float(rng.uniform(0, 2 * np.pi))
        around = [np.cos(azimuth) * np.cos(tilt), np.sin(azimuth) * np.cos(tilt), np.sin(tilt)]
        crops.append(_crop(scene, _looking_at(middle + distance * np.array(around), middle), rng))
    shown = [crop for crop in crops[:num_views] if crop is not None]
    if not shown:
        return None
    shown.sort(key=lambda crop: -int(crop.mask.sum()))
    points = np.concatenate(
        [apply(c.world_from_camera, backproject(c.depth_m, c.camera)[c.mask & np.isfinite(c.depth_m)]) for c in shown]
    )
    fused = centers_of_keys(np.unique(keys_of_points(points, 0.02)), 0.02)
    inputs = ShapeInputs(
        crops=tuple(shown), points_world=fused.astype(np.float32), colors=np.full((len(fused), 3), 150, np.uint8),
        box=gravity_aligned_box(fused.astype(np.float64), 0.01), support_z_m=float(low[2]),
    )  # fmt: skip
    held_out = tuple(crop for crop in crops[num_views:] if crop is not None)
    return Sighted(mesh_world=world, made_from=inputs, held_out=held_out)


def generated(seen: Sighted, rng: np.random.Generator, *, is_spoiled: bool, other: Mesh | None = None) -> Generated:
    """Return the generator's mesh of an object: the truth, spoiled or not, or the other mesh, or its mirror image."""
    fate: Fate = "own"
    mesh = seen.mesh_world
    if other is not None:
        fate = "other" if rng.random() < 0.5 else "mirrored"
        mesh = other if fate == "other" else _mirrored(mesh)
    vertices = mesh.vertices.astype(np.float64)
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    linear = np.eye(3)
    vertices = vertices - middle
    if is_spoiled:
        if fate == "own":
            vertices = _invented(seen, vertices, middle, rng)
        own = yaw_rotation(float(rng.uniform(0, np.pi)))
        linear = own @ np.diag(rng.uniform(0.8, 1.2, 3)) @ own.T
        size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
        vertices = _smoothed(vertices, mesh.faces, int(rng.integers(0, 4)))
        vertices = vertices + rng.normal(size=vertices.shape) * 0.004 * size
    scale = float(np.exp(rng.uniform(np.log(0.3), np.log(3.0))))
    w, x, y, z = rng.normal(size=4)
    linear = scale * rotation_from_quaternion(x, y, z, w) @ linear
    shift = rng.uniform(-1, 1, 3)
    mesh_from_true = np.eye(4)
    mesh_from_true[:3, :3], mesh_from_true[:3, 3] = linear, shift - linear @ middle
    made = plain_mesh(vertices @ linear.T + shift, mesh.faces)
    return Generated(mesh=made, mesh_from_true=mesh_from_true, fate=fate)


def _invented(
    seen: Sighted, vertices: NDArray[np.float64], middle: NDArray[np.float64], rng: np.random.Generator
) -> NDArray[np.float64]:
    crop, faces = seen.made_from.crops[0], seen.mesh_world.faces
    forward, camera = crop.world_from_camera[:3, 2], crop.world_from_camera[:3, 3] - middle
    depth, rays = vertices @ forward, vertices - camera
    lengths = np.linalg.norm(rays, axis=1, keepdims=True)
    hits = Scene([_surface(vertices, faces, _OBJECT)]).cast(np.broadcast_to(camera, rays.shape), rays / lengths)
    size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    is_hidden = hits.distance_m < lengths[:, 0] - 0.02 * size
    if not is_hidden.any() or is_hidden.all():
        return vertices
    beyond = np.maximum(depth - float(np.median(depth[~is_hidden])), 0.0)
    # A wave of one to two periods over the object: lumps that are not there.
    phase, waves = rng.uniform(0, 2 * np.pi, 3), rng.uniform(2 * np.pi, 4 * np.pi, 3) / size
    lumps = 0.04 * size * np.sin(vertices * waves + phase).sum(axis=1)
    amount = is_hidden * (beyond * float(rng.uniform(-0.4, 0.4)) + lumps * beyond / max(float(beyond.max()), 1e-9))
    return vertices + amount[:, None] * forward


def _mirrored(mesh: Mesh) -> Mesh:
    return replace(mesh, vertices=mesh.vertices * np.array([-1, 1, 1], np.float32), faces=mesh.faces[:, ::-1].copy())


def _smoothed(vertices: NDArray[np.float64], faces: NDArray[np.int32], rounds: int) -> NDArray[np.float64]:
    for _ in range(rounds):
        sums, counts = np.zeros_like(vertices), np.zeros(len(vertices))
        for a in range(3):
            for b in (1, 2):
                np.add.at(sums, faces[:, a], vertices[faces[:, (a + b) % 3]])
                np.add.at(counts, faces[:, a], 1)
        vertices = vertices + 0.3 * (sums / np.maximum(counts, 1)[:, None] - vertices) * (counts > 0)[:, None]
    return vertices


def _scene(
    world: Mesh, low: NDArray[np.float64], high: NDArray[np.float64], first: float, rng: np.random.Generator
) -> Scene:
    size = float(np.linalg.norm(high - low))
    foot = np.array([*((low + high) / 2)[:2], low[2]])
    corners = np.array([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]]) + foot
    surfaces = [
        Surface(vertices=world.vertices, faces=world.faces, colors=world.colors, owner=_OBJECT),
        _surface(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32), _FLOOR),
    ]
    if rng.random() < 1 / 3:
        half = rng.uniform(0.05, 0.15, 3) * size
        toward = np.array([np.cos(first), np.sin(first), 0.0])
        aside = np.array([-toward[1], toward[0], 0.0]) * float(rng.uniform(-0.4, 0.4)) * size
        at = np.array([*((low + high) / 2)[:2], low[2] + half[2]]) + toward * 0.75 * size + aside
        box = trimesh.creation.box(2 * half)
        surfaces.append(_surface(box.vertices + at, np.asarray(box.faces), _OCCLUDER))
    return Scene(surfaces)


def _surface(vertices: NDArray[np.float64], faces: NDArray[np.int32], owner: int) -> Surface:
    return Surface(vertices=vertices, faces=faces, colors=np.full((len(vertices), 3), 90, np.uint8), owner=owner)


def _crop(scene: Scene, pose: NDArray[np.float64], rng: np.random.Generator) -> Crop | None:
    rays = backproject(np.ones(_SIZE, np.float32), _CAMERA).reshape(-1, 3) @ pose[:3, :3].T
    lengths = np.linalg.norm(rays, axis=1)
    hits = scene.cast(np.broadcast_to(pose[:3, 3], rays.shape), rays / lengths[:, None])
    mask = hits.owners.reshape(_SIZE) == _OBJECT
    if mask.sum() < _MIN_PIXELS:
        return None
    depth = (hits.distance_m / lengths).reshape(_SIZE)
    depth = np.where(np.isfinite(depth), depth, np.nan)
    depth = depth + 0.0025 * depth * depth * rng.standard_normal(_SIZE)
    depth[rng.random(_SIZE) < 0.05] = np.nan
    rows, columns = np.nonzero(mask)
    y0, y1 = max(int(rows.min()) - _MARGIN_PX, 0), min(int(rows.max()) + 1 + _MARGIN_PX, _CAMERA.height)
    x0, x1 = max(int(columns.min()) - _MARGIN_PX, 0), min(int(columns.max()) + 1 + _MARGIN_PX, _CAMERA.width)
    rgb = np.where(mask[..., None], np.uint8(170), np.uint8(90)) * np.ones(3, np.uint8)
    return Crop(
        rgb=rgb[y0:y1, x0:x1], depth_m=depth[y0:y1, x0:x1].astype(np.float32), mask=mask[y0:y1, x0:x1],
        camera=_CAMERA.cropped(x0, y0, x1, y1), world_from_camera=pose,
    )  # fmt: skip


def _looking_at(eye: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.float64]:
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.stack([right, np.cross(forward, right), forward], axis=1), eye
    return pose
