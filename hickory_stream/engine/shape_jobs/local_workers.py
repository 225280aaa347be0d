"""Shape workers as child processes, started with the first jobs, replaced when they die.

Number and speed of workers change when an answer comes, never what it is.
"""

import asyncio
import json
import logging
import os
import shutil
import signal
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, Self

import psutil

from hickory_stream.base.caches import cache_root
from hickory_stream.base.json_text import dumps_exactly
from hickory_stream.engine.shape_jobs.generators.spec import CHOICE_VARIABLE
from hickory_stream.errors import ConfigError, WorkerError

logger = logging.getLogger(__name__)

# The first one on a machine compiles the kernels, and the others wait for it.
_START_TIMEOUT_S = 600.0
_ATTEMPTS = 3
_LIMIT_ATTEMPTS = 2
_LOOK_EVERY_S = 0.25
# One thread each: the workers share the machine, and sums that are split differently differ in their last bits.
_ENVIRONMENT = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")


class ShapeWorkers(Protocol):
    """Executor of shape jobs. Enter with `async with`; leaving ends running jobs."""

    #: Jobs given up at a limit, or because their worker died: such a run depends on the machine.
    num_limits: int

    @property
    def num_open(self) -> int:
        """Number of waiting or running jobs."""

    @property
    def num_alive(self) -> int:
        """Number of workers now."""

    def submit(self, folder: Path) -> asyncio.Future[str | None]:
        """Queue a job; the future gives None for an answer in the folder, else why the job was given up."""

    async def __aenter__(self) -> Self: ...

    async def __aexit__(self, *_: object) -> None: ...


@dataclass(frozen=True, kw_only=True, slots=True)
class WorkerLimits:
    """Limits of one job: seconds, and megabytes of resident memory of its worker."""

    time_s: float
    memory_mb: float


class LocalWorkers:
    """`count` child processes with one queue; `python` is their interpreter, ours by default.

    `generator` is the TOML of the program for the reconstructor "external". Raises `ConfigError`: no such interpreter.
    """

    def __init__(self, count: int, limits: WorkerLimits, python: str = "", generator: Path | None = None) -> None:
        if count < 1:
            raise ValueError(f"found {count} workers, expected at least 1")
        self._count = count
        self._limits = limits
        self._python = _interpreter(python)
        self._environment = {} if generator is None else {CHOICE_VARIABLE: str(generator)}
        self._jobs: asyncio.Queue[tuple[Path, asyncio.Future[str | None]]] = asyncio.Queue()
        self._tasks: list[asyncio.Task[None]] = []
        self._num_open = 0
        self._children: set[_Child] = set()
        self.num_limits = 0
        #: Of children that are started from now on, as nice(1) counts.
        self.niceness = 0

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self._tasks.clear()

    @property
    def num_open(self) -> int:
        """Number of waiting or running jobs."""
        return self._num_open

    @property
    def num_alive(self) -> int:
        """Number of children now."""
        return len(self._children)

    def submit(self, folder: Path) -> asyncio.Future[str | None]:
        """Queue a job; the future gives None for an answer in the folder, else why the job was given up."""
        answer: asyncio.Future[str | None] = asyncio.get_running_loop().create_future()
        self._num_open += 1
        answer.add_done_callback(self._closed)
        self._jobs.put_nowait((folder, answer))
        if len(self._tasks) < min(self._count, self._num_open):
            self._tasks.append(asyncio.create_task(self._serve(), name=f"shape-worker-{len(self._tasks)}"))
        return answer

    def _closed(self, _: object) -> None:
        self._num_open -= 1

    async def _serve(self) -> None:
        # A child that dies, hangs or grows is replaced, and its job tried again.
        child: _Child | None = None
        try:
            while True:
                folder, answer = await self._jobs.get()
                if answer.cancelled():
                    continue
                reason: str | None = None
                is_answered, num_limits = False, 0
                for _ in range(_ATTEMPTS):
                    try:
                        child = child or await self._start()
                        reason = await child.run(folder, self._limits)
                        is_answered = True
                        break
                    except LimitError as error:
                        reason = str(error)
                        # A second try is for a busy machine.
                        num_limits += 1
                    except WorkerError as error:
                        reason = str(error)
                    if child is not None:
                        await self._end(child)
                        child = None
                    logger.warning("shape job %s: %s", folder.name, reason)
                    if answer.cancelled() or num_limits == _LIMIT_ATTEMPTS:
                        break
                self.num_limits += not is_answered and not answer.cancelled()
                if not answer.done():
                    answer.set_result(reason)
        finally:
            if child is not None:
                await self._end(child)

    async def _start(self) -> "_Child":
        child = await _Child.start(self._python, self.niceness, self._environment)
        self._children.add(child)
        return child

    async def _end(self, child: "_Child") -> None:
        self._children.discard(child)
        await child.kill()


