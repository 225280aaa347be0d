"""`hickory-stream schema`: list the `--json` outputs, or print the JSON Schema of one."""

import argparse

from hickory_stream.base.json_text import dumps
from hickory_stream.cli.commands import Commands
from hickory_stream.errors import InputError


def add(commands: Commands) -> None:
    schema = commands.add("schema", run)
    schema.add_argument("name", nargs="?", metavar="OUTPUT", help="value of the key `output`; without it, list all")


def run(options: argparse.Namespace) -> int:
    from hickory_stream.outputs import OUTPUTS, output_schema

    if options.name is not None and options.name not in OUTPUTS:
        raise InputError(f"found no output {options.name}, expected one of {', '.join(OUTPUTS)}")
    if options.name is not None:
        print(dumps(output_schema(options.name), indent=1))
        return 0
    schemas = {name: output_schema(name) for name in OUTPUTS}
    if options.json:
        print(dumps(schemas, indent=1))
        return 0
    width = max(map(len, schemas))
    print("\n".join(f"{name:<{width}}  {schema['description'].splitlines()[0]}" for name, schema in schemas.items()))
    return 0
