"""Whatever takes longer than a millisecond runs on a thread, one for what must come in order."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import ThreadPoolExecutor

T = TypeVar("T")


async def on_thread(executor: ThreadPoolExecutor, function: Callable[..., T], *arguments: object) -> T:
    """Return what a function gives that runs on a thread of an executor."""
    return await asyncio.get_running_loop().run_in_executor(executor, function, *arguments)
