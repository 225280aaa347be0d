"""`hickory-stream batch`: map many logs, each as a separate task, and merge their maps."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hickory_stream.cli.commands import INCOMPLETE, Commands
from hickory_stream.cli.option_values import parse_workers, read_settings
from hickory_stream.cli.output_files import disk_refusals
from hickory_stream.cli.source_options import add_anyway, add_source_options, source_options
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse

    from hickory_stream.batch.result import BatchResult


def add(commands: Commands) -> None:
    batch = commands.add("batch", run, configured=True)
    batch.add_argument("logs", nargs="+", metavar="LOG", help="logs, each mapped into OUT/maps/NAME.map")
    batch.add_argument(
        "-o", "--out", type=Path, required=True, metavar="OUT", help="folder for the maps and batch.html"
    )
    batch.add_argument(
        "--workers", dest="tasks", metavar="N", help="logs at a time (as many as processors), or dask=tcp://HOST:PORT"
    )
    batch.add_argument("--merge", action="store_true", help="align and merge overlapping maps into OUT/merged.map")
    add_anyway(batch)
    add_source_options(batch)


def run(options: argparse.Namespace) -> int:
    from hickory_stream.base.atomic_files import write_output
    from hickory_stream.batch.page import text_of, write_page
    from hickory_stream.batch.run import BatchPlan, run_batch

    settings = read_settings(options)
    workers: dict[str, Any] = parse_workers(options.tasks) if options.tasks is not None else {}
    plan = BatchPlan(
        uris=tuple(options.logs),
        options=source_options(options),
        out=options.out,
        mapper=settings.mapper,
        disk=settings.disk,
        workers=workers.get("workers", 0),
        cluster=workers.get("cluster", ""),
        merges=options.merge,
        anyway=options.anyway,
    )
    result = run_batch(plan, lambda text: _tell(text, as_json=options.json))
    report = result_json(result)
    with disk_refusals(options.out / "result.json", "result"):
        write_output(options.out / "result.json", output("batch", report, indent=1).encode())
        write_page(options.out / "batch.html", result)
    if options.json:
        print(output("batch", report, indent=1))
    else:
        print(text_of(result))
        print(f"{options.out / 'batch.html'}: the same table as a page")
    if result.stopped:
        sys.stderr.write(f"hickory-stream: {result.stopped}\n")
    return 0 if result.is_whole and not result.stopped else INCOMPLETE


def _tell(text: str, *, as_json: bool) -> None:
    sys.stderr.write(f"{output('batch-said', {'event': 'said', 'text': text}) if as_json else text}\n")


def result_json(result: BatchResult) -> dict[str, Any]:
    """Return the result as JSON data."""
    joined = result.joined
    return {
        "event": "finished",
        "out": str(result.out),
        "finished": result.is_whole,
        "stopped": result.stopped,
        "wall_s": result.wall_s,
        "logs": [asdict(row) for row in result.rows],
        "joined": None
        if joined is None
        else {
            "pairs": joined.num_pairs,
            "aligned": [asdict(overlap) for overlap in joined.overlaps],
            "merged": [one.as_json("logs") for one in joined.merged],
            "signature_kb": joined.signature_kb,
            "problems": list(joined.problems),
        },
    }
