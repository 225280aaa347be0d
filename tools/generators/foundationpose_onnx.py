"""FoundationPose's two ONNX files as a refiner of poses, with crops rendered here: no CUDA is compiled, no torch."""
# The files are NVIDIA's (`nvidia/isaac/foundationpose`, NVIDIA Open Model License, commercial use allowed); names,
# shapes and scales are those of NVIDIA-ISAAC-ROS/isaac_ros_pose_estimation (Apache 2.0), which runs them.
# | what | its convention | ours |
# |---|---|---|
# | both | `input1` rendered, `input2` observed: (N, 160, 160, 6) float32, red, green, blue, x, y, z | so |
# | colour | 0..1; rendered: times 0.8 + 0.5 of how it faces the camera, 0 beside the object | so |
# | x, y, z | right, down, forward from the pose's place, in radii of the model | so |
# | | 0 where there is none, nearer than 0.1 m or beyond 2 radii | so |
# | crop | 1.2 diameters about the pose's place, 1.1 for scores, to whole pixels | so |
# | | observed at the corners of its pixels, rendered at their middles, and a pixel narrower | so |
# | refine_model | `output1` (N, 3): radii to move; `output2` (N, 3): tanh times 20 degrees, for rows | turned back |
# | score_model | `output1`: N numbers, higher is better; all poses at once, since it compares them | so |
# | model | metres, about the middle of its bounding box; a diameter is the largest distance of vertices | put back |
# | first poses | 42 directions by 6 turns, at the middle of the mask and its median depth | so |
# Its own pipeline smooths depth before it takes the first place from it; that is left out. Set up: `install
# foundationpose_onnx` beside this file; both files go into `weights/`.

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

_HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(_HERE)]

from serving import Model, NoShapeError, View, serve_poses  # noqa: E402 -- beside this script

INPUTS = ("input1", "input2")
MOVES, SCORES = ("output1", "output2"), ("output1",)
ITERATIONS = 5
# Rows are multiplied from the left there: for columns its rotation is the inverse.
TURN = -np.radians(20.0)
_SIDE = 160
_REFINE_RATIO, _SCORE_RATIO = 1.2, 1.1
_AT_ONCE = 42
_MIN_PIXELS, _NEAREST_M, _FARTHEST_RADII = 4, 0.1, 2.0
_AMBIENT, _DIFFUSE = 0.8, 0.5
_MOST_VERTICES = 5000


def load() -> tuple[Callable[[View, Model], np.ndarray], dict[str, str]]:
    """Return what finds the pose of a model in a view, and what it is."""
    import onnxruntime

    wanted = ("CUDAExecutionProvider", "CPUExecutionProvider")
    providers = [name for name in wanted if name in onnxruntime.get_available_providers()]
    refiner, scorer = (
        onnxruntime.InferenceSession(str(_HERE / "weights" / name), providers=providers)
        for name in ("refine_model.onnx", "score_model.onnx")
    )

    def place(view: View, model: Model) -> np.ndarray:
        subject, poses = subject_of(model), first_poses(view)
        for _ in range(ITERATIONS):
            parts = [poses[start : start + _AT_ONCE] for start in range(0, len(poses), _AT_ONCE)]
            poses = np.concatenate([_refined(refiner, part, subject, view) for part in parts])
        crops = _crops(poses, subject, view, _SCORE_RATIO)
        scores = np.asarray(scorer.run(SCORES, dict(zip(INPUTS, crops, strict=True)))[0]).reshape(-1)
        if len(scores) != len(poses) or not (np.isfinite(scores).all() and np.isfinite(poses).all()):
            raise NoShapeError("its networks gave no finite scores and poses")
        best = poses[scores.argmax()]
        camera_from_mesh = best.copy()
        camera_from_mesh[:3, 3] -= best[:3, :3] @ subject.middle
        return camera_from_mesh

    return place, {"model": "FoundationPose (ONNX)", "onnxruntime": str(onnxruntime.__version__)}


