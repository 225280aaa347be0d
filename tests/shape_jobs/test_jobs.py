import asyncio
import json
from dataclasses import replace
from typing import cast
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.engine.shape_jobs.job_folder import job_folder, read_job, take_result, write_job, write_result
from hickory_stream.engine.shape_jobs.local_workers import LocalWorkers
from hickory_stream.engine.shape_jobs.queue import ShapeQueue
from hickory_stream.errors import MapFolderError, WorkerError
from hickory_stream.geometry.codecs.mesh_file import mesh_of_file
from hickory_stream.geometry.mesh import sha256_of
from hickory_stream.map_folder.views import crop_files, read_crop
from hickory_stream.map_folder.writer import create_map_folder
from hickory_stream.ports import NoShape
from hickory_stream.shapes.build import build_shape
from hickory_stream.testing import BoxReconstructor
from tests.engine.run_fixtures import scene_config, scene_request


@pytest.fixture
def config(tmp_path):
    return scene_config(tmp_path / "config").shapes


@pytest.fixture
def request_3(tmp_path):
    (tmp_path / "views").mkdir()
    return scene_request(tmp_path / "views")


def written(tmp_path, request, config):
    folder = job_folder(tmp_path / "jobs", request.ticket)
    write_job(folder, request, tmp_path / "views", config)
    return folder


def built(folder):
    inputs, config = read_job(folder)
    return build_shape(inputs, BoxReconstructor(), config)


def test_a_worker_reads_what_was_asked_for(tmp_path, request_3, config):
    config = replace(config, reconstructor="single_view")
    inputs, read = read_job(written(tmp_path, request_3, config))
    assert read == config
    assert inputs.support_z_m == 0.0
    np.testing.assert_array_equal(inputs.points_world, request_3.points_world)
    np.testing.assert_array_equal(inputs.colors, request_3.colors)
    np.testing.assert_array_equal(inputs.box.world_from_box, request_3.box.world_from_box)
    np.testing.assert_array_equal(inputs.box.half_extents_m, request_3.box.half_extents_m)
    for crop, view in zip(inputs.crops, request_3.views, strict=True):
        kept = read_crop(tmp_path / "views", view.name)
        np.testing.assert_array_equal(crop.depth_m, kept.depth_m)
        np.testing.assert_array_equal(crop.world_from_camera, view.world_from_camera)


def test_a_view_may_be_dropped_while_its_job_waits(tmp_path, request_3, config):
    folder = written(tmp_path, request_3, config)
    for view in request_3.views:
        for file in crop_files(tmp_path / "views", view.name):
            file.unlink()
    assert len(read_job(folder)[0].crops) == len(request_3.views)


def test_a_disk_that_refuses_a_job_is_told_as_such(tmp_path, request_3, config):
    (tmp_path / "jobs").mkdir()
    (tmp_path / "jobs/000001").write_text("in the way")
    with pytest.raises(MapFolderError, match=r"cannot write .*000001"):
        written(tmp_path, request_3, config)


def test_the_answer_is_the_shape_that_was_built(tmp_path, request_3, config):
    folder, shapes = written(tmp_path, request_3, config), tmp_path / "shapes"
    shapes.mkdir()
    answer = built(folder)
    write_result(folder, answer, "box")
    taken = take_result(folder, 1, 3, shapes)
    shape = taken.shape
    assert (shape.reconstructor, shape.revision, shape.mesh_name) == ("box", 1, "000003-000001.mesh")
    np.testing.assert_array_equal(shape.fitted.semi_axes_m, answer.fitted.semi_axes_m)
    np.testing.assert_array_equal(shape.inflated.world_from_local, answer.inflated.world_from_local)
    np.testing.assert_array_equal(shape.world_from_object, answer.reconstruction.world_from_object)
    np.testing.assert_array_equal(shape.seen_share, answer.seen_share)
    assert shape.containment == answer.containment
    assert set(taken.timings_s) == {"reconstruct", "fit", "inflate"}
    assert sha256_of(mesh_of_file((shapes / shape.mesh_name).read_bytes())) == shape.mesh_sha256
    assert folder.exists(), "the job stays until the journal has its answer"


def test_the_reason_for_no_shape_comes_back(tmp_path, request_3, config):
    folder = written(tmp_path, request_3, config)
    write_result(folder, NoShape(reason="too thin"), "")
    taken = take_result(folder, 1, 3, tmp_path / "shapes")
    assert (taken.shape, taken.reason) == (None, "too thin")
    assert folder.exists()


@pytest.mark.parametrize("damage", ["missing", "empty", "cut", "keys", "mesh"])
def test_a_damaged_answer_is_a_worker_error_that_names_the_job(tmp_path, request_3, config, damage):
    folder, shapes = written(tmp_path, request_3, config), tmp_path / "shapes"
    shapes.mkdir()
    write_result(folder, built(folder), "box")
    result = folder / "result.json"
    text = result.read_text()
    if damage == "missing":
        result.unlink()
    elif damage == "mesh":
        (folder / "shape.mesh").write_bytes(b"HSM2" + bytes(40))
    else:
        keys = json.dumps({"reconstructor": "box"})
        result.write_text({"empty": "", "cut": text[: len(text) // 2], "keys": keys}[damage])
    with pytest.raises(WorkerError, match=r"job 1: no readable answer in .*000001"):
        take_result(folder, 1, 3, shapes)


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


@pytest.mark.parametrize(("content", "reason"), [(None, "no answer within 60 s"), ("{", "no readable answer")])
async def test_a_job_given_up_or_with_a_torn_answer_comes_as_failed(desk, content, reason):
    await desk.ask(1, 0)
    if content is not None:
        (desk.workers.open[1][0] / "result.json").write_text(content)
    desk.workers.answer(1, reason if content is None else None)
    event = await desk.queue.next_due(0)
    assert reason in event.reason
    assert desk.queue.counts == {"requested": 1, "failed": 1}


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
