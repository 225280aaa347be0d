"""The rows of the main README's table of results, each measured by its benchmark in a process of its own."""
# A row that is as new as the code it depends on is not measured again, so that a call that was stopped continues. The
# times beside the rows are those of two cores with empty caches; they add up to at most 45 minutes.

import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from tools.benchmarks.common.documents import MEASURED, read_measured
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.common.processes import ROOT, die_with_parent
from tools.benchmarks.table import code_of

_MINUTES = 45.0
# Of the rooms by others: walk A by hand.
_ROOMS = tuple(f"{world}:A:hand:ours" for world in ("home", "bookstore", "office", "warehouse"))
ROWS: tuple[tuple[str, ...], ...] = (
    ("main", "--quick"),  # 1 minute
    ("damage", "--minutes", "4"),  # 1
    ("navigation", "--quick"),  # 8
    ("align", "--quick"),  # 2
    ("live", "--quick"),  # 2
    ("engine", "--only", "digests", "--minutes", "3"),
    ("engine", "--only", "kills", "--minutes", "4"),
    ("foreign", "--only", "kitchen"),  # 2
    ("foreign", "--only", *_ROOMS),  # 12
    ("foreign", "--only", "outdoor"),  # 5
    ("quality", "--only", "apartments"),  # 10
)


def measure(options: Options) -> list[Figure]:
    """Measure the rows that are older than the code (with `fresh` all) and write each into the READMEs."""
    # No row begins after 45 minutes, or `minutes`.
    until = time.monotonic() + 60 * min(options.minutes, _MINUTES)
    for name, *arguments in ROWS:
        row = " ".join(["tools/bench", name, *arguments])
        if not options.fresh and is_current(name, arguments):
            state = "as new as the code"
        elif time.monotonic() >= until:
            state = "not measured for want of time"
        else:
            print(f"{row}: measuring", flush=True)
            command = [sys.executable, "-m", "tools.benchmarks", name, *arguments, "--write-docs"]
            failed = subprocess.run(command, cwd=ROOT, preexec_fn=die_with_parent).returncode
            state = "failed" if failed else "measured"
        print(f"{row}: {state}", flush=True)
    num_current = sum(is_current(name, arguments) for name, *arguments in ROWS)
    return [figure("headline_rows_current", num_current, "rows", "higher", f"{len(ROWS)} rows")]


def is_current(name: str, arguments: Sequence[str], folder: Path = MEASURED) -> bool:
    options = "".join(f" {word}" for word in arguments)
    return any((run.options, run.code) == (options, code_of(name, options)) for run in read_measured(name, folder))
