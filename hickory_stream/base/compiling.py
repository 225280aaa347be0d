"""Notification that a kernel is being compiled, which takes seconds, once after an installation or an update.

Apart from `compiled`, so that one can ask to be told without loading the compiler.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

_told: list[Callable[[str], None]] = []


def tell_when_compiling(listener: Callable[[str], None]) -> Callable[[], None]:
    """Have `listener` called with a kernel's name when it begins to be compiled, from any thread; return what ends it.

    Kernels that are loaded from the cache are not told of.
    """
    _told.append(listener)
    return lambda: _told.remove(listener)


def compile_begins(kernel: str) -> None:
    """Notify the listeners."""
    for listener in tuple(_told):
        listener(kernel)
