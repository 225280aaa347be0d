"""A fleet from its robots to its merged map: processes, rounds, joins, recording, end."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
from threadpoolctl import threadpool_limits

from hickory_stream.config import MapperConfig
from hickory_stream.engine.modes import Progress
from hickory_stream.errors import InputError
from hickory_stream.fleet.crew import run_crew
from hickory_stream.fleet.finish import Finished, finish, merged_path, why_alone
from hickory_stream.fleet.growth import GrownMap, Round, Rounds
from hickory_stream.fleet.joins import Frame, JoinEvent, Joins, Joint
from hickory_stream.fleet.messages import Ended, Message, Moved, Opened
from hickory_stream.fleet.result import FleetResult, result_of
from hickory_stream.fleet.resuming import check_same
from hickory_stream.fleet.robot_process import RobotTask
from hickory_stream.fleet.robots import FLEET, FleetConfig, Robot
from hickory_stream.map_folder.manifest import is_map_folder
from hickory_stream.merging.joining import JoiningConfig
from hickory_stream.records import MapSnapshot
from hickory_stream.sinks.disk_sink import DiskSinkConfig
from hickory_stream.sinks.rerun.config import RerunConfig
from hickory_stream.sinks.rerun.fleet import FleetRecording, ShownRobot
from hickory_stream.sinks.rerun.viewer import ViewerChoice, ViewerKind, check_viewer


@dataclass(frozen=True, kw_only=True, slots=True)
class FleetPlan:
    """Plan of a fleet's run into the folder `out`; `overwrite` replaces existing maps, `resumes` continues them."""

    robots: tuple[Robot, ...]
    config: FleetConfig
    out: Path
    overwrite: bool
    resumes: bool = False
    mapper: MapperConfig
    disk: DiskSinkConfig
    rerun: RerunConfig = field(default_factory=RerunConfig)
    viewer: ViewerChoice = field(default_factory=lambda: ViewerChoice(kind=ViewerKind.NONE))
    debug: bool = False
    anyway: bool = False

    def map_of(self, name: str) -> Path:
        """Return the map folder of a robot."""
        return self.out / f"{name}.map"

    @property
    def rrd(self) -> Path:
        """The recording of all robots."""
        return self.out / f"{FLEET}.rrd"


class Watcher(Protocol):
    """Receives the progress of a fleet."""

    def opened(self, name: str, lines: Sequence[str]) -> None:
        """Receive the streams of a robot's log."""

    def moved(self, name: str, progress: Progress) -> None:
        """Receive the progress of a robot."""

    def said(self, text: str) -> None:
        """Receive an event as a line."""


def run_fleet(plan: FleetPlan, watcher: Watcher) -> FleetResult:
    """Map all robots, join them while they grow, and merge joined maps.

    Raises `InputError` for a missing log, an existing `out`, or no map at all; a second signal `KeyboardInterrupt`.
    """
    _check(plan)
    names = [robot.name for robot in plan.robots]
    rounds = Rounds(names, waits=not any(robot.is_live for robot in plan.robots))
    folders = {name: plan.map_of(name) for name in names}
    processes = plan.config.processes or _processors()
    # Sums that are split differently differ in their last bits.
    with threadpool_limits(limits=1, user_api="blas"), _recording(plan, watcher) as recording:
        run = _Run(rounds, recording, watcher, plan.config.joining)
        ended = run_crew([_task(plan, robot) for robot in plan.robots], processes, run.hear)
        ended = {name: ended[name] for name in names}
        usable = {name: folders[name] for name in names if ended[name].is_finished or ended[name].was_stopped}
        finished = finish(
            usable, plan.out, overwrite=plan.overwrite or plan.resumes, tell=watcher.said, joining=plan.config.joining
        )
        if not finished.maps and not any(one.was_stopped for one in ended.values()):
            raise InputError(f"no robot gave a map ({', '.join(ended)}): each reason is above")
        run.show_end(finished)
    return result_of(ended, folders, run.keyframes, finished, run.events)


