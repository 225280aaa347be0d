r"""Safe text on a terminal: control sequences in names from a log or a map are shown, not executed.

The command line prints everything through `shown_safely`, which shows control characters and changes of the writing
direction as escapes, like `\x1b`.
"""

import contextlib
import re
import sys
from collections.abc import Iterable, Iterator
from typing import Any, TextIO

# C0 without tab and line feed, DEL, C1; what changes the direction of writing; other ends of a line; halves of pairs,
# which stand for bytes of a file's name that are no UTF-8, and which no terminal takes.
UNSAFE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
_CLEAR_LINE = "\r\x1b[K"


def visible(text: str) -> str:
    r"""Return text with control characters as escapes, like `\x1b` or `\u202e`."""
    return UNSAFE.sub(_escape, text)


def clear_line() -> None:
    """Return to the beginning of the last line of standard error, as a progress bar does."""
    stream = sys.stderr
    (stream.plain if isinstance(stream, VisibleStream) else stream).write(_CLEAR_LINE)


class VisibleStream:
    """A text stream that makes text visible before writing it to `plain`."""

    def __init__(self, plain: TextIO) -> None:
        self.plain = plain

    def write(self, text: str) -> int:
        """Write visible text; return the number of its characters."""
        self.plain.write(visible(text))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write several texts."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.plain, name)


@contextlib.contextmanager
def shown_safely() -> Iterator[None]:
    """Make everything visible that the block writes to standard output and standard error."""
    with contextlib.ExitStack() as stack:
        for redirect, stream in ((contextlib.redirect_stdout, sys.stdout), (contextlib.redirect_stderr, sys.stderr)):
            if stream is not None and not isinstance(stream, VisibleStream):
                stack.enter_context(redirect(VisibleStream(stream)))
        yield


def _escape(found: re.Match[str]) -> str:
    code = ord(found[0])
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"
