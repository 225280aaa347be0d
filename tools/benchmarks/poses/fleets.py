"""Fleets of synthetic robots: the robots that are joined, whether rightly, and the quality of the merged map."""
# Rooms with two robots; the same with a third robot of another room; apartments with three robots, compared with the
# map of one robot that walks as long; walks of a campus by others, with odometry that drifts by about a percent.

import shutil
import tempfile
from collections import Counter
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.alignment.answer import NoAlignment
from hickory_stream.alignment.object_map import object_map
from hickory_stream.base.config_text import read_config
from hickory_stream.config import MapperConfig
from hickory_stream.errors import RecordingError
from hickory_stream.evaluation.match import Score, meshes_of, score_map
from hickory_stream.evaluation.truth import Truth, load_truth, moved_truth
from hickory_stream.fleet.finish import finish
from hickory_stream.fleet.result import FleetResult
from hickory_stream.fleet.robots import FleetConfig, Robot
from hickory_stream.fleet.run import FleetPlan, run_fleet
from hickory_stream.geometry.rigid import apply, invert, rotation_angle_rad
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.merging.joining import aligned_to_join
from hickory_stream.sinks.disk_sink import DiskSinkConfig
from players import SourceOptions, open_source
from tools.benchmarks.common.cached_runs import cached, cached_map, play_into, state_folder
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.common.processes import COARSE, NO_SHAPES
from tools.benchmarks.foreign.logs import BACK, foreign_log, worlds_folder
from tools.benchmarks.foreign.parts import CAMPUS
from tools.benchmarks.poses.drift import CONFIG, keyframe_poses, map_from_world
from tools.benchmarks.poses.drift_logs import drifting, moved_to
from tools.worlds.cache import cached_recording
from tools.worlds.recording_config import RecordingConfig, drawn_frame

_ROOMS, _QUICK_ROOMS, _APARTMENTS = 20, 1, (24, 30)
_ROOM = RecordingConfig(scene="room", seconds=6.0, rate_hz=2.0, width=320, height=180, robots=2)
_APARTMENT_S = 25.0
_APARTMENT = RecordingConfig(scene="apartment", seconds=_APARTMENT_S, rate_hz=4.0, width=320, height=240, robots=3)
_WRONG_M, _WRONG_RAD = 0.5, np.radians(5.0)
_CAMPUS_WALKS = (("A", "robot"), ("A", "hand"), ("B", "robot"), (f"A{BACK}", "robot"))
# Robots that truly share fewer objects than that, seen for 30 % and more by both, need not be joined.
_SHARED, _SEEN = 5, 0.3


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Fleet:
    names: tuple[str, ...]
    logs: tuple[Path, ...]
    truths: tuple[Truth, ...]
    robot_from_world: tuple[NDArray[np.float64], ...]

    def is_wrong(self, a: str, b: str, a_from_b: NDArray[np.float64]) -> bool:
        i, j = self.names.index(a), self.names.index(b)
        true = self.robot_from_world[i] @ invert(self.robot_from_world[j])
        middle = np.mean([item.world_from_object[:3, 3] for item in self.truths[j].objects], axis=0)
        off_m = float(np.linalg.norm(apply(a_from_b, middle) - apply(true, middle)))
        return off_m > _WRONG_M or rotation_angle_rad(true[:3, :3].T @ a_from_b[:3, :3]) > _WRONG_RAD

    def shares(self, a: str, b: str) -> bool:
        one, other = (self.truths[self.names.index(name)].objects for name in (a, b))
        both = sum(min(x.seen_fraction, y.seen_fraction) >= _SEEN for x, y in zip(one, other, strict=True))
        return both >= _SHARED


