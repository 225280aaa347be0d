"""The command line: one module per command, which adds its arguments and runs it.

A command imports what it needs only when it runs, so that `--help` answers at once.

Exit status: 0 done; 1 an internal failure; 2 something outside is not as it must be; 3 the answer is no: two maps
were not aligned, there is no path, nothing answers a question; or the run is done but something that was asked for is
missing: every shape job failed, or a recording or costmap could not be written to its end; 130 stopped by a signal (the
map is saved).
"""

from __future__ import annotations

import logging
import sys
import traceback
from typing import TYPE_CHECKING

from hickory_stream.base.compiling import tell_when_compiling
from hickory_stream.base.terminal import shown_safely
from hickory_stream.cli.compile_notice import CompileNotice
from hickory_stream.cli.parser import make_parser
from hickory_stream.cli.status import STOPPED
from hickory_stream.cli.written import outputs_of, refuse_taken, written_text
from hickory_stream.errors import HickoryError
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status; nothing that it prints commands the terminal."""
    with shown_safely():
        return _run(arguments)


def _run(arguments: Sequence[str] | None) -> int:
    options = make_parser().parse_args(arguments)
    logging.basicConfig(level=logging.DEBUG if options.debug else logging.WARNING, format="%(levelname)s: %(message)s")
    told_no_more = tell_when_compiling(CompileNotice(as_json=getattr(options, "json", False)))
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
        _fail(
            "cancelled; what was saved before is kept" + (f"; go on with: {resumed_by}" if resumed_by else ""), options
        )
        return STOPPED
    except BrokenPipeError:
        return 0
    except MemoryError as error:
        # A map or a log that is larger than this machine, or one that somebody altered to look so.
        what = str(error) or "no more can be had"
        _fail(f"found too little memory: {what}; expected a machine with more, or a smaller map or log", options)
        return 2
    except Exception as error:  # noqa: BLE001 -- what nobody foresaw ends here, in one line
        if options.debug:
            traceback.print_exc()
        _fail(f"internal failure, {type(error).__name__}: {error}; run with --debug to see where", options)
        return 1
    finally:
        told_no_more()
    return status


def _fail(text: str, options: argparse.Namespace) -> None:
    message = " ".join(text.split())  # one line, whatever a library had to say
    sys.stderr.write(f"hickory-stream: {message}\n")
    if getattr(options, "json", False):
        print(output("error", {"event": "error", "message": message}))
