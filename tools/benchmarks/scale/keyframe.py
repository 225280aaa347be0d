"""The cost of a keyframe in a map of so many objects: one recorded walk, again and again, in a grid of rooms."""
# The core gets the events of a short run room after room, each `pitch_m` further; journal, checkpoints and map folder
# are written, views as empty files. Shapes are those of the run. Perception only asks for its prior.

import argparse
import itertools
import os
import shutil
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from hickory_stream.base.json_text import dumps
from hickory_stream.config import MapperConfig
from hickory_stream.events import (
    CancelShape,
    ComputeFeatures,
    DropView,
    Effect,
    Event,
    FeaturesReady,
    FrameObserved,
    KeepView,
    LoopsSearched,
    Publish,
    RequestShape,
    SearchLoops,
    ShapeReady,
)
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.journal.reader import Journal
from hickory_stream.journal.step import Checkpoint, FramePose, JournalEntry, OpenJob, Step, StepKind, Told
from hickory_stream.journal.writer import JournalWriter
from hickory_stream.map_folder.array_spill import FarArrays
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.map_folder.views import crop_files
from hickory_stream.map_folder.writer import create_map_folder
from hickory_stream.mapping.core import MapperCore
from hickory_stream.mapping.entities.rigid_motion import moved_box, moved_shape
from hickory_stream.records import MapSnapshot, MaskFeature, ObjectShape
from hickory_stream.sinks.disk_sink import DiskSinkConfig
from tools.benchmarks.common.processes import folder_mb, json_of, resident_mb

Features = dict[int, MaskFeature]
"""The features of a keyframe by the number of their observation."""

_PITCH_M = 12.75
"""From room to room: a multiple of both lattices and of the step of points: a room further on is the same room."""
_ROOMS_WIDE = 8
_EVERY = 2
# Objects in the smaller map, and the keyframes of a room that count.
_FEW, _FIRST, _LAST = 50, 3, 23
# Measured besides the work of a run.
_ONE = "save of one keyframe"


@dataclass(frozen=True, kw_only=True)
class Walk:
    """A recorded walk through one room: its keyframes with the features of their masks, and the shapes of its map."""

    keyframes: tuple[tuple[FrameObserved, Features], ...]
    shapes: tuple[ObjectShape, ...]
    camera: Camera
    num_frames: int
    meshes: Path

    @property
    def first_ns(self) -> int:
        return self.keyframes[0][0].stamp_ns

    @property
    def length_m(self) -> float:
        eyes = np.array([event.world_from_camera[:3, 3] for event, _ in self.keyframes])
        return float(np.linalg.norm(np.diff(eyes, axis=0), axis=1).sum())

    @cached_property
    def pitch_m(self) -> float:
        boxes = [one.box.corners_world()[:, :2] for event, _ in self.keyframes for one in event.observations]
        return _PITCH_M * float(np.ceil(np.ptp(np.concatenate(boxes), axis=0).max() / _PITCH_M))


def read_walk(folder: Path) -> Walk:
    keyframes: list[FrameObserved] = []
    features: defaultdict[int, Features] = defaultdict(dict)
    shapes: list[ObjectShape] = []
    with Journal(folder) as journal:
        for event in (event for entry in journal.entries() for event in entry.events):
            if isinstance(event, FrameObserved):
                keyframes.append(event)
            elif isinstance(event, FeaturesReady):
                features[event.frame_index] |= {one.observation_index: one for one in event.features}
            elif isinstance(event, ShapeReady):
                shapes.append(event.shape)
        camera = journal.step(0).camera
    return Walk(
        keyframes=tuple((event, features[event.frame_index]) for event in keyframes[::_EVERY]), shapes=tuple(shapes),
        camera=camera, num_frames=keyframes[-1].frame_index + 1, meshes=folder / "shapes",
    )  # fmt: skip