def fleet_figures(options: Options) -> list[Figure]:
    """Return the figures of fleets; a quick run has one room, and no apartment."""
    # The result of each fleet is cached under `--state`, with the maps of its robots; a later call continues.
    counts: Counter[str] = Counter()
    first = 300 + 100 * options.seed
    folder = state_folder(options.state, "fleet", "hickory_stream/fleet", "hickory_stream/merging")
    seeds = range(first, first + (_QUICK_ROOMS if options.quick else _ROOMS))
    jobs = [(f"room-{seed}", partial(_room, seed, folder)) for seed in seeds]
    jobs += [(f"mixed-{seed}", partial(_stranger, seed, folder)) for seed in seeds[:-1]]
    jobs += [] if options.quick else [(f"apartment-{seed}", partial(_apartment, seed, folder)) for seed in _APARTMENTS]
    losses = []
    for name, measured in jobs:
        found = cached(folder / f"{name}.json", measured)
        if "counts" in found:
            losses.append((found["loss_25"], found["loss_50"]))
        counts.update(found.get("counts", found))
        print(
            f"{counts['joined']} of {counts['robots']} robots joined, {counts['wrong']} of {counts['joins']} joins "
            "wrong",
            flush=True,
        )
    of = f"{len(seeds)} rooms with two robots, and {len(seeds) - 1} strangers among them"
    of += f", {len(losses)} apartments with three" if losses else ""
    of = f"of {counts['joins']} joins, those while the maps grew and those of the finished maps; {of}"
    figures = [figure("fleet_wrong_joins", counts["wrong"], "", "lower", of)]
    if robots := counts["robots"]:
        left_out = f"{counts['undecidable']} robots that share fewer than {_SHARED} well-seen objects with others"
        more = {"left_out": left_out}
        figures.append(figure("fleet_joined", counts["joined"] / robots, "", "higher", f"{robots} robots", **more))
    for name, place, iou in (("fleet_recall_25_loss", 0, 0.25), ("fleet_recall_loss", 1, 0.5)) if losses else ():
        of = f"mean of {len(losses)} apartments, IoU {iou}; one robot walks as long as three"
        figures.append(figure(name, np.mean([loss[place] for loss in losses]), "", "lower", of))
    return figures


def campus_figures(options: Options) -> list[Figure]:
    """Return how many pairs of walks of a campus are joined, how many wrongly, and how far off the right ones are."""
    try:
        worlds = worlds_folder(options.worlds)
    except RecordingError:
        return []
    folder, maps = state_folder(options.state, "campus"), {}
    for walk, camera in _CAMPUS_WALKS:
        name, log = f"{walk}-{camera}", foreign_log(worlds, CAMPUS, walk, camera)
        true = {frame.stamp_ns: frame.world_from_camera for frame in load_truth(log.truth).frames}
        source = moved_to(open_source(str(log.log)), drifting(true, 1.0, [51, len(maps)]))
        saved = cached_map(folder / name, lambda source=source: source, *CONFIG, NO_SHAPES)
        poses = keyframe_poses(folder / name)[1]
        placed = map_from_world(poses, {stamp_ns: true[stamp_ns] for stamp_ns in poses})
        maps[name] = (object_map(saved.snapshot, saved.manifest.extractor), placed)
    answers = {}
    for a, b in combinations(maps, 2):
        (map_a, a_from_world), (map_b, b_from_world) = maps[a], maps[b]
        answer = aligned_to_join(map_a, map_b)
        if isinstance(answer, NoAlignment):
            print(f"{a} and {b}: {answer.refusal}, {answer.reason}", flush=True)
            continue
        off = invert(a_from_world @ invert(b_from_world)) @ answer.a_from_b
        middle = apply(invert(answer.a_from_b), answer.center_a[None])[0]
        answers[a, b] = (float(np.linalg.norm(apply(off, middle) - middle)), rotation_angle_rad(off[:3, :3]))
        print(f"{a} and {b}: {answers[a, b][0]:.3f} m, {np.degrees(answers[a, b][1]):.2f} deg off", flush=True)
    right = [error for error in answers.values() if error[0] <= _WRONG_M and error[1] <= _WRONG_RAD]
    of = f"of {len(maps) * (len(maps) - 1) // 2} pairs of {', '.join(maps)}, odometry drifts by a percent"
    figures = [
        figure("campus_pairs_joined", len(right), "", "higher", of, role="tuned on"),
        figure("campus_pairs_wrong", len(answers) - len(right), "", "lower", of, role="tuned on"),
    ]
    if right:
        off_m, off_rad = (float(max(column)) for column in zip(*right, strict=True))
        figures.append(figure("campus_pairs_error_m", off_m, "m", "lower", "of the right ones, the worst"))
        figures.append(figure("campus_pairs_error_deg", float(np.degrees(off_rad)), "deg", "lower"))
    return figures


