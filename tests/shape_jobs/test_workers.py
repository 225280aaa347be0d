import asyncio
import json
import signal
import psutil
import pytest
from hickory_stream.base.caches import cache_folder
from hickory_stream.box_scene import SCENE_BOXES
from hickory_stream.cli import main
from hickory_stream.engine.shape_jobs.local_workers import LocalWorkers, WorkerLimits
from hickory_stream.errors import ConfigError
from hickory_stream.map_folder.saved_map import open_map
from tests.engine.run_fixtures import map_scene, shape_workers
from tests.shape_jobs.bad_worker import write_interpreter


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


ONCE = ("mapping.requests.max_failures=1", "mapping.requests.first_sightings=99")


@pytest.mark.parametrize(("way", "reasons", "is_reproducible"), [
    ("empty+nan+raises", ("an empty mesh", "not finite", "out of ideas"), True), ("segfaults", ("SIGSEGV",), False),
    ("hangs", ("no answer within 1 s",), False), ("grows", ("more than 300 MB of memory",), False),
])  # fmt: skip
def test_a_failing_job_says_why_and_leaves_the_rest_of_the_map(tmp_path, way, reasons, is_reproducible):
    python = write_interpreter(tmp_path / "python", way)
    limits = ("run.job_timeout_s=1.0",) if way == "hangs" else ("run.job_memory_mb=300.0",) if way == "grows" else ()
    # A worker that has to be replaced takes seconds: one object then, which is tried twice.
    boxes = SCENE_BOXES if is_reproducible else SCENE_BOXES[:1]
    run = map_scene(tmp_path, *ONCE, *limits, f"run.worker_python={python}", boxes=boxes, child_workers=True)
    saved = open_map(run.folder.path)
    assert saved.manifest.finished_cleanly
    assert saved.manifest.is_reproducible == is_reproducible
    assert [tracked.shape for tracked in saved.snapshot.objects] == [None] * len(boxes)
    assert all(len(tracked.points_world) for tracked in saved.snapshot.objects)
    shapes = saved.ledger["shapes"]
    assert (shapes["requested"], shapes["failed"]) == (len(boxes), len(boxes))
    assert shapes.get("limits", 0) == (0 if is_reproducible else 1)
    assert all(reason in _reasons(run.folder.path) for reason in reasons)
    # The input is kept, and can be tried by hand with the reconstructor that works.
    kept = sorted((run.folder.path / "failed").iterdir())
    assert [folder.name for folder in kept] == ["000001", "000002", "000003"][: len(boxes)]
    if is_reproducible:
        assert main(["reconstruct", str(kept[0])]) == 0
        assert (kept[0] / "mesh.glb").is_file()
    assert shape_workers() == []


def _reasons(path):
    from hickory_stream.journal.reader import Journal

    with Journal(path) as journal:
        return " ".join(str(event) for i in range(len(journal)) for event in journal.events(i, "ShapeFailed"))


def test_a_reconstructor_may_print_what_it_likes(tmp_path):
    python = write_interpreter(tmp_path / "python", "prints")
    run = map_scene(tmp_path, *ONCE, f"run.worker_python={python}", child_workers=True)
    assert all(tracked.shape is not None for tracked in open_map(run.folder.path).snapshot.objects)


def test_a_missing_interpreter_is_refused_before_playing(tmp_path):
    with pytest.raises(ConfigError, match="worker_python is /no/such/python, which is no program"):
        map_scene(tmp_path, "run.worker_python=/no/such/python", child_workers=True)
    assert not (tmp_path / "map").exists()


def test_an_interpreter_that_cannot_work_fails_jobs_and_says_why(tmp_path):
    broken = tmp_path / "python"
    broken.write_text("#!/bin/sh\nexit 3\n")
    broken.chmod(0o755)
    run = map_scene(tmp_path, *ONCE, f"run.worker_python={broken}", child_workers=True)
    assert "ended with status 3" in _reasons(run.folder.path)
    assert open_map(run.folder.path).manifest.finished_cleanly


@pytest.mark.parametrize("content", [None, "not json", '{"views": []}'])
def test_what_is_no_job_cannot_be_repeated(tmp_path, capsys, content):
    if content is not None:
        (tmp_path / "job.json").write_text(content)
    assert main(["reconstruct", str(tmp_path), "--json"]) == 2
    assert json.loads(capsys.readouterr().out)["event"] == "error"


def test_a_second_playback_takes_its_shapes_from_the_cache(tmp_path, monkeypatch):
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache" / "kernels").symlink_to(cache_folder("kernels"))  # what is compiled stays compiled
    monkeypatch.setenv("HICKORY_CACHE", str(tmp_path / "cache"))
    first = map_scene(tmp_path, "run.shape_cache=true", name="first")
    python = write_interpreter(tmp_path / "python", "raises")
    second = map_scene(
        tmp_path, "run.shape_cache=true", f"run.worker_python={python}", name="second", child_workers=True
    )
    shapes = open_map(second.folder.path).ledger["shapes"]
    assert shapes["cached"] == shapes["requested"] == shapes["ready"] >= 3
    assert second.digest == first.digest
    changed = map_scene(
        tmp_path, "run.shape_cache=true", "shapes.inflate.r_safe_m=0.03", f"run.worker_python={python}", name="third",
        child_workers=True,
    )  # fmt: skip
    assert "cached" not in open_map(changed.folder.path).ledger["shapes"]
