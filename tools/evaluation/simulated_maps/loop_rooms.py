"""Rooms in a row that look alike, as the surfaces of submaps, and a robot that comes back to one, or does not."""
# The rooms have one floor plan and one set of furniture, of which none, or one piece a room, differs. The robot's
# odometry drifts by more than the pose graph assumes. Nothing here shares code with the search.

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.rigid import from_rotation_translation, yaw_rotation

STEP_M = 0.08
_NUM_ROOMS, _PITCH_M = 4, 5.0
_WIDTH_M, _DEPTH_M, _HEIGHT_M = 4.0, 3.0, 2.0
_WORSE = 1.5
"""The odometry errs by so many times the sigma that the graph assumes."""

Patch = tuple["NDArray[np.float64]", "NDArray[np.float64]"]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SeenRoom:
    """A submap: `points` and `normals` (N, 3) as the odometry has them, `odometry_from_world` (4, 4), and its node."""

    # `room` is the number of the room that it shows, `way_m` the length of the way in it.
    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    odometry_from_world: NDArray[np.float64]
    anchor: NDArray[np.float64]
    room: int
    way_m: float


def patch(corner: list[float], u: list[float], v: list[float], normal: list[float]) -> Patch:
    along, across = np.array(u), np.array(v)
    counts = [max(2, round(float(np.linalg.norm(side)) / STEP_M)) for side in (along, across)]
    s, t = (grid.ravel() for grid in np.meshgrid(*(np.linspace(0, 1, n, endpoint=False) for n in counts)))
    points = np.array(corner) + s[:, None] * along + t[:, None] * across
    return points, np.tile(normal, (len(points), 1)).astype(float)


def box(x: float, y: float, side: float, height: float) -> list[Patch]:
    """Return the four sides and the top of a box on the floor."""
    return [
        patch([x, y, 0], [side, 0, 0], [0, 0, height], [0, -1, 0]),
        patch([x, y + side, 0], [side, 0, 0], [0, 0, height], [0, 1, 0]),
        patch([x, y, 0], [0, side, 0], [0, 0, height], [-1, 0, 0]),
        patch([x + side, y, 0], [0, side, 0], [0, 0, height], [1, 0, 0]),
        patch([x, y, height], [side, 0, 0], [0, side, 0], [0, 0, 1]),
    ]


def bare_room(x: float, width: float = _WIDTH_M, depth: float = _DEPTH_M) -> list[Patch]:
    """Return a floor and four walls, seen from inside, from x on."""
    return [
        patch([x, 0, 0], [width, 0, 0], [0, depth, 0], [0, 0, 1]),
        patch([x, 0, 0], [width, 0, 0], [0, 0, _HEIGHT_M], [0, 1, 0]),
        patch([x, depth, 0], [width, 0, 0], [0, 0, _HEIGHT_M], [0, -1, 0]),
        patch([x, 0, 0], [0, depth, 0], [0, 0, _HEIGHT_M], [1, 0, 0]),
        patch([x + width, 0, 0], [0, depth, 0], [0, 0, _HEIGHT_M], [-1, 0, 0]),
    ]


def walk(rng: np.random.Generator, *, sigma_m: float, sigma_rad: float, returns: bool, differs: bool) -> list[SeenRoom]:
    """Return the submaps of a walk through all rooms and then into one of them, or into a further one like them."""
    # `sigma_m` and `sigma_rad`: the graph's assumption of the error from room to room; `returns`: the last room was
    # visited before; `differs`: each room has a piece of its own.
    shared = [_piece(rng) for _ in range(3)]
    own = [_piece(rng) if differs else None for _ in range(_NUM_ROOMS + 1)]
    last = int(rng.integers(0, _NUM_ROOMS - 1)) if returns else _NUM_ROOMS
    seen, drift = [], np.eye(4)
    for step, room in enumerate([*range(_NUM_ROOMS), last]):
        rooms_passed = 1 if step < _NUM_ROOMS else abs(_NUM_ROOMS - 1 - last) or 1
        if step:
            scale = _WORSE * np.sqrt(rooms_passed)
            drift = drift @ _motion(rng, scale * sigma_m, scale * sigma_rad, about_x_m=_PITCH_M * room)
        pieces = [piece for piece in (*shared, own[room]) if piece is not None]
        seen.append(_seen(rng, room, pieces, drift, _PITCH_M * rooms_passed))
    return seen


def _piece(rng: np.random.Generator) -> tuple[float, float, float, float]:
    side = float(rng.uniform(0.4, 0.9))
    x, y = rng.uniform(0.2, _WIDTH_M - 0.2 - side), rng.uniform(0.2, _DEPTH_M - 0.2 - side)
    return float(x), float(y), side, float(rng.uniform(0.3, 1.6))


def _seen(
    rng: np.random.Generator, room: int, pieces: list[tuple[float, ...]], drift: NDArray[np.float64], way_m: float
) -> SeenRoom:
    x0 = _PITCH_M * room
    patches = bare_room(x0)
    for x, y, side, height in pieces:
        patches += box(x0 + x, y, side, height)
    points, normals = (np.concatenate(parts) for parts in zip(*patches, strict=True))
    # One side of the room is not seen, another one each time.
    facing = rng.normal(size=3) * (1, 1, 0)
    middle = np.array([x0 + _WIDTH_M / 2, _DEPTH_M / 2, 0])
    is_seen = (points - middle) @ (facing / np.linalg.norm(facing)) < 0.9
    points = points[is_seen] + rng.normal(0, 0.01, (int(is_seen.sum()), 3)) + rng.uniform(0, 0.3 * STEP_M, 3)
    anchor = np.eye(4)
    anchor[:2, 3], anchor[2, 3] = middle[:2], 1.2
    return SeenRoom(
        points=points @ drift[:3, :3].T + drift[:3, 3], normals=normals[is_seen] @ drift[:3, :3].T,
        odometry_from_world=drift, anchor=drift @ anchor, room=room, way_m=way_m,
    )  # fmt: skip


def _motion(rng: np.random.Generator, sigma_m: float, sigma_rad: float, *, about_x_m: float) -> NDArray[np.float64]:
    turn = yaw_rotation(rng.normal(0, sigma_rad))
    place = np.array([about_x_m, 1.5, 0.0])
    return from_rotation_translation(turn, place - turn @ place + np.array([*rng.normal(0, sigma_m, 2), 0.0]))
