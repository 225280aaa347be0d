import os
import platform
import subprocess
import sys
import pytest
from tools.benchmarks.scale.processors import digest_on, variants

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
