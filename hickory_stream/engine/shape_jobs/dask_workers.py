"""Shape workers on an existing Dask cluster.

Jobs and answers travel as file contents, so only the packages are shared. Dask repeats the job of a lost worker;
after the loss of the scheduler, open jobs are submitted again.
"""

import asyncio
import contextlib
import logging
import tempfile
import time
import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from hickory_stream.base.atomic_files import write_atomically
from hickory_stream.base.confined import plain_name
from hickory_stream.engine.shape_jobs.job_folder import MESH, RESULT
from hickory_stream.engine.shape_jobs.local_workers import WorkerLimits
from hickory_stream.errors import ConfigError, WorkerError

logger = logging.getLogger(__name__)

_CONNECT_S = 10.0
_RECONNECT_S = 120.0
_RETRY_S = 1.0
_ATTEMPTS = 3


def answer_job(files: Mapping[str, bytes]) -> dict[str, bytes]:
    """Do a job that came as files, on any machine, and return the files of its answer."""
    from hickory_stream.engine.shape_jobs.worker import serve

    with tempfile.TemporaryDirectory(prefix="hickory-job-") as temporary:
        folder = Path(temporary)
        for name, content in files.items():
            (folder / plain_name(name)).write_bytes(content)
        error = serve(folder)
        if error is not None:
            raise RuntimeError(error)
        return {name: (folder / name).read_bytes() for name in (MESH, RESULT) if (folder / name).exists()}


class DaskWorkers:
    """A Dask cluster at `address`; `resources`, e.g. {"GPU": 1}, are requirements of a job.

    Raises `ConfigError`: Dask is not installed, or nothing answers at the address (on entering).
    """

    def __init__(self, address: str, limits: WorkerLimits, resources: Mapping[str, float] | None = None) -> None:
        try:
            import distributed  # noqa: F401
        except ImportError as error:
            raise ConfigError("workers on a cluster need Dask: pip install 'hickory-stream[dask]'") from error
        self._address = address
        self._limits = limits
        self._resources = dict(resources or {})
        self._client: Any = None
        self._connecting = asyncio.Lock()
        self._tasks: set[asyncio.Task[None]] = set()
        self._num_open = 0
        self._num_alive = 0
        self.num_limits = 0

    async def __aenter__(self) -> Self:
        try:
            self._client = await self._connect(_CONNECT_S)
        except (OSError, TimeoutError) as error:
            raise ConfigError(
                f"no Dask scheduler answers at {self._address}; start one with `dask scheduler`, or use --workers N"
            ) from error
        return self

    async def __aexit__(self, *_: object) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._drop_client(self._client)

    @property
    def num_open(self) -> int:
        """Number of waiting or running jobs."""
        return self._num_open

    @property
    def num_alive(self) -> int:
        """Number of workers of the cluster after the latest job."""
        return self._num_alive

    def submit(self, folder: Path) -> asyncio.Future[str | None]:
        """Submit a job; the future gives None for an answer in the folder, else why the job was given up."""
        answer: asyncio.Future[str | None] = asyncio.get_running_loop().create_future()
        self._num_open += 1
        task = asyncio.create_task(self._serve(folder, answer), name=f"dask-{folder.name}")
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        answer.add_done_callback(lambda _: task.cancel())
        return answer

    async def _serve(self, folder: Path, answer: asyncio.Future[str | None]) -> None:
        try:
            reason = await self._answered(folder)
        except OSError as error:
            reason = f"{folder}: {error.strerror or error}"
        finally:
            self._num_open -= 1
        if not answer.done():
            answer.set_result(reason)

    async def _answered(self, folder: Path) -> str | None:
        files = await asyncio.to_thread(_read, folder)
        reason: str | None = None
        for _ in range(_ATTEMPTS):
            client = self._client
            try:
                given = await self._run(client, files)
            except TimeoutError:
                self.num_limits += 1
                return f"no answer within {self._limits.time_s:g} s a job (run.job_timeout_s)"
            except _LostError as error:
                reason = f"the cluster was lost: {error}"
                logger.warning("shape job %s: %s; connecting again", folder.name, error)
                if not await self._reconnect(client):
                    break
            except Exception as error:  # noqa: BLE001 -- whatever the job raised on its machine comes out here
                return f"{type(error).__name__}: {error}"
            else:
                await asyncio.to_thread(_write, folder, given)
                return None
        self.num_limits += 1
        return reason

    async def _run(self, client: Any, files: Mapping[str, bytes]) -> dict[str, bytes]:
        from distributed import CancelledError as LostFutureError
        from distributed.comm import CommClosedError

        try:
            key, resources = f"hickory-{uuid.uuid4()}", self._resources or None
            handed = client.submit(answer_job, dict(files), key=key, resources=resources, pure=False)
            # A job in the queue of the cluster is not slow: so many may be before it.
            patience_s = self._limits.time_s * max(1, self._num_open)
            given: dict[str, bytes] = await asyncio.wait_for(_result(handed), patience_s)
            self._num_alive = len(await client.nthreads())
        except (CommClosedError, OSError, LostFutureError) as error:
            if isinstance(error, TimeoutError):
                raise
            raise _LostError(str(error) or type(error).__name__) from error
        return given

    async def _connect(self, timeout_s: float) -> Any:
        from distributed import Client

        return await Client(
            self._address, asynchronous=True, timeout=timeout_s, set_as_default=False, name="hickory-stream"
        )

    async def _reconnect(self, lost: Any) -> bool:
        async with self._connecting:
            if self._client is not lost:
                return True
            await self._drop_client(lost)
            until_s = time.monotonic() + _RECONNECT_S
            while time.monotonic() < until_s:
                try:
                    self._client = await self._connect(_CONNECT_S)
                except (OSError, TimeoutError):
                    await asyncio.sleep(_RETRY_S)
                else:
                    return True
            return False

    async def _drop_client(self, client: Any) -> None:
        if client is not None:
            # It may be lost already.
            with contextlib.suppress(Exception):
                await asyncio.wait_for(client.close(), _CONNECT_S)


class _LostError(WorkerError):
    """The scheduler is lost, and with it its jobs."""


async def _result(handed: Any) -> dict[str, bytes]:
    given: dict[str, bytes] = await handed.result()
    return given


def _read(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def _write(folder: Path, files: Mapping[str, bytes]) -> None:
    # The result comes last; other files of a worker are ignored.
    for name in sorted({MESH, RESULT} & files.keys()):
        write_atomically(folder / name, files[name], sync=False)
