"""The kind of processor that a map depends on: none if all deciding arithmetic rounds alike everywhere.

That is shown for x86-64 from pixels to layer 4 (`tools/bench engine --only processors`); the affinity network adds
integers. It is not shown for other networks (onnxruntime), a caller's perception, alignment, codecs of lossy views, and
other architectures, whose libraries may use fused products.
"""

from __future__ import annotations

import platform
from functools import cache
from typing import TYPE_CHECKING

import cv2
from llvmlite import binding
from threadpoolctl import threadpool_info

if TYPE_CHECKING:
    from hickory_stream.perception.perceive import PerceptionConfig

_SHOWN = ("x86_64", "amd64")


@cache
def processor_kind() -> str:
    """Return the architecture, the compiler's name of the processor, and the kernels that BLAS has chosen."""
    blas = sorted({f"{one['internal_api']} {one.get('architecture', '')}".strip() for one in threadpool_info()})
    return ", ".join([f"{platform.machine().lower()} {binding.get_host_cpu_name()}", *blas])


def processor_of_shapes() -> str:
    """Return the kind of processor that shapes depend on, "" for none."""
    return "" if platform.machine().lower() in _SHOWN else processor_kind()


def processor_of_run(perception: PerceptionConfig, *, is_own: bool, has_lossy_views: bool = False) -> str:
    """Return the kind of processor that a run's map depends on, "" for none; `is_own`: the configured perception.

    Lossy views add the version of their codec.
    """
    if has_lossy_views:
        return f"{processor_kind()}, codecs of OpenCV {cv2.__version__}"
    return processor_kind() if perception.has_network or not is_own else processor_of_shapes()
