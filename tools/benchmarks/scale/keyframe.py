"""What a keyframe costs in a map of so many objects: one recorded walk, again and again, in a grid of rooms.

The events of a short recorded run are given to the core room after room, each time `_PITCH_M` further; what the engine
writes is written: the journal with its checkpoints, and the map folder as the disk sink saves it, views as empty
files. There is no perception: what it takes of the map, its prior, is asked for. Shapes are those of the recorded run,
one after another. A keyframe then costs what the map makes of it, and what one looks at is the same in every room.
"""

from __future__ import annotations

import argparse
import cProfile
import io
import itertools
import json
import os
import pstats
import shutil
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hickory_stream.config import MapperConfig
from hickory_stream.engine.crops import crop_files
from hickory_stream.engine.digest import map_digest
from hickory_stream.engine.far_arrays import FarArrays
from hickory_stream.engine.journal import Journal
from hickory_stream.engine.journal_writer import JournalWriter
from hickory_stream.engine.map_folder import create_map_folder
from hickory_stream.engine.step import Checkpoint, FramePose, JournalEntry, OpenJob, Step, StepKind, Told
from hickory_stream.events import (
    CancelShape,
    ComputeFeatures,
    DropView,
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
from hickory_stream.json_text import dumps
from hickory_stream.mapping.core import MapperCore
from hickory_stream.mapping.moved import moved_box, moved_shape
from hickory_stream.records import MapSnapshot, MaskFeature, ObjectShape
from hickory_stream.sinks.disk_sink import DiskSinkConfig
from tools.benchmarks.common.processes import ROOT

_PITCH_M = 12.75
"""From room to room: a multiple of both lattices and of the step of points: a room further on is the same room."""
_ROOMS_WIDE = 8
_EVERY = 2
# Objects in the smaller map, and the keyframes of a room that count.
_FEW, _FIRST, _LAST = 50, 3, 23
# What is measured beside what a run does.
_ONE = "save of one keyframe"
_STATUS = Path("/proc/self/status")


@dataclass(frozen=True, kw_only=True, slots=True)
class Walk:
    """A recorded walk through one room: its keyframes, the features of their masks, and the shapes that were made."""

    keyframes: tuple[FrameObserved, ...]
    features: dict[tuple[int, int], MaskFeature]
    shapes: tuple[ObjectShape, ...]
    camera: Camera
    num_frames: int
    meshes: Path


def read_walk(folder: Path) -> Walk:
    """Return the walk of a map folder."""
    keyframes: list[FrameObserved] = []
    features: dict[tuple[int, int], MaskFeature] = {}
    shapes: list[ObjectShape] = []
    with Journal(folder) as journal:
        for entry in journal.entries():
            for event in entry.events:
                if isinstance(event, FrameObserved):
                    keyframes.append(event)
                elif isinstance(event, FeaturesReady):
                    features |= {(event.frame_index, one.observation_index): one for one in event.features}
                elif isinstance(event, ShapeReady):
                    shapes.append(event.shape)
        camera = journal.step(0).camera
    return Walk(
        keyframes=tuple(keyframes[::_EVERY]),
        features=features,
        shapes=tuple(shapes),
        camera=camera,
        num_frames=keyframes[-1].frame_index + 1,
        meshes=folder / "shapes",
    )


def keyframes_in(walk: Walk, room: int) -> Iterator[tuple[FrameObserved, dict[int, MaskFeature]]]:
    """Yield the keyframes of the walk in a room, and the features of their masks."""
    # To and fro, so that the way from room to room is short.
    row, column = divmod(room, _ROOMS_WIDE)
    column = column if row % 2 == 0 else _ROOMS_WIDE - 1 - column
    off = np.array([column * _PITCH_M, row * _PITCH_M, 0.0])
    there = from_rotation_translation(np.eye(3), off)
    length_ns = walk.keyframes[-1].stamp_ns - walk.keyframes[0].stamp_ns + 300_000_000
    by_x, by_y = (int(cells) for cells in np.round(off[:2] / 0.05))
    # A key has the cell's coordinates in fields of 21 bits, x in the upper one.
    step = np.int64((by_x << 42) + (by_y << 21))
    for event in walk.keyframes:
        pose = event.world_from_camera.copy()
        pose[:3, 3] += off
        space = event.space
        observations = tuple(
            replace(one, points_world=_shifted(one.points_world, off), box=moved_box(one.box, there))
            for one in event.observations
        )
        moved = replace(
            event,
            frame_index=event.frame_index + room * walk.num_frames,
            stamp_ns=event.stamp_ns + room * length_ns,
            world_from_camera=pose,
            observations=observations,
            space=replace(
                space,
                free_keys=space.free_keys + step,
                structure_keys=space.structure_keys + step,
                surface_keys=space.surface_keys + step,
            ),
        )
        yield moved, {i: feature for (frame, i), feature in walk.features.items() if frame == event.frame_index}


def _shifted(points: NDArray[np.float32], off: NDArray[np.float64]) -> NDArray[np.float32]:
    # Within its voxel a point stays where it was, up to float32: it is no matter in which voxel a point at a side is.
    return (points.astype(np.float64) + off).astype(np.float32)


@dataclass(frozen=True, kw_only=True, slots=True)
class Cost:
    """What keyframes of one room cost, with so many objects in the map before it.

    Processor milliseconds a keyframe: of the core and its prior, of journal and checkpoints, and of all; a save of what
    20 keyframes changed; and once more of what the one after them changed, which no other figure counts. Megabytes: of
    the process, of the folder.
    """

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
        self._folder = create_map_folder(folder, config={}, source={}, run={}, overwrite=True)
        self._journal = JournalWriter(folder, flush_s=2.0)
        self.core.keep_far_arrays(FarArrays(folder).keep)
        self._jobs: dict[int, RequestShape] = {}
        self._num_keyframes = 0
        self._published: Publish | None = None
        self.times_s: defaultdict[str, float] = defaultdict(float)
        self.num_saves = 0

    @property
    def snapshot(self) -> MapSnapshot:
        """The map as it was published last."""
        assert self._published is not None
        return self._published.snapshot

    def room(self, index: int) -> int:
        """Map one more room; return the number of its keyframes."""
        for event, features in keyframes_in(self._walk, index):
            self._keyframe(event, features)
        return len(self._walk.keyframes)

    def close(self) -> None:
        """Finish the journal, and the map."""
        self._journal.close()
        self._folder.save(self.snapshot)
        self._folder.finish(finished_cleanly=True)
        self._folder.close()

    def _keyframe(self, event: FrameObserved, features: dict[int, MaskFeature]) -> None:
        done: list[Event] = []
        with self._timed("core"):
            for ticket, job in sorted(self._jobs.items()):
                if job.due_ns <= event.stamp_ns:
                    del self._jobs[ticket]
                    self._handle(self._shape(job, event.stamp_ns), features, done)
            self.core.prior()
            self._handle(event, features, done)
        self._num_keyframes += 1
        with self._timed("journal"):
            self._write(event, done)
        if self._num_keyframes % DiskSinkConfig().every_keyframes == 0:
            self.num_saves += 1
            with self._timed("save"):
                self._folder.save(self.snapshot)
        elif self.num_saves and self._num_keyframes % DiskSinkConfig().every_keyframes == 1:
            with self._timed(_ONE):
                self._folder.save(self.snapshot)

    def _handle(self, event: Event, features: dict[int, MaskFeature], done: list[Event]) -> None:
        events = [event]
        while events:
            event = events.pop(0)
            done.append(event)
            for effect in self.core.handle(event):
                if isinstance(effect, ComputeFeatures):
                    events.append(_features(effect, features))
                elif isinstance(effect, RequestShape):
                    self._jobs[effect.ticket] = effect
                elif isinstance(effect, CancelShape):
                    self._jobs.pop(effect.ticket, None)
                elif isinstance(effect, SearchLoops):
                    answer = LoopsSearched(submap_id=effect.submap_id, stamp_ns=effect.due_ns, loops=())
                    events.append(answer)
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
            kind=StepKind.KEYFRAME,
            stamp_ns=event.stamp_ns,
            camera=self._walk.camera,
            frames=(pose,),
            round_index=0,
            first_index=0,
            first_ns=self._walk.keyframes[0].stamp_ns,
            num_frames=event.frame_index + 1,
            num_keyframes=self._num_keyframes,
            counts={},
            shape_counts={},
        )
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
        self.times_s[stage] += time.process_time() - began


