"""`hickory-stream generators`: list or check the shape generators of this machine."""

import argparse
from pathlib import Path
from typing import Any

from hickory_stream.cli.commands import Commands
from hickory_stream.cli.output_files import add_output, write_picture
from hickory_stream.errors import HickoryError
from hickory_stream.outputs import output


def add(commands: Commands) -> None:
    actions = commands.group("generators", _list)
    actions.add("list", _list)
    check = actions.add("check", _check)
    check.add_argument("name", metavar="NAME", help="TOML file, or name in the folder of generators")
    add_output(check, "-o", "--out", type=Path, metavar="PNG", help="draw its mesh over the input")


def _list(options: argparse.Namespace) -> int:
    from hickory_stream.engine.shape_jobs.generators.spec import generators_folder, missing_of, read_spec

    folder = generators_folder()
    rows: list[dict[str, Any]] = []
    for path in sorted(folder.glob("*.toml")):
        try:
            spec = read_spec(path)
        except HickoryError as error:
            rows.append({"name": path.stem, "file": str(path), "licence": "", "acceptance": "", "state": str(error)})
            continue
        state = "; ".join(f"lacks {missing}" for missing in missing_of(spec)) or "ok"
        report = {"licence": spec.licence, "acceptance": spec.acceptance, "state": state}
        rows.append({"name": path.stem, "file": str(path), **report})
    if options.json:
        print(output("generators-list", {"folder": str(folder), "generators": rows}))
        return 0
    for row in rows:
        print(f"{row['name']}  {row['licence']}  {row['state']}")
    if not rows:
        print(f"no generators in {folder}; add a TOML file (hickory_stream/engine/shape_jobs/generators/README.md)")
    return 0


def _check(options: argparse.Namespace) -> int:
    from hickory_stream.engine.shape_jobs.generators.check import checked
    from hickory_stream.engine.shape_jobs.generators.spec import find_spec, read_spec

    path = find_spec(options.name)
    text, picture = checked(read_spec(path), path)
    if options.out is not None and picture is not None:
        write_picture(options.out, picture)
        text["picture"] = str(options.out)
    if options.json:
        print(output("generators-check", text))
    else:
        print("\n".join(f"{key:<12}{value}" for key, value in text.items()))
    return 0 if text["is_usable"] else 1
