"""The tasks of a batch on this machine: so many at a time, each with its share of the processors."""

from __future__ import annotations

import os
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from queue import SimpleQueue
from typing import TYPE_CHECKING

from hickory_stream.batch.child import CHILDREN, run_task, with_cores

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from hickory_stream.batch.tasks import LogOutcome, LogTask


def outcomes_here(tasks: Sequence[LogTask], workers: int) -> Iterator[LogOutcome]:
    """Yield what comes of the tasks, as they end. Whoever closes the iterator before its end ends what runs."""
    is_stopped = False
    shares: SimpleQueue[tuple[int, ...]] = SimpleQueue()
    for share in _shares(workers):
        shares.put(share)

    def run(task: LogTask) -> LogOutcome:
        share = shares.get()
        try:
            return run_task(with_cores(task, share) if share else task, lambda: is_stopped)
        finally:
            shares.put(share)

    with ThreadPoolExecutor(workers) as pool:
        open_ = {pool.submit(run, task) for task in tasks}
        try:
            while open_:
                done, open_ = wait(open_, return_when=FIRST_COMPLETED)
                for one in done:
                    yield one.result()
        finally:
            is_stopped = True
            for one in open_:
                one.cancel()
            CHILDREN.kill()


def _shares(workers: int) -> list[tuple[int, ...]]:
    """Return the processors of each worker; () for all, where there are fewer processors than workers."""
    if not hasattr(os, "sched_getaffinity"):
        return [()] * workers
    cores = sorted(os.sched_getaffinity(0))
    return [tuple(cores[i::workers]) for i in range(workers)] if workers <= len(cores) else [()] * workers
