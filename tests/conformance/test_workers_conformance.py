import asyncio
import json
import pytest
from hickory_stream.engine.shape_jobs.job_folder import take_result, write_job
from hickory_stream.engine.shape_jobs.local_workers import LocalWorkers, WorkerLimits
from tests.engine.run_fixtures import scene_config, scene_request
from tests.in_process_workers import InProcessWorkers
from tests.shape_jobs.test_dask_workers import cluster

pytestmark = [pytest.mark.timeout(180), pytest.mark.filterwarnings("ignore")]

LIMITS = WorkerLimits(time_s=60.0, memory_mb=4000.0)


@pytest.fixture(scope="module", params=["local", "dask", "in process"])
def use(request):
    """Give workers of a kind to a coroutine function."""
    if request.param == "local":
        yield lambda function: asyncio.run(_with(LocalWorkers(1, LIMITS), function))
        return
    if request.param == "in process":
        yield lambda function: asyncio.run(_with(InProcessWorkers(), function))
        return
    pytest.importorskip("distributed")
    from hickory_stream.engine.shape_jobs.dask_workers import DaskWorkers

    with cluster(workers=1) as (address, _):
        yield lambda function: asyncio.run(_with(DaskWorkers(address, LIMITS), function))


async def _with(workers, function):
    async with workers:
        return await function(workers)


def job(tmp_path, name):
    views = tmp_path / "views"
    views.mkdir(exist_ok=True)
    folder = tmp_path / "jobs" / name
    write_job(folder, scene_request(views), views, scene_config(tmp_path / "config").shapes)
    return folder


def test_jobs_are_answered_with_the_same_shape_whoever_does_them(tmp_path, use):
    folders = [job(tmp_path, str(i)) for i in range(3)]

    async def submit(workers):
        assert workers.num_open == 0
        answers = [workers.submit(folder) for folder in folders]
        assert workers.num_open == 3
        reasons = await asyncio.gather(*answers)
        await asyncio.sleep(0)
        assert workers.num_open == 0
        assert workers.num_alive >= 1
        assert workers.num_limits == 0
        return list(reasons)

    assert use(submit) == [None] * 3
    (tmp_path / "shapes").mkdir()
    shapes = [take_result(folder, i, 3, tmp_path / "shapes").shape for i, folder in enumerate(folders)]
    assert len({shape.mesh_sha256 for shape in shapes if shape is not None}) == 1
    assert None not in shapes


def test_a_job_that_cannot_be_read_is_answered_with_the_reason(tmp_path, use):
    folder = tmp_path / "nothing in it"
    folder.mkdir()

    async def submit(workers):
        return await workers.submit(folder)

    assert use(submit) is None
    assert "FileNotFoundError" in json.loads((folder / "result.json").read_text())["reason"]


def test_a_job_whose_folder_is_gone_is_given_up_with_the_reason(tmp_path, use):
    async def submit(workers):
        return await workers.submit(tmp_path / "never made")

    assert "never made" in use(submit)


def test_a_cancelled_job_holds_up_no_other(tmp_path, use):
    folders = [job(tmp_path, str(i)) for i in range(3)]

    async def submit(workers):
        first, unwanted, last = (workers.submit(folder) for folder in folders)
        unwanted.cancel()
        return [await first, await last]

    assert use(submit) == [None, None]


def test_leaving_while_jobs_are_under_way_returns(tmp_path, use):
    folders = [job(tmp_path, str(i)) for i in range(2)]

    async def submit(workers):
        for folder in folders:
            workers.submit(folder)
        await asyncio.sleep(0.05)

    assert use(submit) is None