class _Run:
    def __init__(self, rounds: Rounds, recording: FleetRecording, watcher: Watcher, joining: JoiningConfig) -> None:
        self._rounds = rounds
        self._recording = recording
        self._watcher = watcher
        self._joins = Joins(joining)
        self._last: Round | None = None
        self.keyframes: dict[str, int] = {}
        self.events: list[JoinEvent] = []

    def hear(self, name: str, message: Message) -> None:
        match message:
            case Opened():
                self._watcher.opened(name, message.text)
            case Moved():
                self._watcher.moved(name, message.progress)
            case GrownMap():
                self.keyframes[name] = message.keyframes
                self._rounds.add(name, message)
            case Ended():
                if message.reason:
                    self._watcher.said(f"{name}: {message.reason}")
                self._rounds.end(name)
        for found in self._rounds.complete():
            self._last = found
            joint = self._joins.update(found)
            self._show(found, joint)

    def _show(self, found: Round, joint: Joint) -> None:
        texts = [event_text(event) for event in joint.events]
        for text in texts:
            self._watcher.said(text)
        self.events += joint.events
        shown = [
            _shown(name, grown.snapshot, joint.frames, grown.world_from_camera if name in found.grown else None)
            for name, grown in found.maps.items()
        ]
        self._recording.show(found.keyframe, shown, texts)

    def show_end(self, finished: Finished) -> None:
        if self._last is None:
            return
        snapshots = {name: grown.snapshot for name, grown in self._last.maps.items()}
        snapshots |= {name: saved.snapshot for name, saved in finished.maps.items()}
        shown = [_shown(name, snapshot, finished.frames, None) for name, snapshot in snapshots.items()]
        self._recording.show(self._last.keyframe + 1, shown, end_texts(finished))


def end_texts(finished: Finished) -> list[str]:
    """Return a line for each merged map, and for each robot alone, with the reason."""
    texts = [f"the finished maps of {', '.join(merged.names)} are merged" for merged in finished.merged]
    alone = [frame.names[0] for frame in finished.frames if len(frame.names) == 1]
    texts = texts or ["no two of the finished maps are joined"]
    return texts + [f"{name} is in no other robot's frame: {why_alone(name, finished.answers)}" for name in alone]


def event_text(event: JoinEvent) -> str:
    """Return a join or its withdrawal as a line."""
    after = f"after {event.keyframe} keyframes"
    if event.kind == "joined":
        return f"{after}: {event.a} and {event.b} are joined by {event.num_pairs} pairs, {100 * event.sigma_m:.1f} cm"
    return f"{after}: {event.a} and {event.b} are no longer joined"


def _recording(plan: FleetPlan, watcher: Watcher) -> FleetRecording:
    recording = FleetRecording(plan.rrd, [robot.name for robot in plan.robots], plan.rerun, plan.viewer)
    if recording.web_url:
        watcher.said(f"viewer: {recording.web_url}")
    return recording


def _shown(
    name: str,
    snapshot: MapSnapshot,
    frames: Sequence[Frame],
    poses: np.ndarray[tuple[int, ...], np.dtype[np.float64]] | None,
) -> ShownRobot:
    frame = next((frame for frame in frames if name in frame.names), None)
    return ShownRobot(
        name=name,
        stamp_ns=snapshot.stamp_ns,
        objects=snapshot.objects,
        world_from_camera=np.empty((0, 4, 4)) if poses is None else poses,
        frame=name if frame is None else frame.names[0],
        frame_from_robot=np.eye(4) if frame is None else frame.frame_from_robot[frame.names.index(name)],
    )


def _task(plan: FleetPlan, robot: Robot) -> RobotTask:
    return RobotTask(
        robot=robot,
        out=plan.map_of(robot.name),
        overwrite=plan.overwrite,
        resumes=plan.resumes,
        mapper=plan.mapper,
        disk=plan.disk,
        every_keyframes=plan.config.every_keyframes,
        most_s=plan.config.for_s or None,
        patience_s=plan.config.patience_s,
        debug=plan.debug,
        anyway=plan.anyway,
    )


def _check(plan: FleetPlan) -> None:
    check_viewer(plan.viewer)
    for robot in plan.robots:
        missing = [uri for uri in robot.uris if not robot.is_live and not Path(uri).exists()]
        if missing:
            raise InputError(f"robot {robot.name}: there is no {missing[0]}; name its log, or a live URI")
    if plan.out.exists() and not plan.out.is_dir():
        raise InputError(f"{plan.out} is a file, expected a folder to make; choose another -o")
    own = {plan.map_of(robot.name): robot for robot in plan.robots}
    made = [*own, *(merged_path(plan.out, place) for place in range(len(plan.robots) // 2))]
    taken = [path for path in (*made, plan.rrd) if path.exists()]
    if taken and not (plan.overwrite or plan.resumes):
        raise InputError(
            f"{taken[0]} exists; replace it with --overwrite, continue with --resume, or choose another -o"
        )
    foreign = [path for path in made if path.exists() and not is_map_folder(path)]
    if foreign:
        raise InputError(f"{foreign[0]} is no map folder and is not replaced; choose another -o")
    if plan.resumes:
        begun = {path: robot for path, robot in own.items() if path.exists()}
        if not begun:
            raise InputError(f"{plan.out} has no map of any of these robots: there is nothing to --resume")
        for path, robot in begun.items():
            check_same(path, robot)
    try:
        plan.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make the folder {plan.out}: {error.strerror}") from error


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