def keyframes_in(walk: Walk, room: int) -> Iterator[tuple[FrameObserved, Features]]:
    # To and fro, so that the path from room to room is short.
    row, column = divmod(room, _ROOMS_WIDE)
    column = column if row % 2 == 0 else _ROOMS_WIDE - 1 - column
    off = np.array([column, row, 0.0]) * walk.pitch_m
    there = from_rotation_translation(np.eye(3), off)
    length_ns = walk.keyframes[-1][0].stamp_ns - walk.first_ns + 300_000_000
    by_x, by_y = (int(cells) for cells in np.round(off[:2] / 0.05))
    # A key has the cell's coordinates in fields of 21 bits, x in the upper one.
    step = np.int64((by_x << 42) + (by_y << 21))
    for event, features in walk.keyframes:
        pose, space = event.world_from_camera.copy(), event.space
        pose[:3, 3] += off
        names = ("free_keys", "structure_keys", "surface_keys")
        # Within its voxel a point stays where it was, up to float32: for a point at a side, either voxel will do.
        observations = tuple(
            replace(
                one,
                points_world=(one.points_world.astype(np.float64) + off).astype(np.float32),
                box=moved_box(one.box, there),
            )
            for one in event.observations
        )
        moved = replace(
            event, frame_index=event.frame_index + room * walk.num_frames, stamp_ns=event.stamp_ns + room * length_ns,
            world_from_camera=pose, observations=observations,
            space=replace(space, **{name: getattr(space, name) + step for name in names}),
        )  # fmt: skip
        yield moved, features


def handled(
    core: MapperCore, event: Event, features: Features, other: Callable[[Effect], None] = lambda _: None
) -> list[Event]:
    """Give the core an event and the answers to its requests; return these events, and pass other effects on."""
    events = [event]
    for waiting in events:
        for effect in core.handle(waiting):
            if isinstance(effect, ComputeFeatures):
                events.append(_features(effect, features))
            elif isinstance(effect, SearchLoops):
                events.append(LoopsSearched(submap_id=effect.submap_id, stamp_ns=effect.due_ns, loops=()))
            else:
                other(effect)
    return events


def _features(effect: ComputeFeatures, features: Features) -> FeaturesReady:
    # For a mask whose features were not requested in the recorded run, those of another one.
    spare = next(iter(features.values()), None)
    found = []
    for i in effect.observation_indices:
        known = features.get(i, spare)
        pooled = np.full(32, 32**-0.5, np.float32) if known is None else known.pooled
        found.append(MaskFeature(observation_index=i, variance=0.1 if known is None else known.variance, pooled=pooled))
    return FeaturesReady(frame_index=effect.frame_index, features=tuple(found))


@dataclass(frozen=True, kw_only=True, slots=True)
class Cost:
    """The cost of the keyframes of one room, with so many objects in the map before it."""

    # Processor milliseconds a keyframe; a save of the changes of 20 keyframes, and one of the next one's; megabytes.

    objects: int
    keyframes: int
    core_ms: float
    journal_ms: float
    save_all_ms: float
    save_ms: float
    keyframe_ms: float
    rss_mb: float
    folder_mb: float


