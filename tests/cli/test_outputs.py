import ast
import json
from pathlib import Path
from typing import Any, NotRequired, TypedDict
import jsonschema
import pytest
from hickory_stream.base.json_schema import schema_of
from hickory_stream.config import RunConfig
from hickory_stream.outputs import OUTPUTS, VERSION, output, output_schema
from tests.cli.test_cli import look, refusal, said
from tests.output_forms import checked

ROOT = Path(__file__).resolve().parent.parent.parent
FILES = [*sorted((ROOT / "hickory_stream" / "cli").rglob("*.py")), ROOT / "hickory_stream" / "progress.py"]


def calls(name):
    for file in FILES:
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == name:
                yield file, node


def test_every_output_that_is_declared_is_printed_and_no_other():
    used = {node.args[0].value for _, node in calls("output") if isinstance(node.args[0], ast.Constant)}
    assert used == set(OUTPUTS)
    assert {file.name for file, _ in calls("dumps")} <= {"schema.py"}


@pytest.mark.parametrize("name", OUTPUTS)
def test_every_schema_is_one_and_says_what_it_is(name):
    schema = output_schema(name)
    jsonschema.Draft202012Validator.check_schema(schema)
    assert schema["description"]
    assert schema["properties"]["version"] == {"const": VERSION}
    assert schema["additionalProperties"] is False


def test_what_differs_from_its_form_or_has_none_is_noticed():
    with pytest.raises(KeyError, match="declare it in OUTPUTS"):
        output("poem", {})
    checked(json.loads(output("config-check", {"ok": True})))
    for wrong in ({}, {"ok": False}, {"ok": True, "more": 1}):
        with pytest.raises(jsonschema.ValidationError):
            checked(json.loads(output("config-check", wrong)))


class Inner(TypedDict):
    """An inner one."""

    a: tuple[int, float]
    b: NotRequired[list[str | None]]


@pytest.mark.parametrize(("kind", "good", "bad"), [
    (Inner, {"a": [1, None]}, {"a": [1.5, 2.0]}),
    (Inner, {"a": [1, 2.5], "b": ["x", None]}, {"a": [1, 2.5, 3]}),
    (dict[str, bool], {"x": True}, {"x": 1}),
    (Any, [1, "a"], None),
])  # fmt: skip
def test_a_schema_allows_what_its_type_does(kind, good, bad):
    validator = jsonschema.Draft202012Validator(schema_of(kind))
    assert validator.is_valid(good)
    assert bad is None or not validator.is_valid(bad)


def test_the_ranges_of_the_configuration_are_in_its_schema():
    expected = {"type": "integer", "minimum": 1, "maximum": 1024, "$comment": "processes"}
    assert schema_of(RunConfig)["properties"]["workers"] == expected
    with pytest.raises(TypeError, match="no JSON is known"):
        schema_of(Path)


COMMANDS = (
    "config dump", "config check FILE", "config check no.toml", "models where", "models list", "generators list",
    "cache show", "doctor no.mcap", "evaluate --explain",
)  # fmt: skip


@pytest.mark.parametrize("command", COMMANDS)
def test_what_commands_print_keeps_to_its_form(command, coarse_config):
    words = command.replace("FILE", str(coarse_config)).split()
    look(*words, "--json").json()


def test_the_schema_is_printed_for_one_for_all_or_names_alone():
    one = json.loads(said("schema", "inspect"))
    assert "place" in one["properties"]["objects"]["items"]["properties"]
    assert json.loads(said("schema", "--json"))["inspect"] == one
    assert [line.split()[0] for line in said("schema").splitlines()] == list(OUTPUTS)
    assert "found no output poem, expected one of " in refusal("schema", "poem")
