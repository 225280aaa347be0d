"""The main of a shape worker: one line in, a job folder; one line out, its success.

Standard output is the protocol: a reconstructor's own output goes to standard error.
"""

import contextlib
import gc
import json
import os
import queue
import signal
import sys
import threading
from pathlib import Path
from typing import Any

from hickory_stream.base.json_text import dumps_exactly
from hickory_stream.engine.first_run import are_compiled
from hickory_stream.engine.shape_jobs.generators.choose import reconstructor_of
from hickory_stream.engine.shape_jobs.job_folder import read_job, write_result
from hickory_stream.ports import NoShape
from hickory_stream.shapes.build import build_shape


def main() -> None:
    """Serve jobs until standard input ends; a running job is then left at once."""
    answers = os.dup(1)
    os.dup2(2, 1)
    jobs: queue.Queue[str] = queue.Queue()
    threading.Thread(target=_listen, args=(jobs,), name="listen", daemon=True).start()
    if not are_compiled():
        # Its imports are needed only here.
        from hickory_stream.engine.warm_up import warm_up

        warm_up()
    # What was imported stays: it need not be looked through for garbage, which took a hundredth of the time of a job.
    gc.freeze()
    with contextlib.suppress(BrokenPipeError):
        _say(answers, {"ready": os.getpid()})
        while True:
            folder = Path(json.loads(jobs.get())["job"])
            _say(answers, {"done": str(folder), "error": serve(folder)})


def _listen(jobs: queue.Queue[str]) -> None:
    for line in sys.stdin:
        jobs.put(line)
    if hasattr(os, "killpg") and os.getpgrp() == os.getpid():
        # Its group: a generator that it started, and that hangs, ends with it.
        os.killpg(0, signal.SIGKILL)
    os._exit(0)


def _say(answers: int, message: dict[str, Any]) -> None:
    os.write(answers, dumps_exactly(message).encode() + b"\n")


def serve(folder: Path) -> str | None:
    """Do one job; return why the worker failed, None if it answered."""
    try:
        inputs, config = read_job(folder)
        built = build_shape(inputs, reconstructor_of(config), config)
    except Exception as error:  # noqa: BLE001 -- the child's main loop: a poisonous job must not end the worker
        built = NoShape(reason=f"{type(error).__name__}: {error}")
    try:
        write_result(folder, built, config.reconstructor if not isinstance(built, NoShape) else "")
    except OSError as error:
        return str(error)
    return None


if __name__ == "__main__":
    main()