class Mapped:
    """A map that is made of walks: the core, and the folder that an engine would write."""

    def __init__(self, walk: Walk, folder: Path) -> None:
        self._walk = walk
        self._config = MapperConfig()
        self.core = MapperCore(self._config.mapping)
        self._path = folder
        self._folder = create_map_folder(folder, config={}, source={}, run={}, overwrite=True)
        self._journal = JournalWriter(folder, flush_s=2.0)
        self.core.keep_far_arrays(FarArrays(folder).keep)
        self._jobs: dict[int, RequestShape] = {}
        self._num_keyframes = 0
        self._published: Publish | None = None
        self._times_s: defaultdict[str, float] = defaultdict(float)
        self._num_saves = 0

    @property
    def snapshot(self) -> MapSnapshot:
        assert self._published is not None
        return self._published.snapshot

    def room(self, index: int) -> Cost:
        self._times_s.clear()
        self._num_saves = 0
        objects = len(self.snapshot.objects) if self._published is not None else 0
        for event, features in keyframes_in(self._walk, index):
            self._keyframe(event, features)
        keyframes, saves = len(self._walk.keyframes), max(1, self._num_saves)
        ms = {name: 1e3 * seconds for name, seconds in self._times_s.items()}
        return Cost(
            objects=objects, keyframes=keyframes, core_ms=ms.get("core", 0.0) / keyframes,
            journal_ms=ms.get("journal", 0.0) / keyframes, save_all_ms=ms.get("save", 0.0) / saves,
            save_ms=ms.get(_ONE, 0.0) / saves,
            keyframe_ms=sum(value for name, value in ms.items() if name != _ONE) / keyframes, rss_mb=resident_mb(),
            folder_mb=folder_mb(self._path),
        )  # fmt: skip

    def close(self) -> None:
        self._journal.close()
        self._folder.save(self.snapshot)
        self._folder.finish(finished_cleanly=True)
        self._folder.close()

    def _keyframe(self, event: FrameObserved, features: Features) -> None:
        done: list[Event] = []
        with self._timed("core"):
            for ticket, job in sorted(self._jobs.items()):
                if job.due_ns <= event.stamp_ns:
                    del self._jobs[ticket]
                    done += handled(self.core, self._shape(job, event.stamp_ns), features, self._carry_out)
            self.core.prior()
            done += handled(self.core, event, features, self._carry_out)
        self._num_keyframes += 1
        with self._timed("journal"):
            self._write(event, done)
        since_save = self._num_keyframes % DiskSinkConfig().every_keyframes
        if since_save == 0 or (since_save == 1 and self._num_saves):
            self._num_saves += since_save == 0
            with self._timed(_ONE if since_save else "save"):
                self._folder.save(self.snapshot)

    def _carry_out(self, effect: Effect) -> None:
        if isinstance(effect, RequestShape):
            self._jobs[effect.ticket] = effect
        elif isinstance(effect, CancelShape):
            self._jobs.pop(effect.ticket, None)
        elif isinstance(effect, KeepView):
            for file in crop_files(self._folder.views, effect.view.name):
                file.touch()
        elif isinstance(effect, DropView):
            self._folder.drop_view(effect.name)
        elif isinstance(effect, Publish):
            self._published = effect

    def _shape(self, job: RequestShape, stamp_ns: int) -> ShapeReady:
        shape = self._walk.shapes[job.object_id % len(self._walk.shapes)]
        name = f"{job.ticket:06d}-{shape.mesh_name}"
        path = self._folder.shapes / name
        if not path.exists():
            shutil.copy(self._walk.meshes / shape.mesh_name, path)
        placed = replace(shape, revision=job.ticket, mesh_name=name)
        to = from_rotation_translation(np.eye(3), job.box.center - shape.world_from_object[:3, 3])
        return ShapeReady(ticket=job.ticket, object_id=job.object_id, stamp_ns=stamp_ns, shape=moved_shape(placed, to))

    def _write(self, event: FrameObserved, done: list[Event]) -> None:
        assert self._published is not None
        pose = FramePose(index=event.frame_index, stamp_ns=event.stamp_ns, world_from_camera=event.world_from_camera)
        step = Step(
            kind=StepKind.KEYFRAME, stamp_ns=event.stamp_ns, camera=self._walk.camera, frames=(pose,), round_index=0,
            first_index=0, first_ns=self._walk.first_ns, num_frames=event.frame_index + 1,
            num_keyframes=self._num_keyframes, counts={}, shape_counts={},
        )  # fmt: skip
        told = Told(decisions=self._published.decisions, submap_id=self.core.submaps[-1].id)
        entry = JournalEntry(step=step, events=tuple(done), told=told)
        self._journal.append(entry, known=self.core.snapshot())
        if self._num_keyframes % self._config.journal.checkpoint_keyframes == 0:
            jobs = tuple(
                OpenJob(ticket=job.ticket, object_id=job.object_id, due_ns=job.due_ns) for job in self._jobs.values()
            )
            self._journal.checkpoint(Checkpoint(core=self.core.state(), open_jobs=jobs), event.stamp_ns)

    @contextmanager
    def _timed(self, stage: str) -> Iterator[None]:
        began = time.process_time()
        yield
        self._times_s[stage] += time.process_time() - began


