"""Notification of the compilation of a kernel, without loading the compiler."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

_told: list[Callable[[str], None]] = []


def on_compile(listener: Callable[[str], None]) -> Callable[[], None]:
    """Call `listener`, from any thread, with the name of each kernel to be compiled; return a function that ends it."""
    _told.append(listener)
    return lambda: _told.remove(listener)


def compile_begins(kernel: str) -> None:
    """Notify the listeners."""
    for listener in tuple(_told):
        listener(kernel)
