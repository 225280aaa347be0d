import json
import os
import platform
import stat
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
import pytest
from hickory_stream.config import MapperConfig
from hickory_stream.engine.shape_jobs.processor import processor_kind, processor_of_run, processor_of_shapes
from hickory_stream.map_folder.manifest import read_manifest
from hickory_stream.map_folder.writer import create_map_folder
from players.live import inbox, live_log
from tests.engine.run_fixtures import SOON, map_scene
from tools.benchmarks.scale.engine import digest_on, variants

_OTHER = next(variant for variant in variants() if variant.name == "all of these")
# What rounds as its processor does: NumPy's vector code, the C library, and BLAS, in this order.
_SAMPLE = """
import hashlib, math, numpy as np
x = np.random.default_rng(0).uniform(-3, 3, (300, 300))
for found in (np.cbrt(x), np.array([math.sin(v) for v in x.ravel()]), x @ x):
    print(hashlib.sha256(found.tobytes()).hexdigest())
"""


def sampled(environment):
    ran = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", _SAMPLE], env={**os.environ, **environment}, capture_output=True,
        text=True, check=True,
    )  # fmt: skip
    return ran.stdout.split()


@pytest.mark.skipif(platform.machine() != "x86_64", reason="the environments are of x86-64")
def test_a_processor_with_other_arithmetic_makes_the_same_map(tmp_path):
    here, there = sampled({}), sampled(_OTHER.environment)
    if not any(a != b for a, b in zip(here, there, strict=True)):
        pytest.skip("this processor has none of what is taken from it")
    digests = {digest_on(variant, tmp_path / f"{n}", frames=12) for n, variant in enumerate((variants()[0], _OTHER))}
    assert len(digests) == 1


PERCEPTION = MapperConfig().perception


@pytest.mark.skipif(platform.machine() != "x86_64", reason="shown for x86-64 alone")
def test_the_default_map_is_the_same_on_every_processor():
    assert processor_of_run(PERCEPTION, is_own=False) != ""
    assert processor_of_run(PERCEPTION, is_own=True) == ""
    assert processor_of_shapes() == ""


def test_networks_run_as_the_processor_has_them():
    for other in (
        replace(PERCEPTION, segmenter="fastsam"),
        replace(PERCEPTION, extractor="dinov2"),
        replace(PERCEPTION, semantics="graph"),
    ):
        assert processor_of_run(other, is_own=True) == processor_kind()
    assert processor_kind().startswith(platform.machine().lower())


def test_on_another_architecture_every_map_depends_on_it(monkeypatch):
    monkeypatch.setattr(platform, "machine", lambda: "aarch64")
    processor_kind.cache_clear()
    try:
        assert processor_of_run(PERCEPTION, is_own=True).startswith("aarch64 ")
        assert processor_of_shapes().startswith("aarch64 ")
    finally:
        processor_kind.cache_clear()


def test_the_manifest_keeps_the_kind_of_processor(tmp_path):
    create_map_folder(tmp_path / "map", config={}, source={}, processor="riscv64 some").close()
    assert read_manifest(tmp_path / "map").processor == "riscv64 some"


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


PROGRAM = """
import gc, sys
sys.path.insert(0, {tests!r})
from numba.core.dispatcher import Dispatcher
from hickory_stream.shapes.build import ShapeConfig, build_shape, make_reconstructor
from hickory_stream.engine.warm_up import warm_up
from hickory_stream.shapes.fit.marching_primitives import fitted_shape
from shape_fixtures import as_mesh, shape_inputs, test_mesh
from tools.evaluation.shapes.meshes import hollow_mesh

def known():
    return {{
        (made.py_func.__qualname__, str(types))
        for made in gc.get_objects()
        if isinstance(made, Dispatcher) and made.py_func.__module__.startswith("hickory_stream.")
        for types in made.signatures
    }}

inputs = [shape_inputs(test_mesh(name), 4) for name in ("mug", "chair")]
warm_up()
before = known()
assert len(before) > 40, before
config = ShapeConfig()
for given in inputs:
    build_shape(given, make_reconstructor("fused", config), config)
assert fitted_shape(as_mesh(hollow_mesh("bowl")), config.fit).kind == "envelope"
print(sorted(known() - before))
"""


def test_the_jobs_after_it_compile_nothing():
    program = PROGRAM.format(tests=str(Path(__file__).parent.parent / "shapes"))
    made = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr
    assert made.stdout.strip() == "[]"


WRITING = """
import gc
from numba.core.dispatcher import Dispatcher
from hickory_stream.engine.warm_up import warm_up_mapping

warm_up_mapping()
print(sorted({
    made.py_func.__module__.rpartition(".")[2]
    for made in gc.get_objects()
    if isinstance(made, Dispatcher) and ".geometry." in made.py_func.__module__ and made.signatures
}))
"""


def test_it_writes_and_reads_what_a_journal_has_of_a_keyframe():
    made = subprocess.run([sys.executable, "-c", WRITING], capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr
    for name in ("depth_code", "color_code", "lattice", "voxel_blocks"):
        assert f"'{name}'" in made.stdout
