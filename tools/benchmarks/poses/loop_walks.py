"""Whole logs through rooms that look alike, played as `play` does: the loops that are believed, right and wrong.

Four rooms in a row have one floor plan and one set of furniture, with a row of like cupboards along a wall. The robot
looks round in each, and then goes back to one of them, or into a fifth that is like them; its odometry drifts. The
images are cast from boxes, small, so that many walks are played.
"""

from __future__ import annotations

import asyncio
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hickory_stream.box_scene import PERIOD_NS, START_NS, SceneBox, cast_scene
from hickory_stream.config import MapperConfig
from hickory_stream.config_text import read_config
from hickory_stream.engine.journal import Journal
from hickory_stream.engine.mapper import Mapper
from hickory_stream.engine.saved_map import open_map
from hickory_stream.events import LoopsSearched
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import compose, invert, rotation_angle_rad
from hickory_stream.records import Frame, RawFrame, SourceInfo
from hickory_stream.worlds.drift import drifted
from hickory_stream.worlds.trajectory import Trajectory
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.common.intervals import wilson
from tools.benchmarks.common.kept import kept, state_folder
from tools.benchmarks.poses.drift_logs import drift_of

_CAMERA = Camera(width=160, height=120, fx=90.0, fy=90.0, cx=79.5, cy=59.5)
_NUM_ROOMS, _PITCH_M, _DEPTH_M, _WALL_M = 4, 4.1, 3.2, 0.1
_DOOR_M = (1.1, 2.1)
_EYE_M, _DOWN = 1.3, 0.25
_STEP_M, _STEP_RAD = 0.3, np.radians(20.0)
_WRONG_M, _WRONG_RAD = 0.3, 0.1
_CONFIG = ("mapping.requests.max_failures=0", "journal.keep_images=false", "mapping.submaps.travel_m=5")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Walk:
    """Boxes of rooms, the true poses (N, 4, 4) of a walk through them, and those of its odometry."""

    boxes: tuple[SceneBox, ...]
    true: NDArray[np.float64]
    odometry: NDArray[np.float64]
    returns: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class Closed:
    """The loops of a run: those that its graph believes, by whether they are right, and those that it does not."""

    right: int
    wrong: int
    rejected: int


def walk_figures(options: Options, num_walks: int) -> list[Figure]:
    """Return how many loops of whole logs are wrong, and in how many walks that come back one is found.

    What a walk gave is kept under `--state`; a later call goes on.
    """
    folder = state_folder(options.state, "walks")
    walks = [_walk(options.seed, i) for i in range(num_walks)]
    found = []
    for i, walk in enumerate(walks):
        found.append(Closed(**kept(folder / f"{options.seed}-{i}.json", lambda walk=walk: asdict(played(walk)))))
        back = "comes back" if walk.returns else "goes on"
        print(f"walk {i}, {back}: {found[-1]}", flush=True)
    wrong, believed = sum(each.wrong for each in found), sum(each.wrong + each.right for each in found)
    back = [each.right > 0 for each, walk in zip(found, walks, strict=True) if walk.returns]
    return [
        figure(
            "wrong_loops_played",
            wrong,
            "",
            "lower",
            f"{wrong} of {believed} believed, in {num_walks} logs through rooms that look alike",
            interval=wilson(wrong, believed) if believed else None,
            interval_by="of the believed, Wilson",
        ),
        figure(
            "loops_played_found",
            sum(back) / len(back),
            "",
            "higher",
            f"{sum(back)} of {len(back)} logs that come back",
            interval=wilson(sum(back), len(back)),
            interval_by="Wilson",
        ),
    ]


