"""A task in its own process, started from any thread of any worker: a crash costs one attempt."""

import json
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace

from hickory_stream.batch.tasks import LogOutcome, LogTask

_ATTEMPTS = 3
COMMAND = (sys.executable, "-m", "hickory_stream.batch.one_log")


def run_task(task: LogTask, is_stopped: Callable[[], bool] = lambda: False) -> LogOutcome:
    """Map a log and return the outcome.

    A killed process is started again and resumes, unless `is_stopped`.
    """
    status = 0
    for _ in range(_ATTEMPTS):
        outcome, status = _attempt(task)
        if outcome is not None:
            return outcome
        if is_stopped():
            return LogOutcome(name=task.name, state="failed", reason="stopped")
    reason = f"its process ended with {_status_text(status)}, {_ATTEMPTS} times"
    return LogOutcome(name=task.name, state="failed", reason=reason)


CHILDREN: set[subprocess.Popen[bytes]] = set()
"""Running processes, to end them together; their maps can be resumed."""


def _attempt(task: LogTask) -> tuple[LogOutcome | None, int]:
    environment = dict(os.environ)
    if task.cores:
        # Pools of threads are made for as many processors as the process may use.
        environment |= {name: str(len(task.cores)) for name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS")}
    with subprocess.Popen(
        COMMAND,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=environment,
        # Ctrl-C is for the batch, which then ends its processes.
        start_new_session=True,
    ) as process:
        CHILDREN.add(process)
        try:
            assert process.stdin is not None
            assert process.stdout is not None
            try:
                process.stdin.write(pickle.dumps(task))
                process.stdin.flush()
            except BrokenPipeError:
                return None, process.wait()
            line = process.stdout.readline()
            status = process.wait()
        finally:
            CHILDREN.discard(process)
            process.kill()
    try:
        return LogOutcome(**json.loads(line)), status
    except (ValueError, TypeError):
        return None, status


def _status_text(status: int) -> str:
    return f"signal {signal.Signals(-status).name}" if status < 0 else f"status {status}"


def with_cores(task: LogTask, cores: tuple[int, ...]) -> LogTask:
    """Return a task for some processors, with as many shape workers at most."""
    mapper = task.mapper
    return replace(task, cores=cores, mapper=replace(mapper, run=replace(mapper.run, workers=max(1, len(cores)))))
