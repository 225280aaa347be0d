"""What commands print with `--json`, held against the schema that they declare."""

from functools import cache
import jsonschema
from hickory_stream.outputs import output_schema


def checked(printed):
    """Return what was printed, after a look at its form."""
    _validator(printed["output"]).validate(printed)
    return printed


@cache
def _validator(name):
    schema = output_schema(name)
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)