def played(walk: Walk) -> Closed:
    """Return what a run makes of a walk, layer 1 alone."""
    with tempfile.TemporaryDirectory() as temporary:
        out = Path(temporary) / "map"
        asyncio.run(_map(_BoxSource(walk), read_config(MapperConfig, None, _CONFIG), out))
        graph = open_map(out).snapshot.graph
        with Journal(out) as journal:
            events = [event for entry in journal.entries() for event in entry.events]
    if graph is None:
        return Closed(right=0, wrong=0, rejected=0)
    loops = {(o.earlier, o.later): o for e in events if isinstance(e, LoopsSearched) for o in e.loops}
    true = {START_NS + i * PERIOD_NS: pose for i, pose in enumerate(walk.true)}
    anchors = {node.submap_id: (node.uncorrected, true[node.stamp_ns]) for node in graph.nodes}
    right = wrong = 0
    for edge in graph.loops:
        if edge.status == "accepted":
            (a, true_a), (b, true_b) = anchors[edge.earlier], anchors[edge.later]
            told = compose(invert(a), loops[edge.earlier, edge.later].earlier_from_later, b)
            step = compose(invert(told), compose(invert(true_a), true_b))
            is_right = np.linalg.norm(step[:3, 3]) < _WRONG_M and rotation_angle_rad(step[:3, :3]) < _WRONG_RAD
            right, wrong = right + bool(is_right), wrong + (not is_right)
    return Closed(right=right, wrong=wrong, rejected=len(graph.loops) - right - wrong)


def _walk(seed: int, number: int) -> Walk:
    """Return a seeded walk: every second one comes back; drift is the default or three times it in turn."""
    rng = np.random.default_rng((seed, 22, number))
    returns = number % 2 == 0
    boxes = [box for room in range(_NUM_ROOMS + 1) for box in _walls(room)]
    shared = [_piece(rng) for _ in range(2)]
    for room in range(_NUM_ROOMS + 1):
        own = [_piece(rng)] if number % 4 < 2 else []
        boxes += [_at(room, piece) for piece in (*_row(), *shared, *own)]
    last = int(rng.integers(0, _NUM_ROOMS - 1)) if returns else _NUM_ROOMS
    true = _poses([*range(_NUM_ROOMS), last])
    trajectory = Trajectory(times_s=np.arange(len(true)) * PERIOD_NS / 1e9, world_from_camera=true)
    odometry = drifted(trajectory, drift_of(1.0 if number % 3 else 3.0), rng).world_from_camera
    return Walk(boxes=tuple(boxes), true=true, odometry=odometry, returns=returns)


def _walls(room: int) -> list[SceneBox]:
    """Return the walls of a room but the one that the next room has."""
    x, end, grey = _PITCH_M * room, _PITCH_M * (room + 1), (170, 168, 160)
    sides = [
        SceneBox(low=(x, -_WALL_M, 0.0), high=(end, 0.0, 2.4), rgb=grey),
        SceneBox(low=(x, _DEPTH_M, 0.0), high=(end, _DEPTH_M + _WALL_M, 2.4), rgb=grey),
        SceneBox(low=(x - _WALL_M, 0.0, 0.0), high=(x, _DOOR_M[0], 2.4), rgb=grey),
        SceneBox(low=(x - _WALL_M, _DOOR_M[1], 0.0), high=(x, _DEPTH_M, 2.4), rgb=grey),
    ]
    if room == _NUM_ROOMS:
        sides.append(SceneBox(low=(end - _WALL_M, 0.0, 0.0), high=(end, _DEPTH_M, 2.4), rgb=grey))
    return sides


def _row() -> list[SceneBox]:
    """Return four like cupboards along the wall of a room, a step of 0.9 m from one to the next."""
    places = [0.3 + 0.9 * i for i in range(4)]
    return [SceneBox(low=(x, 2.75, 0.0), high=(x + 0.6, 3.15, 0.9), rgb=(150, 110, 70)) for x in places]


