import ast
import base64
import json
import math
import re
import tomllib
from pathlib import Path
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.base.html_page import page, picture
from hickory_stream.base.json_text import dumps, dumps_exactly, toml_string

ROOT = Path(__file__).resolve().parent.parent.parent
WRITER = ROOT / "hickory_stream" / "base" / "json_text.py"


def is_python(file):
    return file.suffix == ".py" or (file.suffix == "" and file.read_bytes().startswith(b"#!/usr/bin/env python"))


FILES = sorted(
    file for part in ("hickory_stream", "players", "tools") for file in (ROOT / part).rglob("*")
    if file.is_file() and is_python(file)
)  # fmt: skip


def writers_in(source):
    found = []
    # Most files need not be parsed.
    for node in ast.walk(ast.parse(source if re.search("dump|JSONEncoder", source) else "")):
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


def test_a_page_shows_what_a_stranger_wrote_and_loads_nothing():
    text = page("a<b>\x1b[2J", "<p>x\u202ey</p>", "p { color: red; }")
    assert "<title>a&lt;b&gt;\\x1b[2J</title>" in text
    assert "<p>x\\u202ey</p>" in text
    assert "p { color: red; }</style>" in text
    assert re.search(r"https?://|<script|<link", text) is None


def test_a_large_picture_is_made_smaller_and_keeps_its_colours():
    rgb = np.zeros((40, 80, 3), dtype=np.uint8)
    rgb[:, :, 0] = 200
    shown = picture(rgb, 'a "red" one', 20)
    assert 'alt="a &quot;red&quot; one"' in shown
    data = base64.b64decode(shown.split("base64,")[1].split('"')[0])
    read = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert read.shape == (10, 20, 3)
    np.testing.assert_allclose(read[5, 10], [0, 0, 200], atol=4)
