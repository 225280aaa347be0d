"""The command line: one module per command, which adds its arguments and runs it.

A command imports what it needs when it runs, so that `--help` answers at once. Exit status: 0 done; 1 internal failure;
2 bad input; 3 no alignment, path or answer, all shape jobs failed, or an output is incomplete; 130 stopped by a signal.
"""

import argparse
import logging
import sys
import time
import traceback
from collections.abc import Callable, Sequence

from hickory_stream.base.compiling import on_compile
from hickory_stream.base.terminal import shown_safely
from hickory_stream.cli.commands import STOPPED
from hickory_stream.cli.output_files import outputs_of, refuse_taken, written_text
from hickory_stream.cli.parser import make_parser
from hickory_stream.errors import HickoryError
from hickory_stream.outputs import output

_AFTER_S = 1.5
_AFTER_KERNELS = 4
_EVERY_S = 5.0


class CompileNotice:
    """Listener of `compiling.on_compile` that prints a line for many kernels, and nothing for a few."""

    def __init__(self, *, as_json: bool, clock: Callable[[], float] = time.monotonic) -> None:
        self._as_json = as_json
        self._clock = clock
        self._began_s: float | None = None
        self._said_s = 0.0
        self._num_compiled = 0

    def __call__(self, _kernel: str) -> None:
        """Count a kernel that is about to be compiled."""
        now_s = self._clock()
        if self._began_s is None:
            self._began_s, self._said_s = now_s, now_s + _AFTER_S - _EVERY_S
        if now_s - self._said_s >= _EVERY_S and self._num_compiled >= _AFTER_KERNELS:
            self._said_s = now_s
            seconds = now_s - self._began_s
            if self._as_json:
                text = output(
                    "compiling", {"event": "progress", "phase": "compiling", "num_compiled": self._num_compiled}
                )
            else:
                text = (
                    "compiling kernels, once after an installation or update: "
                    f"{self._num_compiled} so far, {seconds:.0f} s"
                )
            sys.stderr.write(text + "\n")
            sys.stderr.flush()
        self._num_compiled += 1


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status; control characters in its output are escaped."""
    with shown_safely():
        return _run(arguments)


def _run(arguments: Sequence[str] | None) -> int:
    options = make_parser().parse_args(arguments)
    logging.basicConfig(level=logging.DEBUG if options.debug else logging.WARNING, format="%(levelname)s: %(message)s")
    # It would log every instruction that it compiles.
    logging.getLogger("numba").setLevel(logging.WARNING)
    stop_notices = on_compile(CompileNotice(as_json=getattr(options, "json", False)))
    try:
        refuse_taken(outputs_of(options), overwrite=getattr(options, "overwrite", False))
        status: int = options.run(options)
        if not getattr(options, "json", False):
            for path in outputs_of(options):
                if path.is_file():
                    print(written_text(path))
    except HickoryError as error:
        _fail(str(error), options)
        return error.exit_status
    except KeyboardInterrupt:
        resumed_by = getattr(options, "resumed_by", None)
        _fail("cancelled; earlier saves are kept" + (f"; continue with: {resumed_by}" if resumed_by else ""), options)
        return STOPPED
    except BrokenPipeError:
        return 0
    except MemoryError as error:
        # The map or log is larger than this machine, or was altered to look so.
        what = str(error) or "out of memory"
        _fail(f"found too little memory: {what}; use a machine with more, or a smaller map or log", options)
        return 2
    except Exception as error:  # noqa: BLE001 -- unforeseen errors end here, in one line
        if options.debug:
            traceback.print_exc()
        _fail(f"internal failure, {type(error).__name__}: {error}; run with --debug to see where", options)
        return 1
    finally:
        stop_notices()
    return status


def _fail(text: str, options: argparse.Namespace) -> None:
    message = " ".join(text.split())  # libraries may use several lines
    sys.stderr.write(f"hickory-stream: {message}\n")
    if getattr(options, "json", False):
        print(output("error", {"event": "error", "message": message}))
