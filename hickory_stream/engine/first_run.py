"""The first run after an installation or update: kernels are compiled before what needs them.

Child processes compile one part each into the cache. If that fails, a kernel is compiled at its first call. As a
program (`python -m hickory_stream.engine.first_run`) it compiles all parts and prints its progress.
"""

import asyncio
import contextlib
import hashlib
import json
import logging
import math
import os
import sys
import time
from collections.abc import Callable, Collection, Iterator
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
_PRINT_EVERY_S = 10.0
_DECORATOR = "\n@kernel"


async def compile_kernels(
    report: Callable[[int, int], None], *, in_background: Collection[str] = ()
) -> asyncio.Task[None] | None:
    """Compile missing kernels of a run into the cache; `report` receives the numbers compiled and estimated.

    Parts `in_background` are compiled on, in the task that is returned; None where nothing is left.
    """
    if await asyncio.to_thread(are_compiled):
        return None
    # Its imports are needed only here.
    from hickory_stream.engine.warm_up import PARTS

    total = sum(text.count(_DECORATOR) for text in (file.read_text(encoding="utf-8") for file in _files()))
    known: set[str] = set()

    async def keep_reporting() -> None:
        # A kernel takes seconds, and another process may compile it.
        while True:
            report(min(len(known), total), total)
            await asyncio.sleep(_REPORT_EVERY_S)

    async def note_all() -> None:
        if all(await asyncio.gather(*parts.values())):
            await asyncio.to_thread(_note_compiled)

    parts = {part: asyncio.create_task(_compile_part(part, known.add), name=f"compile-{part}") for part in PARTS}
    everything = asyncio.create_task(note_all(), name="compile")
    reporting = asyncio.create_task(keep_reporting(), name="report-kernels")
    try:
        await asyncio.gather(*(task for part, task in parts.items() if part not in in_background))
    except BaseException:
        everything.cancel()
        raise
    finally:
        reporting.cancel()
    if in_background:
        return everything
    await everything
    return None


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


def main() -> None:
    """Compile the kernels of a run, with lines of progress on standard error."""
    last_s = -math.inf

    def show(done: int, total: int) -> None:
        nonlocal last_s
        if time.monotonic() - last_s >= _PRINT_EVERY_S:
            last_s = time.monotonic()
            sys.stderr.write(f"compiling kernels: {done} of about {total}\n")
            sys.stderr.flush()

    asyncio.run(compile_kernels(show))


if __name__ == "__main__":
    main()
