"""The tasks of a batch on this machine, or on an existing Dask cluster.

Workers of a cluster read logs and write maps at the same paths, on shared disks. Dask repeats a lost worker's task on
another one, which resumes the map.
"""

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from queue import SimpleQueue
from typing import Any

from hickory_stream.batch.child import CHILDREN, run_task, with_cores
from hickory_stream.batch.tasks import LogOutcome, LogTask, software
from hickory_stream.errors import ConfigError, WorkerError

_CONNECT_S = 10.0


def outcomes_on(address: str, tasks: Sequence[LogTask]) -> Iterator[LogOutcome]:
    """Yield the outcomes of the tasks as they end.

    Raises `ConfigError` without Dask, a cluster or a worker of this version, `WorkerError` for a lost cluster.
    """
    try:
        from distributed import Client, as_completed
    except ImportError as error:
        raise ConfigError("workers on a cluster need Dask: pip install 'hickory-stream[dask]'") from error
    try:
        client = Client(address, timeout=_CONNECT_S, set_as_default=False, name="hickory-stream batch")
    except (OSError, TimeoutError, ValueError) as error:
        raise ConfigError(
            f"no Dask scheduler answers at {address}; start one with `dask scheduler`, or use --workers N"
        ) from error
    with client, client.as_current():
        _check_workers(client, address)
        handed = [client.submit(run_task, task, key=f"hickory-batch-{task.name}", pure=False) for task in tasks]
        try:
            for future in as_completed(handed):
                yield future.result()
        except Exception as error:
            raise WorkerError(
                f"the cluster at {address} was lost: {' '.join(str(error).split()) or type(error).__name__}; "
                "continue with the same command"
            ) from error
        finally:
            client.cancel(handed)


def _check_workers(client: Any, address: str) -> None:
    try:
        found: dict[str, str] = client.run(software)
    except Exception as error:
        raise ConfigError(
            f"a worker of the cluster at {address} cannot run hickory-stream ({type(error).__name__}: {error}); "
            f"install {software()} on all of them"
        ) from error
    if not found:
        raise ConfigError(f"the cluster at {address} has no worker; start some with `dask worker {address}`")
    for worker, version in sorted(found.items()):
        if version != software():
            raise ConfigError(
                f"the worker {worker} has {version}, this machine {software()}; install the same version on all workers"
            )


def outcomes_here(tasks: Sequence[LogTask], workers: int) -> Iterator[LogOutcome]:
    """Yield the outcomes of the tasks as they end; closing the iterator early ends the running ones."""
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
            for process in list(CHILDREN):
                process.kill()


def _shares(workers: int) -> list[tuple[int, ...]]:
    # Processors of each worker; () for all, if there are fewer processors than workers.
    if not hasattr(os, "sched_getaffinity"):
        return [()] * workers
    cores = sorted(os.sched_getaffinity(0))
    return [tuple(cores[i::workers]) for i in range(workers)] if workers <= len(cores) else [()] * workers