def _features(effect: ComputeFeatures, features: dict[int, MaskFeature]) -> FeaturesReady:
    # Of a mask whose features nobody asked for in the recorded run, those of another one.
    spare = next(iter(features.values()), None)
    found = []
    for i in effect.observation_indices:
        known = features.get(i, spare)
        pooled = np.full(32, 32**-0.5, np.float32) if known is None else known.pooled
        found.append(MaskFeature(observation_index=i, variance=0.1 if known is None else known.variance, pooled=pooled))
    return FeaturesReady(frame_index=effect.frame_index, features=tuple(found))


def map_rooms(
    walk: Walk, folder: Path, *, num_objects: int, profile: dict[int, str] | None = None
) -> tuple[list[Cost], float, str]:
    """Map rooms until there are so many objects; return what each cost, the ratio of keyframes, and the map's digest.

    `profile` receives the profile by function of the first room after 20, 200, 1,000 objects.
    """
    mapped = Mapped(walk, folder)
    wanted = [20, 200, 1000] if profile is not None else []
    costs: list[Cost] = []
    early: dict[str, object] = {}
    for index in itertools.count():
        objects = len(mapped.snapshot.objects) if index else 0
        if objects >= _FEW and not early:
            early = mapped.core.state()
        mapped.times_s.clear()
        mapped.num_saves = 0
        if profile is not None and wanted and objects >= wanted[0]:
            profile[wanted.pop(0)] = _profiled(mapped, index)
        else:
            keyframes = mapped.room(index)
            if index > 0:
                costs.append(_cost(mapped, objects, keyframes, folder))
                print(dumps(asdict(costs[-1])), file=sys.stderr, flush=True)
        if objects >= num_objects:
            break
    mapped.close()
    digest = map_digest(mapped.snapshot)
    few = MapperCore.from_state(MapperConfig().mapping, early)
    return costs, keyframe_ratio(walk, few, mapped.core, index + 1), digest


