"""Fleets of made robots: who is joined, whether rightly, and what the merged map is worth.

Rooms with two robots each, which start anywhere on a round of it, and the same with a third robot of another room, who
is in nobody's frame; apartments with three robots, whose merged map is held against that of one robot that walks as
long as the three together.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.config import MapperConfig
from hickory_stream.config_text import read_config
from hickory_stream.engine.run_progress import Progress
from hickory_stream.engine.saved_map import open_map
from hickory_stream.evaluation.match import meshes_of, score_map
from hickory_stream.evaluation.truth import Truth, moved_truth
from hickory_stream.fleet.finish import Finished, finish
from hickory_stream.fleet.result import FleetResult
from hickory_stream.fleet.robots import FleetConfig, Robot
from hickory_stream.fleet.run import FleetPlan, run_fleet
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.rigid import apply, invert, rotation_angle_rad
from hickory_stream.records import MapSnapshot
from hickory_stream.settings import Settings
from hickory_stream.sinks.disk_sink import DiskSinkConfig
from hickory_stream.worlds.cache import cached_recording
from hickory_stream.worlds.recording import drawn_frame
from hickory_stream.worlds.recording_config import RecordingConfig
from players import SourceOptions, open_source
from tools.benchmarks.common.coarse_runs import COARSE
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.common.kept import kept, state_folder
from tools.benchmarks.common.played import play_into

_ROOMS, _QUICK_ROOMS, _APARTMENTS = 20, 1, (24, 30)
_ROOM = RecordingConfig(scene="room", seconds=6.0, rate_hz=2.0, width=320, height=180, robots=2)
_APARTMENT_S = 25.0
_APARTMENT = RecordingConfig(scene="apartment", seconds=_APARTMENT_S, rate_hz=4.0, width=320, height=240, robots=3)
_WRONG_M, _WRONG_RAD = 0.5, np.radians(5.0)
# Robots that truly share fewer objects than that, seen for 30 % and more by both, need not be joined.
_SHARED, _SEEN = 5, 0.3


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Fleet:
    """Robots of one world as they were recorded, with where each one's frame truly lies, robot_from_world."""

    names: tuple[str, ...]
    logs: tuple[Path, ...]
    truths: tuple[Truth, ...]
    robot_from_world: tuple[NDArray[np.float64], ...]

    def is_wrong(self, a: str, b: str, a_from_b: NDArray[np.float64]) -> bool:
        """Return whether a transform between two robots takes what b has mapped to another place."""
        i, j = self.names.index(a), self.names.index(b)
        true = self.robot_from_world[i] @ invert(self.robot_from_world[j])
        middle = np.mean([item.world_from_object[:3, 3] for item in self.truths[j].objects], axis=0)
        off_m = float(np.linalg.norm(apply(a_from_b, middle) - apply(true, middle)))
        return off_m > _WRONG_M or rotation_angle_rad(true[:3, :3].T @ a_from_b[:3, :3]) > _WRONG_RAD

    def shares(self, a: str, b: str) -> bool:
        """Return whether two robots have seen enough of the same objects to be joined."""
        one, other = (self.truths[self.names.index(name)].objects for name in (a, b))
        both = sum(min(x.seen_fraction, y.seen_fraction) >= _SEEN for x, y in zip(one, other, strict=True))
        return both >= _SHARED


@dataclass(slots=True)
class _Counts:
    """What was counted: joins while the maps grew and of the finished maps, and robots."""

    joins: int = 0
    wrong: int = 0
    robots: int = 0
    joined: int = 0
    undecidable: int = 0

    def add(self, other: Mapping[str, int]) -> None:
        """Add what was counted of one more fleet."""
        for name, count in other.items():
            setattr(self, name, getattr(self, name) + count)


def fleet_figures(options: Options) -> list[Figure]:
    """Return the figures of fleets; a quick run has one room, and no apartment.

    What each fleet gave is kept under `--state`, with the maps of its robots; a later call goes on.
    """
    counts = _Counts()
    first = 300 + 100 * options.seed
    folder = state_folder(options.state, "fleet", "hickory_stream/fleet", "hickory_stream/merging")
    seeds = range(first, first + (_QUICK_ROOMS if options.quick else _ROOMS))
    for seed in seeds:
        _tell(counts, kept(folder / f"room-{seed}.json", partial(_room, seed, folder)))
    mixed = 0
    for seed in seeds[:-1]:
        _tell(counts, kept(folder / f"mixed-{seed}.json", partial(_stranger, seed, folder)))
        mixed += 1
    losses = []
    for seed in () if options.quick else _APARTMENTS:
        found = kept(folder / f"apartment-{seed}.json", partial(_apartment, seed, folder))
        losses.append((found["loss_25"], found["loss_50"]))
        _tell(counts, found["counts"])
    told = f"{len(seeds)} rooms with two robots, and {mixed} strangers among them"
    told += f", {len(losses)} apartments with three" if losses else ""
    figures = [
        figure(
            "fleet_wrong_joins",
            counts.wrong,
            "",
            "lower",
            f"of {counts.joins} joins, those while the maps grew and those of the finished maps; {told}",
        )
    ]
    if counts.robots:
        figures.append(
            figure(
                "fleet_joined",
                counts.joined / counts.robots,
                "",
                "higher",
                f"{counts.robots} robots",
                left_out=f"{counts.undecidable} robots that share fewer than {_SHARED} well-seen objects with others",
            )
        )
    for name, place, iou in (("fleet_recall_25_loss", 0, 0.25), ("fleet_recall_loss", 1, 0.5)) if losses else ():
        value = float(np.mean([loss[place] for loss in losses]))
        of = f"mean of {len(losses)} apartments, IoU {iou}; one robot walks as long as three"
        figures.append(figure(name, value, "", "lower", of))
    return figures


