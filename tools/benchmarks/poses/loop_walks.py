"""Whole logs through rooms that look alike, played as `play` does: the accepted loops, right and wrong."""
# Four like rooms in a row, then back to one or into a fifth; odometry drifts. Small images are cast from boxes.

import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.config_text import read_config
from hickory_stream.box_scene import PERIOD_NS, START_NS, SceneBox, SceneSource, cast_scene
from hickory_stream.config import MapperConfig
from hickory_stream.events import KeyframeKeptOut, LoopsSearched
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import compose, invert
from hickory_stream.journal.reader import Journal
from hickory_stream.map_folder.saved_map import open_map
from tools.benchmarks.common.cached_runs import cached, play_into, state_folder
from tools.benchmarks.common.figures import Figure, Options, figure, share
from tools.benchmarks.common.intervals import wilson
from tools.benchmarks.common.processes import NO_SHAPES
from tools.benchmarks.poses.drift_logs import Poses
from tools.benchmarks.poses.loops import is_near
from tools.evaluation.simulated_maps.moved_source import MovedSource
from tools.worlds.drift import drift_of, drifted_poses

_CAMERA = Camera(width=160, height=120, fx=90.0, fy=90.0, cx=79.5, cy=59.5)
_NUM_ROOMS, _PITCH_M, _DEPTH_M, _WALL_M, _HIGH_M = 4, 4.1, 3.2, 0.1, 2.4
_DOOR_M = (1.1, 2.1)
_EYE_M, _DOWN = 1.3, 0.25
_STEP_M, _STEP_RAD = 0.3, np.radians(20.0)
_NUM_WALKS, _QUICK_WALKS = 8, 2
_CONFIG = (NO_SHAPES, "journal.keep_images=false", "mapping.submaps.travel_m=5")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Walk:
    """Boxes of rooms, the true poses (N, 4, 4) of a walk through them, and those of its odometry."""

    boxes: tuple[SceneBox, ...]
    true: NDArray[np.float64]
    odometry: NDArray[np.float64]
    returns: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class Closed:
    """The loops of a run: those that its graph accepts, right and wrong, the rejected ones; keyframes kept out."""

    right: int
    wrong: int
    rejected: int
    kept_out: int


def walk_figures(options: Options) -> list[Figure]:
    """Return how many loops of whole logs are wrong, and in how many walks that come back one is found."""
    # The result of a walk is cached under `--state`; a later call continues.
    folder = state_folder(options.state, "walks")
    num_walks = _QUICK_WALKS if options.quick else _NUM_WALKS
    walks = [_walk(options.seed, i) for i in range(num_walks)]
    found = []
    for i, walk in enumerate(walks):
        found.append(Closed(**cached(folder / f"{options.seed}-{i}.json", lambda walk=walk: asdict(_closed(walk)))))
        print(f"walk {i}, {'comes back' if walk.returns else 'goes on'}: {found[-1]}", flush=True)
    wrong, accepted = sum(each.wrong for each in found), sum(each.wrong + each.right for each in found)
    back = [each.right > 0 for each, walk in zip(found, walks, strict=True) if walk.returns]
    of = f"{wrong} of {accepted} believed, in {num_walks} logs through rooms that look alike"
    interval = wilson(wrong, accepted) if accepted else None
    more = {"interval": interval, "interval_by": "of the believed, Wilson"}
    return [
        figure("wrong_loops_played", wrong, "", "lower", of, **more),
        *share("loops_played_found", sum(back), len(back), "logs that come back"),
    ]


def _closed(walk: Walk) -> Closed:
    with tempfile.TemporaryDirectory() as temporary:
        out = Path(temporary) / "map"
        odometry = {START_NS + i * PERIOD_NS: pose for i, pose in enumerate(walk.odometry)}
        moved = MovedSource(_Cast(walk), lambda raw: odometry[raw.stamp_ns])
        play_into(out, moved, read_config(MapperConfig, None, _CONFIG))
        return closed_loops(out, {START_NS + i * PERIOD_NS: pose for i, pose in enumerate(walk.true)})


