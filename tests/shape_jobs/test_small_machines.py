import json
import stat
import subprocess
import sys
from pathlib import Path
import pytest
from hickory_stream.config import MapperConfig
from players.live import inbox, live_log
from tests.engine.run_fixtures import SOON, map_scene

_CORES, _MEMORY_GB = 4, 16.0
# A run of an hour holds less than a gigabyte itself.
_RUN_GB = 1.0

_THREADS = """
import json, numba, threadpoolctl
import hickory_stream.shapes.build
pools = [pool["num_threads"] for pool in threadpoolctl.threadpool_info()]
print(json.dumps({"pools": pools, "numba": numba.get_num_threads()}))
"""


def test_default_workers_leave_one_core_of_four_free():
    # One thread of a run computes: it perceives and decides.
    assert MapperConfig().run.workers + 1 < _CORES


def test_default_queues_leave_a_third_of_the_memory_free():
    run = MapperConfig().run
    jobs_gb = run.workers * run.job_memory_mb / 1e3
    queued = inbox._LARGE_BYTES + inbox._SMALL_BYTES + live_log._KEPT_IMAGE_BYTES + live_log._KEPT_SMALL_BYTES
    assert jobs_gb + queued / 1e9 + _RUN_GB < _MEMORY_GB * 2 / 3


def test_a_shape_worker_computes_on_one_thread(tmp_path):
    told = tmp_path / "environment.json"
    python = tmp_path / "python"
    python.write_text(
        f"#!{sys.executable}\nimport json, os, sys\n"
        f"open({str(told)!r}, 'w').write(json.dumps(dict(os.environ)))\n"
        f"os.execv({sys.executable!r}, [{sys.executable!r}, *sys.argv[1:]])\n"
    )
    python.chmod(python.stat().st_mode | stat.S_IXUSR)
    # As on a machine where somebody has asked for all cores.
    with pytest.MonkeyPatch.context() as patched:
        for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
            patched.setenv(name, "12")
        map_scene(tmp_path, *SOON, f"run.worker_python={python}", child_workers=True)
    done = subprocess.run(
        [sys.executable, "-c", _THREADS], env=json.loads(told.read_text()), capture_output=True, check=True,
        cwd=Path.cwd(),
    )  # fmt: skip
    threads = json.loads(done.stdout)
    assert threads["numba"] == 1
    assert set(threads["pools"]) == {1}
