import ast
import json
import math
import tomllib
from pathlib import Path
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.base.json_text import dumps, dumps_exactly, toml_string

ROOT = Path(__file__).resolve().parent.parent.parent
WRITER = ROOT / "hickory_stream" / "base" / "json_text.py"


def is_python(file):
    return file.suffix == ".py" or (file.suffix == "" and file.read_bytes().startswith(b"#!/usr/bin/env python"))


FILES = sorted(
    file
    for part in ("hickory_stream", "players", "tools")
    for file in (ROOT / part).rglob("*")
    if file.is_file() and is_python(file)
)


def writers_in(source):
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "json":
            found.append(node.attr)
        if isinstance(node, ast.ImportFrom) and node.module == "json":
            found += [alias.name for alias in node.names]
    return [name for name in found if name in ("dump", "dumps", "JSONEncoder")]


def test_nothing_else_writes_json():
    assert len(FILES) > 300
    assert writers_in(WRITER.read_text()) != []
    # What alters maps writes JSON that is wrong on purpose.
    wrong = {"map_changes.py", "damaged_maps.py"}
    # Adapters run in environments that do not have us.
    foreign = {"serving.py"}
    found = [
        file for file in FILES if file != WRITER and file.name not in wrong | foreign and writers_in(file.read_text())
    ]
    assert found == []


def test_what_has_no_value_is_null_or_refused():
    data = {
        "a": math.nan, "b": [math.inf, 1.5], "c": (np.float32(-np.inf), np.bool_(True)), "d": np.array([1.0, np.nan]),
    }  # fmt: skip
    assert json.loads(dumps(data)) == {"a": None, "b": [None, 1.5], "c": [None, True], "d": [1.0, None]}
    assert json.loads(dumps_exactly({"a": [0.1]})) == {"a": [0.1]}
    with pytest.raises(ValueError, match="not JSON compliant"):
        dumps_exactly({"a": [math.nan]})


@given(st.text())
def test_text_comes_back_and_is_ascii(text):
    assert json.loads(dumps(text)) == text
    assert dumps(text).isascii()


@given(st.text())
def test_a_string_of_toml_comes_back_and_commands_no_terminal(text):
    written = toml_string(text)
    assert tomllib.loads(f"a = {written}")["a"] == text
    assert not any(c < " " or "\x7f" <= c < "\xa0" or "\u202a" <= c <= "\u202e" for c in written)