def _recorded(config: RecordingConfig) -> _Fleet:
    configs = [replace(config, walk_index=i) for i in range(config.robots)]
    logs, truths = zip(*map(cached_recording, configs), strict=True)
    frames = [drawn_frame(one) for one in configs]
    return _Fleet(
        names=tuple(f"robot-{i + 1}" for i in range(config.robots)),
        logs=logs,
        truths=truths,
        robot_from_world=tuple(frame for frame in frames if frame is not None),
    )


def _run(fleet: _Fleet, out: Path, *overrides: str) -> FleetResult:
    print(f"fleet {fleet.logs[0].stem}", flush=True)
    shutil.rmtree(out, ignore_errors=True)  # of a call that was stopped
    robots = (
        Robot(name=name, uris=(str(log),), options=SourceOptions())
        for name, log in zip(fleet.names, fleet.logs, strict=True)
    )
    plan = FleetPlan(
        robots=tuple(robots), config=FleetConfig(every_keyframes=4), out=out, overwrite=False,
        mapper=read_config(MapperConfig, None, overrides), disk=DiskSinkConfig(),
    )  # fmt: skip
    return run_fleet(plan, SimpleNamespace(opened=_ignore, moved=_ignore, said=_ignore))


def _ignore(*_: object) -> None:
    pass


def _room(seed: int, folder: Path) -> dict[str, int]:
    fleet = _recorded(replace(_ROOM, seed=seed))
    return _counted(fleet, _run(fleet, folder / str(seed), *COARSE, "run.workers=1"))


def _counted(fleet: _Fleet, result: FleetResult) -> dict[str, int]:
    wrong = [fleet.is_wrong(event.a, event.b, event.a_from_b) for event in result.events if event.kind == "joined"]
    place = {robot.name: robot.frame_from_robot for robot in result.robots}
    frame = {robot.name: robot.frame for robot in result.robots}
    for a, b in combinations(fleet.names, 2):
        pose_a, pose_b = place[a], place[b]
        if frame[a] == frame[b] and pose_a is not None and pose_b is not None:
            wrong.append(fleet.is_wrong(a, b, invert(pose_a) @ pose_b))
    counts = Counter(joins=len(wrong), wrong=int(sum(wrong)), robots=0, joined=0, undecidable=0)
    for name in fleet.names:
        others = [other for other in fleet.names if other != name]
        if any(fleet.shares(name, other) for other in others):
            counts["robots"] += 1
            counts["joined"] += any(frame[other] == frame[name] for other in others)
        else:
            counts["undecidable"] += 1
    return dict(counts)


def _stranger(seed: int, folder: Path) -> dict[str, int]:
    maps = {f"robot-{i}": folder / str(seed) / f"robot-{i}.map" for i in (1, 2)}
    maps["stranger"] = folder / str(seed + 1) / "robot-1.map"
    with tempfile.TemporaryDirectory() as out:
        found = finish(maps, Path(out), overwrite=False)
    frame = next(frame for frame in found.frames if "stranger" in frame.names)
    return {"joins": len(frame.names) - 1, "wrong": len(frame.names) - 1}


def _apartment(seed: int, folder: Path) -> dict[str, Any]:
    fleet = _recorded(replace(_APARTMENT, seed=seed))
    result = _run(fleet, folder / f"flat-{seed}")
    alone = folder / f"alone-{seed}"
    log, truth = cached_recording(replace(_APARTMENT, seed=seed, robots=0, seconds=_APARTMENT_S * len(fleet.names)))
    play_into(alone, open_source(log), MapperConfig())
    # Objects count as seen as far as both have seen them.
    seen = np.max([[item.seen_fraction for item in one.objects] for one in fleet.truths], axis=0)
    objects = tuple(
        replace(item, seen_fraction=min(share, item.seen_fraction))
        for share, item in zip(seen, truth.objects, strict=True)
    )
    same = replace(truth, objects=objects)
    one, recall_25, recall_50 = _scored(alone, same), 0.0, 0.0
    if result.merged:
        frame_from_world = fleet.robot_from_world[fleet.names.index(result.merged[0].names[0])]
        merged = _scored(result.merged[0].path, moved_truth(same, frame_from_world))
        recall_25, recall_50 = merged.recall_25, merged.recall_50
    losses = {"loss_25": one.recall_25 - recall_25, "loss_50": one.recall_50 - recall_50}
    return {"counts": _counted(fleet, result), **losses}


def _scored(folder: Path, truth: Truth) -> Score:
    saved = open_map(folder)
    return score_map(saved.snapshot, meshes_of(saved), truth)
