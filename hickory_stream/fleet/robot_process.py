"""The process that maps one robot into its folder, and sends `Opened`, `Moved`, `GrownMap`s, and last `Ended`.

A process that ends without `Ended` has died.
"""

from __future__ import annotations

import logging
import os
import signal
import threading
import time
import traceback
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hickory_stream.errors import HickoryError
from hickory_stream.fleet.growth import GrowthSink
from hickory_stream.fleet.messages import Ended, Message, Moved, Opened

if TYPE_CHECKING:
    from multiprocessing.connection import Connection
    from pathlib import Path

    from hickory_stream.config import MapperConfig
    from hickory_stream.engine.modes import Progress
    from hickory_stream.fleet.robots import Robot
    from hickory_stream.map_folder.writer import MapFolder
    from hickory_stream.ports import Sink, Source
    from hickory_stream.sinks.disk_sink import DiskSinkConfig

_TELL_EVERY_S = 0.2


@dataclass(frozen=True, kw_only=True, slots=True)
class RobotTask:
    """Task of a process; `most_s` and `patience_s` are for live robots, `resumes` continues an existing map."""

    robot: Robot
    out: Path
    overwrite: bool
    resumes: bool
    mapper: MapperConfig
    disk: DiskSinkConfig
    every_keyframes: int
    most_s: float | None
    patience_s: float
    debug: bool
    anyway: bool = False


def main(task: RobotTask, connection: Connection) -> None:
    """Map a robot, and send its messages."""
    if hasattr(os, "setpgrp"):
        os.setpgrp()  # Ctrl-C is for the fleet, which then stops its robots in order
    name = task.robot.name
    level = logging.DEBUG if task.debug else logging.WARNING
    logging.basicConfig(level=level, format=f"{name}: %(levelname)s: %(message)s")
    link = _Link(connection)
    try:
        listen()
        ended = _mapped(task, link)
    except HickoryError as error:
        ended = Ended(is_finished=False, reason=" ".join(str(error).split()))
    except KeyboardInterrupt:
        ended = Ended(is_finished=False, was_stopped=True, reason="cancelled")
    except BrokenPipeError:
        return  # the fleet is gone
    except Exception as error:  # noqa: BLE001 -- the process's main function: the fleet reports it, and continues
        if task.debug:
            traceback.print_exc()
        ended = Ended(is_finished=False, reason=f"internal failure, {type(error).__name__}: {error}")
    link.send(ended)
    connection.close()


def listen() -> None:
    """Receive signals, also those that came since this process was begun."""
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGINT, signal.SIGTERM))


class _Link:
    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._lock = threading.Lock()

    def send(self, message: Message) -> None:
        # Raises `BrokenPipeError` when the fleet has gone.
        with self._lock:
            self._connection.send(message)


def _mapped(task: RobotTask, link: _Link) -> Ended:
    from hickory_stream.engine.mapper import Mapper
    from hickory_stream.engine.play import play
    from hickory_stream.fleet.resuming import has_ended, send_recorded
    from hickory_stream.map_folder.history.candidates import candidates_of, why_no_objects
    from hickory_stream.map_folder.history.replay import show_until_resumed
    from hickory_stream.map_folder.manifest import is_map_folder, read_json
    from hickory_stream.sinks.disk_sink import DiskSink
    from players.doctor.motion_mends import check_motion
    from players.doctor.report import damage_line

    span = _Span()
    resumes = task.resumes and is_map_folder(task.out)
    if resumes and has_ended(task.out):
        digest, reason = send_recorded(task.out, task.every_keyframes, link.send, span)
        return Ended(
            is_finished=not reason,
            was_stopped=bool(reason),
            reason=reason,
            digest=digest,
            start_ns=span.start_ns,
            end_ns=span.end_ns,
        )
    source, note = _opened(task)
    try:
        warnings = [] if resumes or task.robot.is_live else check_motion(source, note, anyway=task.anyway)
        streams = (f"  {role}: {topic}" for role, topic in source.info.streams)
        link.send(Opened(text=(f"{source.info.kind}: {source.info.uri}", *streams)))
        if resumes:
            mapper = Mapper.resuming(task.out, machine=task.mapper.run)
        else:
            mapper = Mapper(task.mapper, out=task.out, overwrite=task.overwrite)

        growth = GrowthSink(task.every_keyframes, mapper.extractor_name, link.send)
        if resumes:
            show_until_resumed(task.out, (growth, span))

        def sinks(folder: MapFolder) -> list[tuple[Sink, bool]]:
            return [(DiskSink(folder, task.disk), True), (growth, True), (span, True)]

        played = play(
            mapper,
            source,
            sinks=sinks,
            progress=_Teller(link),
            mode="live" if task.robot.is_live else "playback",
            source_note=note,
        )
    finally:
        source.close()
    ledger = read_json(task.out, "ledger.json")
    damage = damage_line(ledger)
    empty = (
        ""
        if played.snapshot is not None and played.snapshot.objects
        else why_no_objects(ledger, candidates_of(task.out, ()))
    )
    return Ended(
        is_finished=played.finished_cleanly,
        was_stopped=played.was_stopped,
        reason="" if played.finished_cleanly else "stopped",
        digest=played.digest,
        start_ns=span.start_ns,
        end_ns=span.end_ns,
        notes=tuple(text for text in (*warnings, damage, empty, *played.lost_outputs) if text),
    )


def _opened(task: RobotTask) -> tuple[Source, dict[str, Any]]:
    robot = task.robot
    if robot.is_live:
        from players.live import open_live

        source = open_live(robot.uris[0], robot.options, patience_s=task.patience_s, most_s=task.most_s)
        return source, robot.note
    from players import open_from_note

    return open_from_note(robot.note, keyframes=task.mapper.keyframes), robot.note


class _Teller:
    def __init__(self, link: _Link) -> None:
        self._link = link
        self._told_s = 0.0
        self._phase = ""

    def __call__(self, progress: Progress) -> None:
        now_s = time.monotonic()
        if now_s - self._told_s >= _TELL_EVERY_S or progress.phase != self._phase:
            self._told_s, self._phase = now_s, progress.phase
            self._link.send(Moved(progress=progress))


class _Span:
    def __init__(self) -> None:
        self.start_ns: int | None = None
        self.end_ns: int | None = None

    def show(self, report: Any) -> None:
        self.start_ns = report.stamp_ns if self.start_ns is None else min(self.start_ns, report.stamp_ns)
        self.end_ns = report.stamp_ns if self.end_ns is None else max(self.end_ns, report.stamp_ns)

    def close(self) -> None:
        pass
