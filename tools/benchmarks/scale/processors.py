"""Portability of maps: the same log is played while libraries choose their code as on other processors."""
# Each variant has one library choose its code as on another machine, by the library's own switch; the last ones set all
# switches. One compiles the kernels for any x86-64, which takes minutes.

import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tools.benchmarks.common.processes import finished, overridden, play_coarsely

_LIBC = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX512F,-AVX512VL,-AVX512BW,-AVX512DQ"}
_IMAGES = {
    "OPENCV_CPU_DISABLE": "AVX512-SKX,AVX2,AVX,SSE4.2,SSE4.1",
    "OPENCV_IPP": "disabled",
    # JPEG without vector code.
    "JSIMD_FORCENONE": "1",
}
_KERNELS = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}


@dataclass(frozen=True, kw_only=True, slots=True)
class Variant:
    """Another processor: its name, the environment that makes libraries choose its code, and whether for workers alone.

    `compiles`: Numba's kernels are compiled for it, into a cache of its own.
    """

    name: str
    environment: Mapping[str, str] = field(default_factory=dict)
    is_of_workers: bool = False
    compiles: bool = False


def variants() -> tuple[Variant, ...]:
    config = np.show_config(mode="dicts")
    assert config is not None
    # The groups of instructions for which NumPy has code beyond its least, and which this processor has.
    found = list(config["SIMD Extensions"].get("found", ()))
    newest = {"NPY_DISABLE_CPU_FEATURES": " ".join(name for name in found if "512" in name or name == "X86_V4")}
    none = {"NPY_DISABLE_CPU_FEATURES": " ".join(found)}
    oldest = {"OPENBLAS_CORETYPE": "Prescott", **none, **_LIBC, **_IMAGES}
    environments = {
        "this one": {},
        **{f"BLAS of {core}": {"OPENBLAS_CORETYPE": core} for core in ("SkylakeX", "Haswell", "Zen", "Prescott")},
        "NumPy without AVX-512": newest, "NumPy without AVX2 and FMA": none, "C library without AVX2 and FMA": _LIBC,
        "OpenCV and JPEG without AVX, SSE4 and IPP": _IMAGES, "all of these": oldest,
    }  # fmt: skip
    return (
        *(Variant(name=name, environment=environment) for name, environment in environments.items()),
        Variant(name="all of these, workers alone", environment=oldest, is_of_workers=True),
        Variant(name="all of these, kernels for any x86-64", environment={**oldest, **_KERNELS}, compiles=True),
    )


def digest_on(variant: Variant, folder: Path, *, frames: int | None = None) -> str:
    """Return the digest of the embedded recording, played as on another processor; coarsely, if only `frames` of it."""
    folder.mkdir(parents=True, exist_ok=True)
    # Kernels that are compiled first may take long.
    overrides = ["run.shape_cache=false", "run.job_timeout_s=600"]
    environment = dict(variant.environment)
    if variant.compiles:
        environment["HICKORY_CACHE"] = str(folder.parent / "cache-of-variants")
    if variant.is_of_workers:
        overrides.append(f"run.worker_python={_interpreter(folder / 'worker-python', environment)}")
        environment = {}
    process = play_coarsely(folder / "map", frames, *overridden(*overrides), env={**os.environ, **environment})
    return str(finished(process)["digest"])


def _interpreter(path: Path, environment: Mapping[str, str]) -> Path:
    exports = "".join(f'export {name}="{value}"\n' for name, value in environment.items())
    path.write_text(f'#!/bin/sh\n{exports}exec "{sys.executable}" "$@"\n')
    path.chmod(0o755)
    return path