@dataclass(frozen=True)
class Subject:
    """A model about its `middle`: `vertices`, `colors` in 0..1 and `normals` (V, 3), `faces` (F, 3); its `scene`."""

    vertices: np.ndarray
    faces: np.ndarray
    colors: np.ndarray
    normals: np.ndarray
    middle: np.ndarray
    diameter_m: float
    scene: Any


def subject_of(model: Model) -> Subject:
    """Return a model as it is rendered."""
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    own = np.asarray(model.vertices, dtype=np.float64)
    middle = (own.min(axis=0) + own.max(axis=0)) / 2
    vertices, faces = own - middle, np.asarray(model.faces)
    scene = EmbreeScene(robust=True)
    TriangleMesh(scene, vertices.astype(np.float32), faces.astype(np.int32))
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    normals = np.zeros_like(vertices)
    for i in range(3):
        np.add.at(normals, faces[:, i], np.cross(b - a, c - a))
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    colors = np.full(vertices.shape, 0.5) if model.colors is None else np.asarray(model.colors) / 255
    return Subject(vertices, faces, colors, normals, middle, _diameter_m(vertices), scene)


def _diameter_m(vertices: np.ndarray) -> float:
    some = vertices[:: -(-len(vertices) // _MOST_VERTICES)]
    squares = (some**2).sum(axis=1)
    blocks = [(some[i : i + 500], squares[i : i + 500]) for i in range(0, len(some), 500)]
    most = max((own[:, None] + squares - 2 * part @ some.T).max() for part, own in blocks)
    return float(np.sqrt(max(most, 1e-12)))


def first_poses(view: View) -> np.ndarray:
    """Return (N, 4, 4) camera_from_model: turned every way, at the middle of the mask; raises NoShapeError."""
    depths = view.depth_m[view.mask & (view.depth_m >= _NEAREST_M)]
    if len(depths) < _MIN_PIXELS:
        raise NoShapeError(f"fewer than {_MIN_PIXELS} pixels of the mask have depth")
    rows, columns = np.nonzero(view.mask)
    middle = np.array([columns.min() + columns.max(), rows.min() + rows.max(), 2]) / 2
    turns = rotations()
    poses = np.tile(np.eye(4), (len(turns), 1, 1))
    poses[:, :3, :3] = turns
    poses[:, :3, 3] = np.linalg.inv(view.K) @ middle * np.median(depths)
    return poses


def rotations() -> np.ndarray:
    """Return (252, 3, 3): the corners and edges of an icosahedron, looked at with 6 turns of the camera."""
    golden = (1 + np.sqrt(5)) / 2
    short = np.array([[0, i, j * golden] for i in (-1, 1) for j in (-1, 1)])
    corners = np.concatenate([np.roll(short, shift, axis=1) for shift in range(3)])
    near = np.abs(np.linalg.norm(corners[:, None] - corners, axis=2) - 2) < 1e-6
    first, second = np.nonzero(np.triu(near))
    turns = [rotation_of(np.array([0.0, 0.0, angle])) for angle in np.radians(np.arange(0, 360, 60))]
    found: list[np.ndarray] = []
    for point in np.concatenate([corners, corners[first] + corners[second]]):
        forward = -point / np.linalg.norm(point)
        right = np.cross([0.0, 0.0, 1.0], forward)
        right = right / np.linalg.norm(right) if right.any() else np.array([1.0, 0.0, 0.0])
        model_from_camera = np.column_stack([right, np.cross(forward, right), forward])
        found += [(model_from_camera @ turn).T for turn in turns]
    return np.array(found)


def rotation_of(vector: np.ndarray) -> np.ndarray:
    """Return the rotation (3, 3) of a rotation vector in radians."""
    angle = np.linalg.norm(vector)
    x, y, z = vector / max(angle, 1e-12)
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * across + (1 - np.cos(angle)) * across @ across


def _refined(refiner: Any, poses: np.ndarray, subject: Subject, view: View) -> np.ndarray:
    crops = _crops(poses, subject, view, _REFINE_RATIO)
    moves, turns = refiner.run(MOVES, dict(zip(INPUTS, crops, strict=True)))
    found = poses.copy()
    for pose, move, turn in zip(found, moves, turns, strict=True):
        pose[:3, :3] = rotation_of(TURN * np.tanh(turn.astype(np.float64))) @ pose[:3, :3]
        pose[:3, 3] += move * subject.diameter_m / 2
    return found


def _crops(poses: np.ndarray, subject: Subject, view: View, ratio: float) -> tuple[np.ndarray, np.ndarray]:
    points = np.nan_to_num(view.points())
    rendered, observed = [], []
    for pose in poses:
        window = _window(pose, subject.diameter_m * ratio / 2, view.K)
        rendered.append(six_channels(*_rendered(pose, subject, window, view.K), pose, subject))
        observed.append(six_channels(*_observed(view.rgb, points, window), pose, subject))
    return np.stack(rendered), np.stack(observed)


def six_channels(color: np.ndarray, xyz: np.ndarray, pose: np.ndarray, subject: Subject) -> np.ndarray:
    """Return (160, 160, 6) float32: the colours, and the points from the pose's place in radii of the model."""
    radii = (xyz - pose[:3, 3]) / (subject.diameter_m / 2)
    is_none = (xyz[..., 2] < _NEAREST_M) | (np.abs(radii) > _FARTHEST_RADII).any(axis=-1)
    radii[is_none] = 0
    return np.concatenate([color, radii], axis=-1).astype(np.float32)


def _window(pose: np.ndarray, reach_m: float, K: np.ndarray) -> np.ndarray:
    z = max(pose[2, 3], _NEAREST_M)
    middle = (K @ np.append(pose[:2, 3] / z, 1))[:2]
    reach = reach_m / z * max(K[0, 0], K[1, 1])
    low, high = np.round(middle - reach), np.round(middle + reach)
    return np.concatenate([low, np.maximum(high, low + 1)])


def _rendered(pose: np.ndarray, subject: Subject, window: np.ndarray, K: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    steps = (np.arange(_SIDE) + 0.5) * (_SIDE - 1) / _SIDE**2
    x = (window[0] + steps * (window[2] - window[0]) - K[0, 2]) / K[0, 0]
    y = (window[1] + steps * (window[3] - window[1]) - K[1, 2]) / K[1, 1]
    rays = np.stack([*np.meshgrid(x, y), np.ones((_SIDE, _SIDE))], axis=-1).reshape(-1, 3)
    rotation, place = pose[:3, :3], pose[:3, 3]
    origins = np.broadcast_to((-rotation.T @ place).astype(np.float32), rays.shape)
    found = subject.scene.run(
        np.ascontiguousarray(origins), (rays @ rotation).astype(np.float32), dists=np.inf, query="INTERSECT",
        output=True,
    )  # fmt: skip
    hit = np.flatnonzero(found["primID"] >= 0)
    u, v = found["u"][hit, None], found["v"][hit, None]
    corners = subject.faces[found["primID"][hit]]
    facing = np.maximum(-subject.normals @ rotation[2], 0)
    shaded = np.column_stack([subject.colors, facing])
    first, second, third = (shaded[corners[:, i]] for i in range(3))
    inside = (1 - u - v) * first + u * second + v * third
    color, xyz = np.zeros_like(rays), np.zeros_like(rays)
    color[hit] = np.clip(inside[:, :3] * (_AMBIENT + _DIFFUSE * inside[:, 3:]), 0, 1)
    xyz[hit] = rays[hit] * found["tfar"][hit, None]
    return color.reshape(_SIDE, _SIDE, 3), xyz.reshape(_SIDE, _SIDE, 3)


def _observed(rgb: np.ndarray, points: np.ndarray, window: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    import cv2

    (scale_x, scale_y), (left, top) = _SIDE / (window[2:] - window[:2]), window[:2]
    crop_from_image = np.array([[scale_x, 0, -scale_x * left], [0, scale_y, -scale_y * top]])
    color = cv2.warpAffine(rgb, crop_from_image, (_SIDE, _SIDE), flags=cv2.INTER_LINEAR)
    xyz = cv2.warpAffine(points, crop_from_image, (_SIDE, _SIDE), flags=cv2.INTER_NEAREST)
    return color / 255, xyz


if __name__ == "__main__":
    serve_poses(load)