def _tell(counts: _Counts, found: Mapping[str, int]) -> None:
    counts.add(found)
    print(f"{counts.joined} of {counts.robots} robots joined, {counts.wrong} of {counts.joins} joins wrong", flush=True)


def _recorded(config: RecordingConfig) -> _Fleet:
    configs = [replace(config, walk_index=i) for i in range(config.robots)]
    made = [cached_recording(one) for one in configs]
    frames = [drawn_frame(one) for one in configs]
    return _Fleet(
        names=tuple(f"robot-{i + 1}" for i in range(config.robots)),
        logs=tuple(log for log, _ in made),
        truths=tuple(truth for _, truth in made),
        robot_from_world=tuple(frame for frame in frames if frame is not None),
    )


def _run(fleet: _Fleet, out: Path, *, is_coarse: bool) -> FleetResult:
    print(f"fleet {fleet.logs[0].stem}", flush=True)
    shutil.rmtree(out, ignore_errors=True)  # of a call that was stopped
    plan = FleetPlan(
        robots=tuple(
            Robot(name=name, uris=(str(log),), options=SourceOptions())
            for name, log in zip(fleet.names, fleet.logs, strict=True)
        ),
        config=FleetConfig(every_keyframes=4),
        out=out,
        overwrite=False,
        mapper=_settings(is_coarse=is_coarse).mapper,
        disk=DiskSinkConfig(),
    )
    return run_fleet(plan, _Silent())


def _settings(*, is_coarse: bool) -> Settings:
    return read_config(Settings, None, (*COARSE, "mapper.run.workers=1") if is_coarse else ())


def _room(seed: int, folder: Path) -> dict[str, int]:
    """Return what was counted of two robots in a room; their maps stay in the folder, named by the seed."""
    fleet = _recorded(replace(_ROOM, seed=seed))
    return asdict(_counted(fleet, _run(fleet, folder / str(seed), is_coarse=True)))


def _counted(fleet: _Fleet, result: FleetResult) -> _Counts:
    counts = _Counts()
    for event in result.events:
        if event.kind == "joined":
            counts.joins += 1
            counts.wrong += fleet.is_wrong(event.a, event.b, event.a_from_b)
    place = {robot.name: robot.frame_from_robot for robot in result.robots}
    frame = {robot.name: robot.frame for robot in result.robots}
    for a, b in combinations(fleet.names, 2):
        pose_a, pose_b = place[a], place[b]
        if frame[a] == frame[b] and pose_a is not None and pose_b is not None:
            counts.joins += 1
            counts.wrong += fleet.is_wrong(a, b, invert(pose_a) @ pose_b)
    for name in fleet.names:
        others = [other for other in fleet.names if other != name]
        if any(fleet.shares(name, other) for other in others):
            counts.robots += 1
            counts.joined += any(frame[other] == frame[name] for other in others)
        else:
            counts.undecidable += 1
    return counts


def _stranger(seed: int, folder: Path) -> dict[str, int]:
    """Return who was joined, always wrongly, with a robot of the next room: the finished maps of both are there."""
    maps = {f"robot-{i}": folder / str(seed) / f"robot-{i}.map" for i in (1, 2)}
    maps["stranger"] = folder / str(seed + 1) / "robot-1.map"
    with tempfile.TemporaryDirectory() as out:
        found: Finished = finish(maps, Path(out), overwrite=False)
    frame = next(frame for frame in found.frames if "stranger" in frame.names)
    return {"joins": len(frame.names) - 1, "wrong": len(frame.names) - 1}


def _apartment(seed: int, folder: Path) -> dict[str, Any]:
    """Return how much less of an apartment the merged map of three has than that of one, at IoU 0.25 and 0.5."""
    fleet = _recorded(replace(_APARTMENT, seed=seed))
    result = _run(fleet, folder / f"flat-{seed}", is_coarse=False)
    alone = replace(_APARTMENT, seed=seed, robots=0, seconds=_APARTMENT_S * len(fleet.names))
    log, truth = cached_recording(alone)
    play_into(folder / f"alone-{seed}", open_source(log), MapperConfig())
    seen = np.max([[item.seen_fraction for item in one.objects] for one in fleet.truths], axis=0)
    same = _restricted(truth, [min(a, item.seen_fraction) for a, item in zip(seen, truth.objects, strict=True)])
    one = score_map(*_with_meshes(folder / f"alone-{seed}"), same)
    found = {"counts": asdict(_counted(fleet, result)), "loss_25": one.recall_25, "loss_50": one.recall_50}
    if not result.merged:
        return found
    frame_from_world = fleet.robot_from_world[fleet.names.index(result.merged[0].names[0])]
    merged = score_map(*_with_meshes(result.merged[0].path), moved_truth(same, frame_from_world))
    return found | {"loss_25": one.recall_25 - merged.recall_25, "loss_50": one.recall_50 - merged.recall_50}


def _restricted(truth: Truth, seen: Sequence[float]) -> Truth:
    """Return a truth whose objects count as seen so far."""
    objects = tuple(replace(item, seen_fraction=share) for item, share in zip(truth.objects, seen, strict=True))
    return replace(truth, objects=objects)


def _with_meshes(folder: Path) -> tuple[MapSnapshot, dict[int, Mesh]]:
    saved = open_map(folder)
    return saved.snapshot, meshes_of(saved)


class _Silent:
    """Watches a fleet and says nothing."""

    def opened(self, name: str, lines: Sequence[str]) -> None:
        """Say nothing."""

    def moved(self, name: str, progress: Progress) -> None:
        """Say nothing."""

    def said(self, text: str) -> None:
        """Say nothing."""
