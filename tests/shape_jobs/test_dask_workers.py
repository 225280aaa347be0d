import asyncio
import subprocess
import sys
import time
from contextlib import contextmanager
from socket import create_connection, socket
import psutil
import pytest
from hickory_stream.engine.shape_jobs.dask_workers import DaskWorkers
from hickory_stream.engine.shape_jobs.job_folder import take_result, write_job
from hickory_stream.engine.shape_jobs.local_workers import WorkerLimits
from hickory_stream.errors import ConfigError
from tests.engine.run_fixtures import map_scene, scene_config, scene_request

pytest.importorskip("distributed")
pytestmark = [pytest.mark.timeout(180), pytest.mark.filterwarnings("ignore")]

LIMITS = WorkerLimits(time_s=60.0, memory_mb=4000.0)
WORKER = ("worker", "--no-dashboard", "--nthreads", "1", "--death-timeout", "60")


def free_port():
    with socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def dask(*arguments):
    command = [sys.executable, "-m", "dask", *arguments]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)


def scheduler(port):
    process = dask("scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard")
    until_s = time.monotonic() + 60
    while time.monotonic() < until_s:
        try:
            create_connection(("127.0.0.1", port), 1).close()
        except OSError:
            time.sleep(0.1)
        else:
            return process
    raise AssertionError("no scheduler within a minute")


def end(process):
    """Kill a process with its children: a nanny has one."""
    for child in [*psutil.Process(process.pid).children(recursive=True), process]:
        try:
            child.kill()
        except psutil.NoSuchProcess:
            pass
    process.wait(30)


@contextmanager
def cluster(workers=1):
    port = free_port()
    address = f"tcp://127.0.0.1:{port}"
    processes = [scheduler(port), *(dask(*WORKER, address) for _ in range(workers))]
    try:
        yield address, processes
    finally:
        for process in processes:
            if process.poll() is None:
                end(process)


def jobs(tmp_path, count):
    (tmp_path / "views").mkdir()
    request = scene_request(tmp_path / "views")
    folders = [tmp_path / "jobs" / str(i) for i in range(count)]
    for folder in folders:
        write_job(folder, request, tmp_path / "views", scene_config(tmp_path / "config").shapes)
    return folders


def hashes(folders, tmp_path):
    (tmp_path / "shapes").mkdir(exist_ok=True)
    shapes = [take_result(folder, i, 3, tmp_path / "shapes").shape for i, folder in enumerate(folders)]
    return {shape.mesh_sha256 for shape in shapes if shape is not None}


def test_a_cluster_makes_the_same_map_as_child_processes(tmp_path, undisturbed_run):
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None) as made:
        away = map_scene(tmp_path, f"run.cluster={made.scheduler_address}", name="away", child_workers=True)
    assert away.digest == undisturbed_run.digest
    assert away.folder.manifest.is_reproducible


@pytest.mark.parametrize("is_scheduler_lost", [False, True])
def test_a_worker_or_a_scheduler_that_is_lost_in_mid_job_loses_no_job(tmp_path, is_scheduler_lost):
    folders = jobs(tmp_path, 4)

    async def run(address, processes):
        async with DaskWorkers(address, LIMITS) as workers:
            answers = [workers.submit(folder) for folder in folders]
            await asyncio.wait(answers, return_when=asyncio.FIRST_COMPLETED)
            for process in processes if is_scheduler_lost else processes[1:]:
                await asyncio.to_thread(end, process)
            if is_scheduler_lost:
                processes.append(await asyncio.to_thread(scheduler, int(address.rpartition(":")[2])))
            processes.append(dask(*WORKER, address))
            return await asyncio.gather(*answers)

    with cluster() as (address, processes):
        assert asyncio.run(run(address, processes)) == [None] * 4
    assert len(hashes(folders, tmp_path)) == 1


def test_an_address_with_nobody_there_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("hickory_stream.engine.shape_jobs.dask_workers._CONNECT_S", 1.0)
    with pytest.raises(ConfigError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:\d+; start one"):
        map_scene(tmp_path, f"run.cluster=tcp://127.0.0.1:{free_port()}", child_workers=True)
    assert not (tmp_path / "map").exists()
