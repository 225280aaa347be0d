"""Kernels that are loaded from the cache run, and can be called by kernels that are compiled after them."""

import os
import subprocess
import sys
from pathlib import Path

_PROGRAM = """
from hickory_stream.base.compiled import numba
from hickory_stream.geometry.portable_kernels import exp

one = round(exp(1.0), 9)
library = exp.overloads[exp.signatures[0]].library
print(one, sum(exp.stats.cache_hits.values()), hasattr(library, "_hickory_bitcode"))

@numba.njit
def squared(x):
    return exp(x) * exp(x)

print(round(squared(1.0), 9))
"""


def run(cache: Path) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM],
        env={**os.environ, "HICKORY_CACHE": str(cache)},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.split()


def test_a_loaded_kernel_is_parsed_when_another_one_is_compiled_that_calls_it(tmp_path: Path) -> None:
    compiled = run(tmp_path)
    assert compiled == ["2.718281828", "0", "False", "7.389056099"]
    assert run(tmp_path) == ["2.718281828", "1", "True", "7.389056099"]