def map_rooms(walk: Walk, folder: Path, num_objects: int) -> tuple[list[Cost], float, str]:
    """Map rooms until there are so many objects; return the cost of each, the ratio of keyframes, and the digest."""
    mapped = Mapped(walk, folder)
    costs: list[Cost] = []
    early: dict[str, object] = {}
    for index in itertools.count():
        objects = len(mapped.snapshot.objects) if index else 0
        if objects >= _FEW and not early:
            early = mapped.core.state()
        cost = mapped.room(index)
        if index > 0:
            costs.append(cost)
            print(dumps(asdict(cost)), file=sys.stderr, flush=True)
        if objects >= num_objects:
            break
    mapped.close()
    few = MapperCore.from_state(MapperConfig().mapping, early)
    return costs, keyframe_ratio(walk, few, mapped.core, index + 1), map_digest(mapped.snapshot)


def street_mb(walk_folder: Path, out: Path, *, metres: float) -> tuple[float, float]:
    """Return the length of a walk that is mapped again and again, and the memory of the core at its end."""
    answer = json_of("-m", __name__, walk_folder, out, "--metres", metres)
    return answer["metres"], answer["rss_mb"]


def map_street(walk: Walk, folder: Path, metres: float) -> dict[str, float]:
    mapped = Mapped(walk, folder)
    for index in range(count := int(np.ceil(metres / walk.length_m))):
        cost = mapped.room(index)
        print(f"{(index + 1) * walk.length_m:.0f} m: {cost.rss_mb:.0f} MB", file=sys.stderr, flush=True)
    mapped.close()
    return {"metres": count * walk.length_m, "rss_mb": cost.rss_mb}


def keyframe_ratio(walk: Walk, few: MapperCore, many: MapperCore, room: int) -> float:
    """Return the processor time of the core for the keyframes of a room in one map over the time in another."""
    # Both are given the same keyframes, turn by turn, so that other load slows both. The first ones, in which the
    # window moves there and a saved state is taken up, do not count.
    spent_s: dict[int, list[float]] = {id(few): [], id(many): []}
    for i, (event, features) in enumerate(keyframes_in(walk, room)):
        for core in (few, many) if i % 2 else (many, few):
            began = time.process_time()
            core.prior()
            handled(core, event, features)
            spent_s[id(core)].append(time.process_time() - began)
    few_s, many_s = (sum(spent_s[id(core)][_FIRST:_LAST]) for core in (few, many))
    return many_s / few_s


def scale_costs(walk_folder: Path, out: Path, *, num_objects: int) -> tuple[list[Cost], float, str]:
    """Return the result of `map_rooms`, from a process of its own."""
    answer = json_of("-m", __name__, walk_folder, out, "--objects", num_objects)
    return [Cost(**cost) for cost in answer["costs"]], answer["keyframe_ratio"], answer["digest"]


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("walk", type=Path, help="a map folder that was played")
    parser.add_argument("out", type=Path)
    parser.add_argument("--objects", type=int, default=1000)
    parser.add_argument("--metres", type=float)
    options = parser.parse_args()
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")
    if options.metres is not None:
        print(dumps(map_street(read_walk(options.walk), options.out, options.metres)))
        sys.exit()
    costs, ratio, digest = map_rooms(read_walk(options.walk), options.out, options.objects)
    print(dumps({"costs": [asdict(cost) for cost in costs], "keyframe_ratio": ratio, "digest": digest}))
