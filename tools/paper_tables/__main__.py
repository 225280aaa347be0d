"""Measure the paper's tables: `tools/paper [--table NAME] [--data DIR] [-o FOLDER] [--quick]`."""

import argparse
import sys
import time
from pathlib import Path

import cv2
import numpy as np

from hickory_stream.base.atomic_files import write_output
from hickory_stream.base.json_text import dumps
from hickory_stream.errors import HickoryError
from tools.paper_tables.alignment import alignment_table
from tools.paper_tables.counterparts import write_counterparts
from tools.paper_tables.data_sets import DATA_SETS
from tools.paper_tables.navigation import navigation_table
from tools.paper_tables.storage import storage_table
from tools.paper_tables.tables import Table, as_csv, as_json, chart, markdown
from tools.paper_tables.views import views_table
from tools.paper_tables.workshop import FULL, QUICK, Workshop

TABLES = {
    "views": views_table, "shapes": storage_table, "alignment": alignment_table, "navigation": navigation_table,
}  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    """Return the exit status: 0, or 2 where the data folder holds none of the data sets or a folder is refused."""
    parser = argparse.ArgumentParser(
        prog="tools/paper",
        description="Measure the paper's tables. The same command goes on where an earlier one stopped.",
        epilog="data sets: " + " ".join(data_set.how_to_get() for data_set in DATA_SETS),
    )
    parser.add_argument("--table", choices=(*TABLES, "all"), default="all")
    parser.add_argument("--data", type=Path, metavar="DIR", help="the data sets (default: synthetic counterparts)")
    parser.add_argument("-o", "--out", type=Path, default=Path("paper_tables"), metavar="FOLDER")
    parser.add_argument("--workers", type=int, metavar="N", help="child processes that build shapes")
    parser.add_argument("--quick", action="store_true", help="one short scene of each data set")
    options = parser.parse_args(arguments)
    try:
        return _run(options)
    except OSError as error:
        print(f"tools/paper: cannot write into {options.out}: {error}", file=sys.stderr)
        return 2
    except HickoryError as error:
        print(f"tools/paper: {error}", file=sys.stderr)
        return 2


def _run(options: argparse.Namespace) -> int:
    plan = QUICK if options.quick else FULL
    started = time.monotonic()

    def told(text: str) -> None:
        print(f"{time.monotonic() - started:6.0f} s  {text}", file=sys.stderr, flush=True)

    shop = Workshop(options.out, options.workers, told)
    if options.data is None:
        data = options.out / "counterparts" / ("quick" if options.quick else "full")
        write_counterparts(plan, data, told)
        caption = "synthetic counterparts of the data sets, not the data sets themselves"
    else:
        data = options.data
        missing = [line for data_set in DATA_SETS for line in data_set.missing(data)]
        for line in missing:
            print(line, file=sys.stderr)
        if missing:
            print("what to download:", file=sys.stderr)
            for data_set in DATA_SETS:
                if data_set.missing(data):
                    print(f"  {data_set.how_to_get()}", file=sys.stderr)
        if all(data_set.folder(data) is None for data_set in DATA_SETS):
            return 2
        caption = f"data sets in {data}"
    names = list(TABLES) if options.table == "all" else [options.table]
    for name in names:
        table = TABLES[name](data, plan, shop, caption)
        _write(options.out, table)
        print(markdown(table))
    print(f"{options.out}: {', '.join(f'{name}.md .csv .json .svg .png' for name in names)}")
    return 0


def _write(folder: Path, table: Table) -> None:
    drawing = chart(table)
    write_output(folder / f"{table.name}.md", markdown(table).encode())
    write_output(folder / f"{table.name}.csv", as_csv(table).encode())
    write_output(folder / f"{table.name}.json", dumps(as_json(table), indent=1).encode())
    write_output(folder / f"{table.name}.svg", drawing.svg().encode())
    bgr = np.ascontiguousarray(drawing.image()[..., ::-1])
    write_output(folder / f"{table.name}.png", cv2.imencode(".png", bgr)[1].tobytes())


if __name__ == "__main__":
    sys.exit(main())
