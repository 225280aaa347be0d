"""Shape workers: child processes of this machine, started when the first jobs need them, replaced when they die.

A job's answer is a future; how many workers there are and how fast they are changes when it comes, never what it is.
"""

from __future__ import annotations

import asyncio
import json
import logging
import os
import sys
from typing import TYPE_CHECKING

from hickory_stream.errors import WorkerError

if TYPE_CHECKING:
    from pathlib import Path

logger = logging.getLogger(__name__)

_START_TIMEOUT_S = 60.0
_ATTEMPTS = 2
# One thread each: the workers share the machine, and sums that are split differently differ in their last bits.
_ENVIRONMENT = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")


class LocalWorkers:
    """`count` child processes that take jobs from one queue. Enter with `async with`; leaving kills what still runs."""

    def __init__(self, count: int, timeout_s: float) -> None:
        if count < 1:
            raise ValueError(f"found {count} workers, expected at least 1")
        self._count = count
        self._timeout_s = timeout_s
        self._jobs: asyncio.Queue[tuple[Path, asyncio.Future[str | None]]] = asyncio.Queue()
        self._tasks: list[asyncio.Task[None]] = []
        self._num_open = 0
        self.num_timeouts = 0

    async def __aenter__(self) -> LocalWorkers:
        return self

    async def __aexit__(self, *_: object) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self._tasks.clear()

    @property
    def num_open(self) -> int:
        """How many jobs wait or run."""
        return self._num_open

    def submit(self, folder: Path) -> asyncio.Future[str | None]:
        """Queue a job; the future gives None when its answer lies in the folder, else why the job was given up."""
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
        """Feed one child with jobs; a child that dies or hangs is replaced, and its job tried once more."""
        child: _Child | None = None
        try:
            while True:
                folder, answer = await self._jobs.get()
                if answer.cancelled():
                    continue
                reason: str | None = None
                for _ in range(_ATTEMPTS):
                    try:
                        child = child or await _Child.start()
                        reason = await child.run(folder, self._timeout_s)
                        break
                    except TimeoutError:
                        self.num_timeouts += 1
                        reason = f"no answer within {self._timeout_s:.0f} s"
                    except WorkerError as error:
                        reason = str(error)
                    if child is not None:
                        await child.kill()
                        child = None
                    logger.warning("shape job %s: %s", folder.name, reason)
                if not answer.done():
                    answer.set_result(reason)
        finally:
            if child is not None:
                await child.kill()


class _Child:
    """One worker process, spoken to in lines of JSON."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process

    @classmethod
    async def start(cls) -> _Child:
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "hickory_stream.engine.shape_worker",
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            env={**os.environ, **_ENVIRONMENT},
            # A group of its own: Ctrl-C is for the run, which then ends its workers in order.
            start_new_session=True,
        )
        child = cls(process)
        try:
            await child._answer(_START_TIMEOUT_S)
        except (WorkerError, TimeoutError) as error:
            await child.kill()
            raise WorkerError(f"a shape worker did not start: {error}") from error
        except asyncio.CancelledError:
            await child.kill()
            raise
        return child

    async def run(self, folder: Path, timeout_s: float) -> str | None:
        """Do one job; return why it failed, None if it was answered.

        Raises:
            WorkerError: the child died.
            TimeoutError: it took too long.
        """
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps({"job": str(folder)}).encode() + b"\n")
            await self._process.stdin.drain()
        except (BrokenPipeError, ConnectionResetError) as error:
            raise WorkerError("the shape worker has ended") from error
        answer = json.loads(await self._answer(timeout_s))
        error_text: str | None = answer["error"]
        return error_text

    async def kill(self) -> None:
        """End the process and wait for it."""
        if self._process.returncode is None:
            try:
                self._process.kill()
            except ProcessLookupError:
                pass
        await self._process.wait()

    async def _answer(self, timeout_s: float) -> bytes:
        assert self._process.stdout is not None
        line = await asyncio.wait_for(self._process.stdout.readline(), timeout_s)
        if not line:
            raise WorkerError(f"the shape worker ended with status {await self._process.wait()}")
        return line
