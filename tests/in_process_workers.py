"""Shape workers for tests of something else: jobs are done on a thread, where kernels are loaded already.

A child process takes two seconds to start, and most runs of the tests have three small shapes. That it answers the same
as one: conformance/test_workers_conformance.py.
"""

import asyncio
from concurrent.futures import ThreadPoolExecutor
from hickory_stream.engine.shape_jobs.worker import serve


class InProcessWorkers:
    """One thread that does jobs; leaving waits for the one that it is at, and drops the others."""

    num_limits = 0
    num_alive = 1

    def __init__(self):
        self._thread = ThreadPoolExecutor(1, "shapes")
        self._open = set()

    async def __aenter__(self):
        return self

    async def __aexit__(self, *_):
        await asyncio.to_thread(self._thread.shutdown, cancel_futures=True)

    @property
    def num_open(self):
        return len(self._open)

    def submit(self, folder):
        answer = asyncio.get_running_loop().create_future()
        self._open.add(answer)
        answer.add_done_callback(self._open.discard)
        job = asyncio.wrap_future(self._thread.submit(_served, folder, answer))
        job.add_done_callback(lambda done: _hand_over(done, answer))
        return answer


def _served(folder, answer):
    return None if answer.cancelled() else serve(folder)


def _hand_over(done, answer):
    if not answer.done() and not done.cancelled():
        answer.set_result(done.result())