class LimitError(WorkerError):
    """A job exceeded its limit of time or memory."""


class _Child:
    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process

    @classmethod
    async def start(cls, python: str, niceness: int, environment: Mapping[str, str]) -> "_Child":
        try:
            process = await asyncio.create_subprocess_exec(
                *(python, "-m", "hickory_stream.engine.shape_jobs.worker"),
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                # The same caches as ours, wherever they are.
                env={**os.environ, **_ENVIRONMENT, **environment, "HICKORY_CACHE": str(cache_root())},
                # A group of its own: Ctrl-C is for the run, which then ends its workers in order.
                start_new_session=True,
            )
        except OSError as error:
            raise WorkerError(f"cannot start a shape worker with {python}: {error.strerror or error}") from error
        child = cls(process)
        if niceness:
            with suppress(ProcessLookupError):
                os.setpriority(os.PRIO_PROCESS, process.pid, niceness)
        try:
            await asyncio.wait_for(child._answer(), _START_TIMEOUT_S)
        except (WorkerError, TimeoutError) as error:
            await child.kill()
            why = f"not ready within {_START_TIMEOUT_S:.0f} s" if isinstance(error, TimeoutError) else str(error)
            raise WorkerError(f"a shape worker did not start: {why}") from error
        except asyncio.CancelledError:
            await child.kill()
            raise
        return child

    async def run(self, folder: Path, limits: WorkerLimits) -> str | None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(dumps_exactly({"job": str(folder)}).encode() + b"\n")
            await self._process.stdin.drain()
        except (BrokenPipeError, ConnectionResetError) as error:
            raise WorkerError("the shape worker has ended") from error
        line = asyncio.create_task(self._answer(), name="answer")
        try:
            await self._watch(line, limits)
            answer = json.loads(await line)
            reason: str | None = answer["error"]
        except (ValueError, KeyError, TypeError) as error:
            raise WorkerError(f"the shape worker gave an invalid answer: {error}") from error
        finally:
            line.cancel()
            await asyncio.gather(line, return_exceptions=True)
        return reason

    async def kill(self) -> None:
        if self._process.returncode is None:
            # Its group: a generator that it started, and that hangs, ends with it.
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid, signal.SIGKILL)
            with suppress(ProcessLookupError):
                self._process.kill()
        await self._process.wait()

    async def _watch(self, line: asyncio.Task[bytes], limits: WorkerLimits) -> None:
        until_s = time.monotonic() + limits.time_s
        while not line.done():
            left_s = until_s - time.monotonic()
            if left_s <= 0:
                raise LimitError(f"no answer within {limits.time_s:g} s (run.job_timeout_s)")
            if self._memory_mb() > limits.memory_mb:
                raise LimitError(f"more than {limits.memory_mb:g} MB of memory (run.job_memory_mb)")
            await asyncio.wait({line}, timeout=min(left_s, _LOOK_EVERY_S))

    def _memory_mb(self) -> float:
        try:
            return float(psutil.Process(self._process.pid).memory_info().rss) / 1e6
        except psutil.Error:  # it has just ended
            return 0.0

    async def _answer(self) -> bytes:
        assert self._process.stdout is not None
        line = await self._process.stdout.readline()
        if not line:
            raise WorkerError(f"the shape worker ended with {_status(await self._process.wait())}")
        return line


def _interpreter(python: str) -> str:
    if not python:
        return sys.executable
    found = shutil.which(python)
    if found is None:
        raise ConfigError(f"run.worker_python is {python}, which is no program; name a Python interpreter")
    return found


def _status(code: int) -> str:
    if code >= 0:
        return f"status {code}"
    try:
        return f"signal {signal.Signals(-code).name}"
    except ValueError:
        return f"signal {-code}"
