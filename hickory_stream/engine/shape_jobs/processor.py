"""Which kind of processor a map depends on: none, where all arithmetic that decided it rounds alike everywhere.

From pixels to layer 4 that is shown for x86-64 (`tools/bench engine --only processors`). The network of affinities adds
integers (`perception/affinity/pixel_network.py`). It is not shown for other networks, which run as onnxruntime chooses,
for perception that a caller brings, for alignment, for the codecs of lossy views, and on other architectures, where
libraries may have been compiled with fused products.
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
    """Return the architecture, the processor as compilers call it, and the kernels that BLAS has chosen for it."""
    blas = sorted({f"{one['internal_api']} {one.get('architecture', '')}".strip() for one in threadpool_info()})
    return ", ".join([f"{platform.machine().lower()} {binding.get_host_cpu_name()}", *blas])


def processor_of_shapes() -> str:
    """Return the kind of processor that shapes built here depend on, "" for none."""
    return "" if platform.machine().lower() in _SHOWN else processor_kind()


def processor_of_run(perception: PerceptionConfig, *, is_own: bool, has_lossy_views: bool = False) -> str:
    """Return the kind of processor that a run's map depends on, "" for none; `is_own`: perception is the configured.

    Lossy views have the colours that a codec gave them, whose version is named then, too.
    """
    if has_lossy_views:
        return f"{processor_kind()}, codecs of OpenCV {cv2.__version__}"
    has_network = (
        perception.segmenter == "fastsam" or perception.extractor != "color_texture" or perception.semantics != "none"
    )
    return processor_kind() if has_network or not is_own else processor_of_shapes()
