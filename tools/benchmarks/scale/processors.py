"""Portability of maps: the same log is played with libraries made to believe that they run on other processors.

Each variant has one of the libraries choose its code as on another machine, by what that library asks for; the last
have all of them do so, and the workers alone. The kernels compiled by Numba are made for any x86-64 in one of them,
which takes minutes.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tools.benchmarks.common.coarse_runs import COARSE, die_with_parent, finished
from tools.benchmarks.common.processes import ROOT

_LOG = ROOT / "recordings" / "demo.mcap"
_LIBC = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX512F,-AVX512VL,-AVX512BW,-AVX512DQ"}
_IMAGES = {
    "OPENCV_CPU_DISABLE": "AVX512-SKX,AVX2,AVX,SSE4.2,SSE4.1",
    "OPENCV_IPP": "disabled",
    # JPEG without vector code.
    "JSIMD_FORCENONE": "1",
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Variant:
    """Another processor: what it is, the environment that makes libraries believe so, and whether it is the workers'.

    `compiles`: Numba's kernels are compiled for it, into a cache of its own.
    """

    name: str
    environment: Mapping[str, str] = field(default_factory=dict)
    is_of_workers: bool = False
    compiles: bool = False


def variants() -> tuple[Variant, ...]:
    """Return this processor and the others that it can stand in for."""
    found = _dispatched()
    newest = {"NPY_DISABLE_CPU_FEATURES": " ".join(name for name in found if "512" in name or name == "X86_V4")}
    none = {"NPY_DISABLE_CPU_FEATURES": " ".join(found)}
    oldest = {"OPENBLAS_CORETYPE": "Prescott", **none, **_LIBC, **_IMAGES}
    return (
        Variant(name="this one"),
        *(
            Variant(name=f"BLAS of {core}", environment={"OPENBLAS_CORETYPE": core})
            for core in ("SkylakeX", "Haswell", "Zen", "Prescott")
        ),
        Variant(name="NumPy without AVX-512", environment=newest),
        Variant(name="NumPy without AVX2 and FMA", environment=none),
        Variant(name="C library without AVX2 and FMA", environment=_LIBC),
        Variant(name="OpenCV and JPEG without AVX, SSE4 and IPP", environment=_IMAGES),
        Variant(name="all of these", environment=oldest),
        Variant(name="all of these, workers alone", environment=oldest, is_of_workers=True),
        Variant(
            name="all of these, kernels for any x86-64",
            environment={**oldest, "NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""},
            compiles=True,
        ),
    )


def digest_on(variant: Variant, folder: Path, *, frames: int | None = None) -> str:
    """Return the digest of the embedded recording, played as on another processor; the first `frames` with coarse ones.

    Raises:
        RuntimeError: it could not be played.
    """
    folder.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "hickory_stream", "play", str(_LOG), "--out", str(folder / "map"), "--overwrite"]
    # Kernels that are compiled first may take long.
    overrides = ["mapper.run.shape_cache=false", "mapper.run.job_timeout_s=600"]
    if frames is not None:
        command += ["--frames", str(frames)]
        overrides += COARSE
    environment = dict(variant.environment)
    if variant.compiles:
        environment["HICKORY_CACHE"] = str(folder.parent / "cache-of-variants")
    if variant.is_of_workers:
        overrides.append(f"mapper.run.worker_python={_interpreter(folder / 'worker-python', environment)}")
        environment = {}
    for override in overrides:
        command += ["--set", override]
    process = subprocess.Popen(
        [*command, "--viewer", "none", "--json"],
        cwd=ROOT,
        env={**os.environ, **environment},
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=die_with_parent,
    )
    return str(finished(process)["digest"])


def _dispatched() -> list[str]:
    """Return the groups of instructions that NumPy has code for beyond its least, and this processor has."""
    config = np.show_config(mode="dicts")
    assert config is not None
    return list(config["SIMD Extensions"].get("found", ()))


def _interpreter(path: Path, environment: Mapping[str, str]) -> Path:
    """Write a program that is our interpreter in another environment."""
    told = "".join(f'export {name}="{value}"\n' for name, value in environment.items())
    path.write_text(f'#!/bin/sh\n{told}exec "{sys.executable}" "$@"\n')
    path.chmod(0o755)
    return path