def _piece(rng: np.random.Generator) -> SceneBox:
    """Return a piece of furniture beside the way, in the frame of its room."""
    x, width, depth, height = rng.uniform(0.3, 3.2), *rng.uniform(0.3, 0.6, 2), rng.uniform(0.3, 0.9)
    rgb = tuple(int(c) for c in rng.integers(60, 200, 3))
    y = float(rng.uniform(0.1, 0.9 - depth))
    return SceneBox(low=(float(x), y, 0.0), high=(float(x + width), y + float(depth), float(height)), rgb=rgb)


def _at(room: int, box: SceneBox) -> SceneBox:
    (x0, y0, z0), (x1, y1, z1), shift = box.low, box.high, _PITCH_M * room
    return SceneBox(low=(x0 + shift, y0, z0), high=(x1 + shift, y1, z1), rgb=box.rgb)


def _poses(rooms: Sequence[int]) -> NDArray[np.float64]:
    """Return poses (N, 4, 4) of a camera that goes from one room's middle to the next one's, and looks round there."""
    y, poses = 0.5 * sum(_DOOR_M), []
    x, heading = _PITCH_M * rooms[0] + 2.0, 0.0
    for room in rooms:
        goal = _PITCH_M * room + 2.0
        towards = 0.0 if goal >= x else np.pi
        while abs(heading - towards) > 1e-9:
            heading += float(np.clip(towards - heading, -_STEP_RAD, _STEP_RAD))
            poses.append(_looking(x, y, heading))
        while abs(goal - x) > 1e-9:
            x += float(np.clip(goal - x, -_STEP_M, _STEP_M))
            poses.append(_looking(x, y, heading))
        poses += [_looking(x, y, heading + i * _STEP_RAD) for i in range(1, 19)]
    return np.array(poses)


def _looking(x: float, y: float, heading: float) -> NDArray[np.float64]:
    forward = np.array([np.cos(heading), np.sin(heading), -_DOWN])
    forward /= np.linalg.norm(forward)
    right = np.array([np.sin(heading), -np.cos(heading), 0.0])
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    pose[:3, 3] = (x, y, _EYE_M)
    return pose


async def _map(source: _BoxSource, config: MapperConfig, out: Path) -> None:
    async with Mapper(config, out=out) as mapper:
        async for _ in mapper.run(source):
            pass


class _BoxSource:
    """The frames of a walk, cast from boxes, at the poses of its odometry."""

    def __init__(self, walk: Walk) -> None:
        self._walk = walk

    @property
    def info(self) -> SourceInfo:
        """What there is to play."""
        num_frames = len(self._walk.true)
        return SourceInfo(
            uri="memory:rooms",
            kind="synthetic scene",
            identity=f"rooms-{num_frames}",
            camera=_CAMERA,
            num_frames=num_frames,
            start_ns=START_NS,
            end_ns=START_NS + (num_frames - 1) * PERIOD_NS,
            streams=(("color", "cast"), ("depth", "cast"), ("pose", "drifting")),
        )

    def frames(self) -> Iterator[RawFrame]:
        """Yield the frames."""
        for i, pose in enumerate(self._walk.odometry):
            yield RawFrame(
                index=i,
                stamp_ns=START_NS + i * PERIOD_NS,
                camera=_CAMERA,
                world_from_camera=pose,
                decode=partial(self._decode, i),
            )

    def ledger(self) -> Mapping[str, int]:
        """Return how many frames there are."""
        return {"frames": len(self._walk.true)}

    def close(self) -> None:
        """Nothing is held."""

    def _decode(self, index: int) -> Frame:
        rgb, depth_m, _ = cast_scene(self._walk.boxes, _CAMERA, self._walk.true[index])
        noise = np.random.default_rng(index).standard_normal(depth_m.shape)
        depth_m = (depth_m + 0.002 * depth_m * depth_m * noise).astype(np.float32)
        depth_m[depth_m > 6.0] = np.nan
        return Frame(
            index=index,
            stamp_ns=START_NS + index * PERIOD_NS,
            rgb=rgb,
            depth_m=depth_m,
            camera=_CAMERA,
            world_from_camera=self._walk.odometry[index],
        )
