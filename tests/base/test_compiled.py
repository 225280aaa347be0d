"""Kernels from the cache run, and can be called by kernels that are compiled after them."""

import os
import subprocess
import sys

_PROGRAM = """
import sys
from hickory_stream.base.compiled import kernel, numba
from hickory_stream.geometry.portable_kernels import exp

print(round(exp(1.0), 9), sum(exp.stats.cache_hits.values()), "numba.np.linalg" in sys.modules)

@numba.njit
def squared(x):
    return exp(x) * exp(x)

print(round(squared(1.0), 9))
"""


def test_a_loaded_kernel_needs_no_compiler_until_one_calls_it(tmp_path):
    def answer():
        environment = {**os.environ, "HICKORY_CACHE": str(tmp_path)}
        run = subprocess.run([sys.executable, "-c", _PROGRAM], env=environment, capture_output=True, check=True)
        return run.stdout.decode().split()

    assert answer() == ["2.718281828", "0", "True", "7.389056099"]
    assert answer() == ["2.718281828", "1", "False", "7.389056099"]
