"""The process of a generator: started once, replaced when it crashes, hangs or grows.

Protocol, in lines of JSON: it says {"ready": true} when its weights are loaded; a job is {"job": NAME, "folder":
PATH}, its answer {"done": NAME}. It ends with its standard input. Standard error is the run's.
"""

import contextlib
import json
import os
import queue
import subprocess
import threading
import time
from pathlib import Path
from typing import Any

import psutil

from hickory_stream.base.json_text import dumps_exactly
from hickory_stream.engine.shape_jobs.generators.spec import GeneratorSpec, missing_of, program_of
from hickory_stream.errors import WorkerError

_LOOK_EVERY_S = 0.1
_MOST_LINE = 1 << 16


class GeneratorLimitError(WorkerError):
    """A generator exceeded its limit of time or memory."""


class GeneratorProcess:
    """One generator; `ask` starts it if necessary."""

    def __init__(self, spec: GeneratorSpec) -> None:
        self.name = spec.name
        self._spec = spec
        self._child: subprocess.Popen[bytes] | None = None
        self._lines: queue.Queue[bytes] = queue.Queue()
        self.most_memory_mb = 0.0

    def start(self) -> dict[str, Any]:
        """Start the program and return its message when it is ready.

        Raises `WorkerError`: it cannot be started, or does not get ready.
        """
        program, missing = program_of(self._spec), missing_of(self._spec)
        if program is None or missing:
            raise WorkerError(f"the generator {self.name} lacks {'; '.join(missing)}")
        try:
            child = subprocess.Popen(
                [program, *self._spec.command[1:]],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                cwd=self._spec.folder,
                env={**os.environ, **dict(self._spec.environment)},
            )
        except OSError as error:
            raise WorkerError(f"the generator {self.name} cannot be started: {error.strerror}") from error
        self._child = child
        self._lines = queue.Queue()
        threading.Thread(target=_read, args=(child, self._lines), name="generator", daemon=True).start()
        try:
            said = self._next(self._spec.start_s, "ready")
        except WorkerError:
            self.close()
            raise
        if said.get("ready") is not True:
            self.close()
            raise WorkerError(f"the generator {self.name} began with {str(said)[:100]}; expected ready")
        return said

    def ask(self, folder: Path, job: str) -> None:
        """Do one job; the answer is in the folder afterwards.

        Raises `WorkerError`: it crashed or gave an invalid answer, and restarts for the next job;
        `GeneratorLimitError`.
        """
        if self._child is None or self._child.poll() is not None:
            self.close()
            self.start()
        assert self._child is not None
        assert self._child.stdin is not None
        try:
            self._child.stdin.write(dumps_exactly({"job": job, "folder": str(folder)}).encode() + b"\n")
            self._child.stdin.flush()
            said = self._next(self._spec.time_s, "an answer")
            if said.get("done") != job:
                raise WorkerError(f"the generator {self.name} answered another job")
        except OSError as error:
            self.close()
            raise WorkerError(f"the generator {self.name} has ended: {error.strerror}") from error
        except WorkerError:
            self.close()
            raise

    def close(self) -> None:
        """End the process and its children."""
        child, self._child = self._child, None
        if child is None:
            return
        with contextlib.suppress(psutil.Error):
            for part in psutil.Process(child.pid).children(recursive=True):
                with contextlib.suppress(psutil.Error):
                    part.kill()
        child.kill()
        child.wait()
        for stream in (child.stdin, child.stdout):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()

    def _next(self, limit_s: float, what: str) -> dict[str, Any]:
        until_s = time.monotonic() + limit_s
        while True:
            try:
                line = self._lines.get(timeout=_LOOK_EVERY_S)
            except queue.Empty:
                memory = self._memory_mb()
                self.most_memory_mb = max(self.most_memory_mb, memory)
                if memory > self._spec.memory_mb:
                    limit = f"{self._spec.memory_mb:g} MB (its memory_mb)"
                    raise GeneratorLimitError(f"the generator {self.name} took more than {limit}") from None
                if time.monotonic() > until_s:
                    reason = f"gave no sign of {what} within {limit_s:g} s"
                    raise GeneratorLimitError(f"the generator {self.name} {reason}") from None
                continue
            if not line:
                assert self._child is not None
                raise WorkerError(f"the generator {self.name} ended with status {self._child.wait()}")
            try:
                said = json.loads(line)
            except (ValueError, RecursionError) as error:
                raise WorkerError(f"the generator {self.name} printed what is no JSON: {line[:80]!r}") from error
            if not isinstance(said, dict):
                raise WorkerError(f"the generator {self.name} said {str(said)[:80]}; expected an object")
            return said

    def _memory_mb(self) -> float:
        if self._child is None:
            return 0.0
        total = 0
        with contextlib.suppress(psutil.Error):
            whole = psutil.Process(self._child.pid)
            for part in [whole, *whole.children(recursive=True)]:
                with contextlib.suppress(psutil.Error):
                    total += part.memory_info().rss
        return total / 1e6


def _read(child: subprocess.Popen[bytes], lines: queue.Queue[bytes]) -> None:
    # An empty line is the end.
    assert child.stdout is not None
    with contextlib.suppress(OSError, ValueError):
        while line := child.stdout.readline(_MOST_LINE):
            lines.put(line)
    lines.put(b"")
