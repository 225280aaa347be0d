"""The first run after an installation or update: kernels are compiled before anything is played.

Child processes compile one part each into the cache. If that fails, a kernel is compiled at its first call.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import json
import logging
import os
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import llvmlite.binding

from hickory_stream.base.caches import cache_root, mark_used
from hickory_stream.base.compiled import kernels_folder, numba, source_hash

logger = logging.getLogger(__name__)

_ROOT = Path(__file__).resolve().parents[1]
_PACKAGES = ("geometry", "perception", "mapping", "shapes")
_LEFT_OUT = "models"  # networks have kernels that few runs need
_REPORT_EVERY_S = 1.0
_DECORATOR = "\n@kernel"


async def compile_kernels(report: Callable[[int, int], None]) -> None:
    """Compile missing kernels of a run into the cache; `report` receives the numbers compiled and estimated."""
    if await asyncio.to_thread(are_compiled):
        return
    # Its imports are needed only here.
    from hickory_stream.engine.warm_up import PARTS

    total = sum(text.count(_DECORATOR) for text in (file.read_text(encoding="utf-8") for file in _files()))
    known: set[str] = set()

    def add(kernel: str) -> None:
        known.add(kernel)
        report(min(len(known), total), total)

    async def keep_reporting() -> None:
        while True:
            report(min(len(known), total), total)
            await asyncio.sleep(_REPORT_EVERY_S)

    # A kernel takes seconds, and another process may compile it.
    reporting = asyncio.create_task(keep_reporting(), name="report-kernels")
    try:
        done = await asyncio.gather(*(_compile_part(part, add) for part in PARTS))
    finally:
        reporting.cancel()
    if all(done):
        await asyncio.to_thread(_note_compiled)


def are_compiled() -> bool:
    """Return whether an earlier run compiled the kernels of this code, compiler and processor."""
    mark = kernels_folder() / _mark()
    mark_used(mark)
    return mark.exists()


async def _compile_part(part: str, add: Callable[[str], None]) -> bool:
    try:
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "hickory_stream.engine.warm_up", part),
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.DEVNULL,
            env={**os.environ, "HICKORY_CACHE": str(cache_root())},
            # A group of its own: Ctrl-C is for the run, which then ends its children in order.
            start_new_session=True,
        )
    except OSError as error:
        logger.debug("kernels of %s: %s", part, error)
        return False
    assert process.stdout is not None
    try:
        async for line in process.stdout:
            with contextlib.suppress(ValueError, KeyError, TypeError):  # a library had something to say
                add(json.loads(line)["kernel"])
        return await process.wait() == 0
    finally:
        if process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()


def _note_compiled() -> None:
    with contextlib.suppress(OSError):  # the next run asks once more
        kernels_folder().mkdir(parents=True, exist_ok=True)
        (kernels_folder() / _mark()).touch()


@cache
def _mark() -> str:
    # An empty file of this name says that all kernels of this code and processor are compiled.
    host = (llvmlite.binding.get_host_cpu_name(), sorted(llvmlite.binding.get_host_cpu_features().items()))
    processor = (*host, numba.config.CPU_NAME, numba.config.CPU_FEATURES)
    digest = hashlib.sha256(repr(processor).encode())
    for file in _files():
        module = ".".join(("hickory_stream", *file.relative_to(_ROOT).with_suffix("").parts))
        digest.update(source_hash(module, file).encode())
    return f"complete-{digest.hexdigest()[:16]}"


def _files() -> Iterator[Path]:
    for package in _PACKAGES:
        for file in sorted((_ROOT / package).rglob("*.py")):
            if _LEFT_OUT not in file.parts and _DECORATOR in file.read_text(encoding="utf-8"):
                yield file