def closed_loops(out: Path, true: Poses) -> Closed:
    """Return the loops of a map, compared with the true poses of its log."""
    graph = open_map(out).snapshot.graph
    with Journal(out) as journal:
        events = [event for entry in journal.entries() for event in entry.events]
    kept_out = sum(isinstance(event, KeyframeKeptOut) for event in events)
    if graph is None:
        return Closed(right=0, wrong=0, rejected=0, kept_out=kept_out)
    loops = {(o.earlier, o.later): o for e in events if isinstance(e, LoopsSearched) for o in e.loops}
    anchors = {node.submap_id: (node.uncorrected, true[node.stamp_ns]) for node in graph.nodes}
    is_right = []
    for edge in graph.loops:
        if edge.status == "accepted":
            (a, true_a), (b, true_b) = anchors[edge.earlier], anchors[edge.later]
            found = compose(invert(a), loops[edge.earlier, edge.later].earlier_from_later, b)
            is_right.append(is_near(compose(invert(found), invert(true_a), true_b)))
    right, rejected = sum(is_right), len(graph.loops) - len(is_right)
    return Closed(right=right, wrong=len(is_right) - right, rejected=rejected, kept_out=kept_out)


def _walk(seed: int, number: int) -> Walk:
    rng = np.random.default_rng((seed, 22, number))
    returns = number % 2 == 0
    boxes = [box for room in range(_NUM_ROOMS + 1) for box in _walls(room)]
    # Four like cupboards along the wall of a room, a step of 0.9 m from one to the next.
    row = [_box((0.3 + 0.9 * i, 2.75), (0.9 + 0.9 * i, 3.15), 0.9, (150, 110, 70)) for i in range(4)]
    shared = [_piece(rng) for _ in range(2)]
    for room in range(_NUM_ROOMS + 1):
        own = [_piece(rng)] if number % 4 < 2 else []
        boxes += [_at(room, piece) for piece in (*row, *shared, *own)]
    last = int(rng.integers(0, _NUM_ROOMS - 1)) if returns else _NUM_ROOMS
    true = _poses([*range(_NUM_ROOMS), last])
    odometry = drifted_poses(true, drift_of(1.0 if number % 3 else 3.0), rng)
    return Walk(boxes=tuple(boxes), true=true, odometry=odometry, returns=returns)


def _box(low: tuple[float, float], high: tuple[float, float], height: float, rgb: tuple[int, int, int]) -> SceneBox:
    return SceneBox(low=(*low, 0.0), high=(*high, height), rgb=rgb)


def _walls(room: int) -> list[SceneBox]:
    x, end, grey = _PITCH_M * room, _PITCH_M * (room + 1), (170, 168, 160)
    sides = [
        ((x, -_WALL_M), (end, 0.0)),
        ((x, _DEPTH_M), (end, _DEPTH_M + _WALL_M)),
        ((x - _WALL_M, 0.0), (x, _DOOR_M[0])),
        ((x - _WALL_M, _DOOR_M[1]), (x, _DEPTH_M)),
    ]
    sides += [((end - _WALL_M, 0.0), (end, _DEPTH_M))] if room == _NUM_ROOMS else []
    return [_box(low, high, _HIGH_M, grey) for low, high in sides]


def _piece(rng: np.random.Generator) -> SceneBox:
    x, width, depth, height = rng.uniform(0.3, 3.2), *rng.uniform(0.3, 0.6, 2), rng.uniform(0.3, 0.9)
    red, green, blue = (int(c) for c in rng.integers(60, 200, 3))
    y = float(rng.uniform(0.1, 0.9 - depth))
    return _box((float(x), y), (float(x + width), y + float(depth)), float(height), (red, green, blue))


def _at(room: int, box: SceneBox) -> SceneBox:
    shift = _PITCH_M * room
    return replace(box, low=(box.low[0] + shift, *box.low[1:]), high=(box.high[0] + shift, *box.high[1:]))


def _poses(rooms: Sequence[int]) -> NDArray[np.float64]:
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
    pose[:3, :3], pose[:3, 3] = np.stack([right, np.cross(forward, right), forward], axis=1), (x, y, _EYE_M)
    return pose


class _Cast(SceneSource):
    def __init__(self, walk: Walk) -> None:
        super().__init__(len(walk.true), walk.boxes, camera=_CAMERA)
        self._true = walk.true

    def cast(self, step: int) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.int32]]:
        rgb, depth_m, instances = cast_scene(self._boxes, _CAMERA, self._true[step])
        noise = np.random.default_rng(step).standard_normal(depth_m.shape)
        depth_m = (depth_m + 0.002 * depth_m * depth_m * noise).astype(np.float32)
        depth_m[depth_m > 6.0] = np.nan
        return rgb, depth_m, instances
