import asyncio
import json
import signal
import psutil
import pytest
from hickory_stream.engine.shape_jobs.local_workers import LocalWorkers, WorkerLimits
from tests.engine.run_fixtures import shape_workers


def use_workers(use, count=1, timeout_s=60.0, **options):
    async def run():
        async with LocalWorkers(count, WorkerLimits(time_s=timeout_s, memory_mb=4000.0), **options) as workers:
            return await use(workers)

    return asyncio.run(run())


def job(tmp_path, name):
    (tmp_path / name).mkdir()
    return tmp_path / name


def is_answered(folder):
    return "FileNotFoundError" in json.loads((folder / "result.json").read_text())["reason"]


async def in_hand(process, answer):
    """Let the loop hand a job to a stopped child, which then has it without ever answering."""
    for _ in range(20):
        await asyncio.sleep(0.005)
    assert process.status() == psutil.STATUS_STOPPED
    assert not answer.done()


def test_nothing_is_started_before_the_first_job():
    async def use(workers):
        return len(shape_workers()) + workers.num_open

    assert use_workers(use, count=4) == 0


def test_a_poisonous_job_is_answered_and_does_not_end_its_worker(tmp_path):
    async def use(workers):
        alive = []
        for name in ("a", "b"):
            assert await workers.submit(job(tmp_path, name)) is None
            alive.append({child.pid for child in shape_workers()})
        return alive

    first, second = use_workers(use)
    assert first == second
    assert len(first) == 1
    assert is_answered(tmp_path / "a")
    assert is_answered(tmp_path / "b")
    assert shape_workers() == []


def test_asked_for_children_share_the_jobs_and_end_with_the_run(tmp_path):
    async def use(workers):
        answers = [workers.submit(job(tmp_path, str(i))) for i in range(6)]
        assert workers.num_open == 6
        assert await asyncio.gather(*answers) == [None] * 6
        assert workers.num_open == 0
        return len(shape_workers())

    assert 1 <= use_workers(use, count=2) <= 2
    assert all(is_answered(tmp_path / str(i)) for i in range(6))
    assert shape_workers() == []


@pytest.mark.parametrize("is_in_mid_job", [True, False])
def test_a_child_that_is_killed_is_replaced_and_its_job_done(tmp_path, is_in_mid_job):
    async def use(workers):
        await workers.submit(job(tmp_path, "a"))
        (child,) = shape_workers()
        if is_in_mid_job:
            child.send_signal(signal.SIGSTOP)
            answer = workers.submit(job(tmp_path, "b"))
            await in_hand(child, answer)
            child.kill()
        else:
            child.kill()
            child.wait(10)
            answer = workers.submit(job(tmp_path, "b"))
        assert await answer is None
        return child.pid, shape_workers()[0].pid

    killed, replaced_by = use_workers(use)
    assert killed != replaced_by
    assert is_answered(tmp_path / "b")


def test_a_hanging_child_is_ended_and_another_does_its_job(tmp_path):
    async def use(workers):
        await workers.submit(job(tmp_path, "a"))
        (child,) = shape_workers()
        child.send_signal(signal.SIGSTOP)
        assert await workers.submit(job(tmp_path, "b")) is None
        assert not psutil.pid_exists(child.pid)
        return workers.num_limits

    assert use_workers(use, timeout_s=2.0) == 0


def test_a_job_that_always_times_out_fails_with_the_reason(tmp_path):
    async def use(workers):
        return await workers.submit(job(tmp_path, "a")), workers.num_limits

    reason, num_limits = use_workers(use, timeout_s=1e-9)
    assert "no answer within" in reason
    assert num_limits == 1
    assert shape_workers() == []


def test_a_cancelled_job_that_waits_is_never_begun(tmp_path):
    async def use(workers):
        first = workers.submit(job(tmp_path, "a"))
        cancelled, last = workers.submit(job(tmp_path, "b")), workers.submit(job(tmp_path, "c"))
        cancelled.cancel()
        await asyncio.gather(first, last)
        assert workers.num_open == 0

    use_workers(use)
    assert not (tmp_path / "b/result.json").exists()
    assert is_answered(tmp_path / "c")


def test_leaving_with_an_error_ends_every_child(tmp_path):
    async def use(workers):
        await workers.submit(job(tmp_path, "a"))
        shape_workers()[0].send_signal(signal.SIGSTOP)
        answer = workers.submit(job(tmp_path, "b"))
        await in_hand(shape_workers()[0], answer)
        raise KeyError("something else failed")

    with pytest.raises(KeyError):
        use_workers(use)
    assert shape_workers() == []


def test_no_workers_at_all_are_refused():
    with pytest.raises(ValueError, match="found 0 workers"):
        LocalWorkers(0, WorkerLimits(time_s=60.0, memory_mb=4000.0))


def test_children_of_a_live_run_give_way_to_others(tmp_path):
    async def use(workers):
        workers.niceness = 7
        await workers.submit(job(tmp_path, "a"))
        return [process.nice() for process in shape_workers()]

    assert use_workers(use) == [psutil.Process().nice() + 7]
