"""The process that maps one log of a batch: `python -m hickory_stream.batch.one_log`.

Standard input brings its task, a pickle of its own parent; the last line of standard output is the outcome. The
process ends when the input is closed. It resumes a map folder whose run did not end.
"""

from __future__ import annotations

import errno
import os
import pickle
import socket
import sys
import threading
import time
from contextlib import suppress
from dataclasses import asdict, replace
from typing import TYPE_CHECKING

from hickory_stream.base.json_text import dumps_exactly
from hickory_stream.batch.tasks import LogOutcome, LogTask, State, software
from hickory_stream.errors import HickoryError, MapFolderError

if TYPE_CHECKING:
    from hickory_stream.engine.play import Played
    from hickory_stream.map_folder.writer import MapFolder
    from hickory_stream.ports import Sink

ABANDONED = 75
"""Exit status of a process without a parent."""
_FULL = (errno.ENOSPC, errno.EDQUOT)
# A killed writer of the folder ends soon.
_LOCK_S = 20.0


def main() -> int:
    """Do the task and return the exit status: 0 if there is an outcome, good or bad."""
    task = pickle.load(sys.stdin.buffer)
    threading.Thread(target=_watch_parent, daemon=True).start()
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    answers.write(dumps_exactly(asdict(outcome_of(task))) + "\n")
    answers.flush()
    # Threads of libraries have nothing to say to each other any more.
    os._exit(0)


def _watch_parent() -> None:
    sys.stdin.buffer.read()
    os._exit(ABANDONED)


def outcome_of(task: LogTask) -> LogOutcome:
    """Map a log, and return the outcome; never raises."""
    worker = f"{socket.gethostname()}:{os.getpid()}"
    if software() != task.software:
        reason = f"this worker has {software()}, the batch {task.software}; install the same version on all workers"
        return LogOutcome(name=task.name, state="failed", reason=reason, worker=worker)
    if task.cores:
        with suppress(OSError):  # they may have been taken from us since
            os.sched_setaffinity(0, task.cores)
    started_s, warnings = time.monotonic(), list[str]()
    try:
        _wait_for_lock(task)
        resumes = _is_begun(task)
        played = _mapped(task, resumes=resumes, warnings=warnings)
    except HickoryError as error:
        state: State = "disk full" if _is_disk_full(error) else "failed"
        return LogOutcome(name=task.name, state=state, reason=" ".join(str(error).split()), worker=worker)
    except Exception as error:  # noqa: BLE001 -- the batch reports it, and continues
        return LogOutcome(
            name=task.name, state="failed", reason=f"internal failure, {type(error).__name__}: {error}", worker=worker
        )
    if not played.finished_cleanly:
        return LogOutcome(name=task.name, state="failed", reason="stopped", worker=worker)
    outcome = _told(task, played, worker, time.monotonic() - started_s, resumes=resumes)
    return replace(outcome, reason="; ".join(filter(None, [*warnings, outcome.reason])))


def _is_begun(task: LogTask) -> bool:
    # A map that cannot be resumed is removed.
    from hickory_stream.map_folder.manifest import MANIFEST, read_manifest

    if not (task.out / MANIFEST).is_file():
        return False
    return not read_manifest(task.out).finished_cleanly


def _mapped(task: LogTask, *, resumes: bool, warnings: list[str]) -> Played:
    from hickory_stream.engine.mapper import Mapper
    from hickory_stream.engine.play import play
    from hickory_stream.sinks.disk_sink import DiskSink
    from players import open_from_note
    from players.doctor.motion_mends import check_motion

    source = open_from_note(dict(task.note), keyframes=task.mapper.keyframes)
    try:
        warnings += [] if resumes else check_motion(source, task.note, anyway=task.anyway)
        if resumes:
            mapper = Mapper.resuming(task.out, machine=task.mapper.run)
        else:
            mapper = Mapper(task.mapper, out=task.out, overwrite=True)

        def sinks(folder: MapFolder) -> list[tuple[Sink, bool]]:
            return [(DiskSink(folder, task.disk), True)]

        return play(mapper, source, sinks=sinks, progress=lambda _: None, source_note=dict(task.note))
    finally:
        source.close()


def _wait_for_lock(task: LogTask) -> None:
    from hickory_stream.map_folder.layout import check_unlocked

    until_s = time.monotonic() + _LOCK_S
    while True:
        try:
            return check_unlocked(task.out)
        except MapFolderError:
            if time.monotonic() > until_s:
                raise
            time.sleep(0.2)


def _is_disk_full(error: BaseException | None) -> bool:
    while error is not None:
        if isinstance(error, OSError) and error.errno in _FULL:
            return True
        error = error.__cause__ or error.__context__
    return False


def _told(task: LogTask, played: Played, worker: str, wall_s: float, *, resumes: bool) -> LogOutcome:
    from hickory_stream.map_folder.history.candidates import candidates_of, why_no_objects
    from hickory_stream.map_folder.manifest import read_json
    from players.doctor.report import damage_line

    ledger = read_json(task.out, "ledger.json")
    frames = ledger.get("frames", {})
    objects = 0 if played.snapshot is None else len(played.snapshot.objects)
    children, own = os.times(), time.process_time()
    return LogOutcome(
        name=task.name,
        state="mapped",
        reason="; ".join(
            filter(None, (damage_line(ledger), "" if objects else why_no_objects(ledger, candidates_of(task.out, ()))))
        ),
        digest=played.digest,
        processor=played.processor,
        keyframes=int(frames.get("keyframes", 0)),
        objects=objects,
        wall_s=wall_s,
        cpu_s=own + children.children_user + children.children_system,
        map_mb=sum(path.stat().st_size for path in task.out.rglob("*") if path.is_file()) / 1e6,
        resumed=resumes,
        worker=worker,
    )


if __name__ == "__main__":
    sys.exit(main())