def keyframe_ratio(walk: Walk, few: MapperCore, many: MapperCore, room: int) -> float:
    """Return the processor time of the core for the keyframes of a room in one map over that in another.

    Both are given the same keyframes, turn by turn, so that what else the machine does slows both. The first ones,
    in which the window moves there and what came from a saved state is taken up, do not count.
    """
    spent_s = np.array(
        [
            [_core_s(core, event, features) for core in ((few, many) if i % 2 else (many, few))][:: 1 if i % 2 else -1]
            for i, (event, features) in enumerate(keyframes_in(walk, room))
        ]
    )
    few_s, many_s = spent_s[_FIRST:_LAST].sum(axis=0)
    return float(many_s / few_s)


def _core_s(core: MapperCore, event: Event, features: dict[int, MaskFeature]) -> float:
    began = time.process_time()
    core.prior()
    events = [event]
    while events:
        for effect in core.handle(events.pop(0)):
            if isinstance(effect, ComputeFeatures):
                events.append(_features(effect, features))
            elif isinstance(effect, SearchLoops):
                events.append(LoopsSearched(submap_id=effect.submap_id, stamp_ns=effect.due_ns, loops=()))
    return time.process_time() - began


def _profiled(mapped: Mapped, room: int) -> str:
    profiler = cProfile.Profile(time.process_time)
    profiler.enable()
    mapped.room(room)
    profiler.disable()
    text = io.StringIO()
    stats = pstats.Stats(profiler, stream=text).sort_stats("tottime")
    stats.print_stats(35)
    stats.sort_stats("cumulative").print_stats(70)
    return text.getvalue()


def _cost(mapped: Mapped, objects: int, keyframes: int, folder: Path) -> Cost:
    times = mapped.times_s
    return Cost(
        objects=objects,
        keyframes=keyframes,
        core_ms=1e3 * times["core"] / keyframes,
        journal_ms=1e3 * times["journal"] / keyframes,
        save_all_ms=1e3 * times["save"] / max(1, mapped.num_saves),
        save_ms=1e3 * times[_ONE] / max(1, mapped.num_saves),
        keyframe_ms=1e3 * sum(seconds for name, seconds in times.items() if name != _ONE) / keyframes,
        rss_mb=_resident_mb(),
        folder_mb=sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) / 1e6,
    )


def _resident_mb() -> float:
    (line,) = (line for line in _STATUS.read_text().splitlines() if line.startswith("VmRSS:"))
    return int(line.split()[1]) * 1024 / 1e6


def scale_costs(walk_folder: Path, out: Path, *, num_objects: int) -> tuple[list[Cost], float, str]:
    """Return what `map_rooms` does, measured in a process of its own.

    Raises:
        RuntimeError: the child failed.
    """
    command = [sys.executable, "-m", "tools.benchmarks.scale.keyframe", str(walk_folder), str(out)]
    done = subprocess.run([*command, "--objects", str(num_objects)], cwd=ROOT, capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)} ended with {done.returncode}: {done.stderr.splitlines()[-1:]}")
    answer = json.loads(done.stdout)
    return [Cost(**cost) for cost in answer["costs"]], answer["keyframe_ratio"], answer["digest"]


def main() -> None:
    """Measure, and print one line of JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("walk", type=Path, help="a map folder that was played")
    parser.add_argument("out", type=Path)
    parser.add_argument("--objects", type=int, required=True)
    parser.add_argument("--profile", type=Path, help="write a profile by function")
    options = parser.parse_args()
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")
    profile: dict[int, str] = {}
    costs, ratio, digest = map_rooms(
        read_walk(options.walk),
        options.out,
        num_objects=options.objects,
        profile=profile if options.profile is not None else None,
    )
    for objects, text in profile.items():
        Path(f"{options.profile}-{objects}.txt").write_text(text, encoding="utf-8")
    print(dumps({"costs": [asdict(cost) for cost in costs], "keyframe_ratio": ratio, "digest": digest}))


if __name__ == "__main__":
    main()
