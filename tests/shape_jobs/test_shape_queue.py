import asyncio
from dataclasses import replace
from typing import cast
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.engine.shape_jobs.job_folder import read_job, write_result
from hickory_stream.engine.shape_jobs.local_workers import LocalWorkers
from hickory_stream.engine.shape_jobs.queue import ShapeQueue
from hickory_stream.map_folder.writer import create_map_folder
from hickory_stream.ports import NoShape
from hickory_stream.shapes.build import build_shape
from hickory_stream.testing import BoxReconstructor
from tests.engine.run_fixtures import scene_config, scene_request

SECOND_NS = 1_000_000_000


class HandWorkers:
    """Workers whose answers are given by hand, by ticket."""

    def __init__(self):
        self.open = {}

    def submit(self, folder):
        answer = asyncio.get_running_loop().create_future()
        self.open[int(folder.name)] = folder, answer
        return answer

    def answer(self, ticket, reason=None):
        folder, answer = self.open[ticket]
        if reason is None and not (folder / "result.json").exists():
            write_result(folder, NoShape(reason=f"no shape {ticket}"), "")
        answer.set_result(reason)


class Desk:
    """A queue, its workers, and the one request that all others are made from."""

    def __init__(self, tmp_path):
        self.folder = create_map_folder(tmp_path / "map", config={}, source={})
        self.config = scene_config(tmp_path / "config").shapes
        self.request = scene_request(self.folder.views, num_views=2)
        self.reset()

    def reset(self):
        self.workers = HandWorkers()
        self.queue = ShapeQueue(self.folder, cast("LocalWorkers", self.workers), self.config)

    async def ask(self, ticket, due_ns):
        await self.queue.request(replace(self.request, ticket=ticket, due_ns=due_ns, views=()))

    async def committed(self, stamp_ns):
        events = []
        while (event := await self.queue.next_due(stamp_ns)) is not None:
            events.append((event.ticket, event.stamp_ns))
        return events


@pytest.fixture(scope="module")
def shared_desk(tmp_path_factory):
    return Desk(tmp_path_factory.mktemp("desk"))


@pytest.fixture
def desk(shared_desk):
    shared_desk.reset()
    return shared_desk


@given(data=st.data(), dues=st.lists(st.integers(0, 4), min_size=1, max_size=5))
def test_commits_follow_due_stamp_and_ticket_in_any_order(shared_desk, data, dues):
    shared_desk.reset()
    order = data.draw(st.permutations(range(1, len(dues) + 1)))

    async def use():
        for ticket, due in enumerate(dues, start=1):
            await shared_desk.ask(ticket, due * SECOND_NS)
        for ticket in order:
            shared_desk.workers.answer(ticket)
        committed = []
        for keyframe in range(6):
            committed += await shared_desk.committed(keyframe * SECOND_NS)
        return committed

    by_due = sorted((due, ticket) for ticket, due in enumerate(dues, start=1))
    assert asyncio.run(use()) == [(ticket, due * SECOND_NS) for due, ticket in by_due]


async def test_nothing_is_committed_before_it_is_due(desk):
    await desk.ask(1, 2 * SECOND_NS)
    desk.workers.answer(1)
    assert await desk.committed(2 * SECOND_NS - 1) == []
    assert desk.queue.num_open == 1
    # Committed at the keyframe that found it due, not at the stamp that it was promised for.
    assert await desk.committed(3 * SECOND_NS) == [(1, 3 * SECOND_NS)]


async def test_a_late_answer_is_waited_for(desk):
    await desk.ask(1, SECOND_NS)
    waiting = asyncio.create_task(desk.queue.next_due(SECOND_NS))
    for _ in range(5):
        await asyncio.sleep(0)
    assert not waiting.done()
    desk.workers.answer(1)
    event = await waiting
    assert event.reason == "no shape 1"


async def test_without_a_stamp_all_open_jobs_are_committed_when_due(desk):
    await desk.ask(1, 7 * SECOND_NS)
    await desk.ask(2, 5 * SECOND_NS)
    desk.workers.answer(1)
    desk.workers.answer(2)
    assert await desk.committed(None) == [(2, 5 * SECOND_NS), (1, 7 * SECOND_NS)]


async def test_a_shape_that_was_built_comes_as_ready_with_its_timings(desk):
    await desk.queue.request(desk.request)
    folder, _ = desk.workers.open[1]
    inputs, config = read_job(folder)
    write_result(folder, build_shape(inputs, BoxReconstructor(), config), "box")
    desk.workers.answer(1)
    event = await desk.queue.next_due(0)
    assert (event.object_id, event.shape.reconstructor) == (3, "box")
    assert (desk.folder.shapes / event.shape.mesh_name).exists()
    assert desk.queue.counts == {"requested": 1, "ready": 1}
    assert set(desk.queue.timings_s) == {"reconstruct", "fit", "inflate"}


async def test_a_job_that_was_given_up_comes_as_failed_with_the_reason(desk):
    await desk.ask(1, 0)
    desk.workers.answer(1, "no answer within 60 s")
    event = await desk.queue.next_due(0)
    assert event.reason == "no answer within 60 s"
    assert desk.queue.counts == {"requested": 1, "failed": 1}


async def test_an_answer_that_cannot_be_read_comes_as_failed(desk):
    await desk.ask(1, 0)
    folder, answer = desk.workers.open[1]
    (folder / "result.json").write_text("{")
    answer.set_result(None)
    event = await desk.queue.next_due(0)
    assert "no readable answer" in event.reason


async def test_a_job_that_somebody_gave_up_waiting_for_is_still_open(desk):
    await desk.ask(1, due_ns=SECOND_NS)
    with pytest.raises(asyncio.TimeoutError):
        await asyncio.wait_for(desk.queue.next_due(None), timeout=0.01)
    is_wanted = not desk.workers.open[1][1].cancelled()
    desk.workers.answer(1)
    assert (is_wanted, await desk.committed(None)) == (True, [(1, SECOND_NS)])


async def test_a_cancelled_job_is_neither_waited_for_nor_committed(desk):
    await desk.ask(1, 0)
    await desk.ask(2, 0)
    desk.queue.cancel(1)
    desk.queue.cancel(99)
    desk.workers.answer(2)
    assert await desk.committed(None) == [(2, 0)]
    assert desk.workers.open[1][1].cancelled()
    assert desk.queue.counts == {"requested": 2, "cancelled": 1, "failed": 1}
