"""Notification of the compilation of a kernel, without loading the compiler."""

from collections.abc import Callable

_listeners: list[Callable[[str], None]] = []


def on_compile(listener: Callable[[str], None]) -> Callable[[], None]:
    """Call `listener`, from any thread, with the name of each kernel to be compiled; return a function that ends it."""
    _listeners.append(listener)
    return lambda: _listeners.remove(listener)


def compile_begins(kernel: str) -> None:
    """Notify the listeners."""
    for listener in tuple(_listeners):
        listener(kernel)
