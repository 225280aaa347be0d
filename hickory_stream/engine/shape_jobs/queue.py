"""Queue of shape jobs: results are committed by due stamp (playback) or on arrival (live).

A playback commits a result at the first keyframe at or after its due stamp, in the order (due stamp, ticket), and waits
for a late one: number and speed of workers cannot change the map.
"""

from __future__ import annotations

import asyncio
import shutil
from collections import Counter, defaultdict
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from hickory_stream.engine.shape_jobs import job_folder as jobs_on_disk
from hickory_stream.errors import MapFolderError, WorkerError
from hickory_stream.events import RequestShape, ShapeFailed, ShapeReady
from hickory_stream.journal.step import OpenJob

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from hickory_stream.engine.shape_jobs.cache import ShapeCache
    from hickory_stream.engine.shape_jobs.local_workers import ShapeWorkers
    from hickory_stream.map_folder.writer import MapFolder
    from hickory_stream.shapes.build import ShapeConfig


@dataclass(frozen=True, slots=True)
class _Open:
    due_ns: int
    object_id: int
    answer: asyncio.Future[str | None]
    cache_key: str | None = None
    known: ShapeReady | ShapeFailed | None = None


class ShapeQueue:
    """Open jobs, and statistics of ended ones: `timings_s` by step, `counts` by fate."""

    def __init__(
        self, folder: MapFolder, workers: ShapeWorkers, config: ShapeConfig, cache: ShapeCache | None = None
    ) -> None:
        self._folder = folder
        self._workers = workers
        self._config = config
        self._cache = cache
        self._open: dict[int, _Open] = {}
        self._failed: dict[int, tuple[int, str]] = {}
        self._limits_before = 0
        self.timings_s: defaultdict[str, float] = defaultdict(float)
        self.counts: Counter[str] = Counter()

    def total_counts(self) -> dict[str, int]:
        """Return jobs by fate, an interrupted run included; `limits` were given up at a limit."""
        counts = {**self.counts, "limits": self.num_limits}
        return {name: count for name, count in counts.items() if count}

    @property
    def num_limits(self) -> int:
        """Number of jobs given up at a limit of time or memory, which makes the map irreproducible."""
        return self._limits_before + self._workers.num_limits

    def resume(self, jobs: Iterable[OpenJob], counts: Mapping[str, int]) -> None:
        """Take over the jobs and counts of an interrupted run.

        Raises `MapFolderError`: an input is incomplete after a power failure.
        """
        self._limits_before = counts.get("limits", 0)
        self.counts.update({name: count for name, count in counts.items() if name != "limits"})
        for job in jobs:
            self._adopt(job)

    @property
    def num_open(self) -> int:
        """Number of results to be committed."""
        return len(self._open)

    async def request(self, request: RequestShape) -> None:
        """Submit a job to the workers."""
        folder = jobs_on_disk.job_folder(self._folder.jobs, request.ticket)
        await asyncio.to_thread(jobs_on_disk.write_job, folder, request, self._folder.views, self._config)
        key = await asyncio.to_thread(self._cache.key, folder) if self._cache is not None else None
        if self._cache is not None and key is not None and await asyncio.to_thread(self._cache.fetch, key, folder):
            answer, key = _answered(), None
            self.counts["cached"] += 1
        else:
            answer = self._workers.submit(folder)
        self._open[request.ticket] = _Open(request.due_ns, request.object_id, answer, key)
        self.counts["requested"] += 1

    @property
    def open_jobs(self) -> tuple[OpenJob, ...]:
        """The jobs whose results are not committed yet."""
        open_ = self._open.items()
        return tuple(OpenJob(ticket=ticket, object_id=job.object_id, due_ns=job.due_ns) for ticket, job in open_)

    def _adopt(self, job: OpenJob) -> None:
        folder = jobs_on_disk.job_folder(self._folder.jobs, job.ticket)
        if (folder / jobs_on_disk.RESULT).is_file():
            answer = _answered()
        elif (folder / jobs_on_disk.JOB).is_file():
            answer = self._workers.submit(folder)
        else:
            raise MapFolderError(f"{folder}, which the map waits for, did not reach the disk; play the log again")
        self._open[job.ticket] = _Open(job.due_ns, job.object_id, answer)

    def rewind(self, jobs: Iterable[OpenJob], answers: Mapping[int, ShapeReady | ShapeFailed]) -> list[int]:
        """Wait for exactly these jobs; return the tickets of abandoned ones.

        `answers` are results that were committed before, and are committed again when due. A cancelled job has none.
        """
        wanted = {job.ticket: job for job in jobs}
        given_up = [ticket for ticket in self._open if ticket not in wanted]
        for ticket in given_up:
            self.cancel(ticket)
        for ticket, job in wanted.items():
            if ticket not in self._open:
                reason = "cancelled before it was sought back"
                cancelled = ShapeFailed(ticket=ticket, object_id=job.object_id, stamp_ns=job.due_ns, reason=reason)
                known = answers.get(ticket, cancelled)
                self._open[ticket] = _Open(job.due_ns, job.object_id, _answered(), known=known)
        return given_up

    def forget(self, tickets: list[int]) -> None:
        """Remove the folders of finished jobs; the input of a failed one is kept."""
        for ticket in tickets:
            folder = jobs_on_disk.job_folder(self._folder.jobs, ticket)
            if ticket in self._failed:
                jobs_on_disk.keep_input(folder, self._folder.path / jobs_on_disk.FAILED, *self._failed.pop(ticket))
            else:
                shutil.rmtree(folder, ignore_errors=True)

    def cancel(self, ticket: int) -> None:
        """Drop a job; if it runs, its result is ignored."""
        job = self._open.pop(ticket, None)
        if job is not None:
            job.answer.cancel()
            self.counts["cancelled"] += 1

    def has_due(self, stamp_ns: int | None) -> bool:
        """Return whether a result is due at a stamp (None: any)."""
        return any(stamp_ns is None or job.due_ns <= stamp_ns for job in self._open.values())

    async def next_arrived(self, stamp_ns: int) -> ShapeReady | ShapeFailed | None:
        """Return an arrived result, to be committed at a stamp; None if there is none."""
        arrived = sorted(ticket for ticket, job in self._open.items() if job.answer.done())
        return await self._commit(arrived[0], stamp_ns) if arrived else None

    async def next_due(self, stamp_ns: int | None) -> ShapeReady | ShapeFailed | None:
        """Return the next result that is due at a stamp (None: any), waiting for it; None if none is."""
        due = [(job.due_ns, ticket) for ticket, job in self._open.items() if stamp_ns is None or job.due_ns <= stamp_ns]
        if not due:
            return None
        due_ns, ticket = min(due)
        return await self._commit(ticket, due_ns if stamp_ns is None else stamp_ns)

    async def _commit(self, ticket: int, stamp_ns: int) -> ShapeReady | ShapeFailed:
        job = self._open[ticket]
        # A stop gives up waiting, not the job: it stays open.
        reason = await asyncio.shield(job.answer)
        del self._open[ticket]
        if job.known is not None:
            return replace(job.known, stamp_ns=stamp_ns)
        if reason is None:
            folder = jobs_on_disk.job_folder(self._folder.jobs, ticket)
            try:
                answer = await asyncio.to_thread(
                    jobs_on_disk.take_result, folder, ticket, job.object_id, self._folder.shapes
                )
            except WorkerError as error:
                reason = str(error)
            else:
                for step, seconds in answer.timings_s.items():
                    self.timings_s[step] += seconds
                self._limits_before += answer.hit_limit
                if self._cache is not None and job.cache_key is not None and not answer.hit_limit:
                    await asyncio.to_thread(self._cache.store, job.cache_key, folder)
                if answer.shape is not None:
                    self.counts["ready"] += 1
                    return ShapeReady(ticket=ticket, object_id=job.object_id, stamp_ns=stamp_ns, shape=answer.shape)
                reason = answer.reason
        self.counts["failed"] += 1
        self._failed[ticket] = job.object_id, reason
        return ShapeFailed(ticket=ticket, object_id=job.object_id, stamp_ns=stamp_ns, reason=reason)


def _answered() -> asyncio.Future[str | None]:
    answer: asyncio.Future[str | None] = asyncio.get_running_loop().create_future()
    answer.set_result(None)
    return answer
