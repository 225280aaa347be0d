import io
import re
import sys
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.base.terminal import VisibleStream, clear_line, shown_safely, visible
from hickory_stream.cli import main
from hickory_stream.cli.maps.verify import tell
from tests.conftest import copy_log

UNSAFE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")


@given(st.text(st.characters(codec=None)))
def test_terminal_commands_are_removed_and_the_rest_stays(text):
    shown = visible(text)
    assert UNSAFE.search(shown) is None
    shown.encode()
    assert visible(shown) == shown
    if UNSAFE.search(text) is None and text.isprintable():
        assert shown == text


def test_what_is_replaced_is_shown_as_a_programmer_writes_it():
    assert visible("a\x1b[31m\x9b\u202eb\tc\n\udcff\x7f") == "a\\x1b[31m\\x9b\\u202eb\tc\n\\udcff\\x7f"


def test_only_our_own_bar_moves_the_cursor(monkeypatch):
    out, err = io.StringIO(), io.StringIO()
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setattr(sys, "stderr", err)
    with shown_safely(), shown_safely():
        print("\x1b[2J")  # noqa: T201 -- what a command does
        sys.stderr.writelines(["\r\x1b[K", "\x07"])
        clear_line()
        assert isinstance(sys.stderr, VisibleStream)
        assert not sys.stderr.isatty()
    assert (sys.stdout, sys.stderr) == (out, err)
    assert out.getvalue() == "\\x1b[2J\n"
    assert err.getvalue() == "\\x0d\\x1b[K\\x07\r\x1b[K"


ESCAPES = {
    # The names of the demo's topics and, of the same length, of its frames.
    "/rgb/": "/r\x1b]0;owned\x07\x9b31m\u202eb<b>/",
    "zed_camera_center": "zed_\x1b[31m\u202enter<",
}


@pytest.fixture(scope="module")
def hostile_log(short_log, tmp_path_factory):
    (topic, hostile_topic), (frame, hostile_frame) = ESCAPES.items()
    assert len(frame.encode()) == len(hostile_frame.encode())
    return copy_log(
        short_log, tmp_path_factory.mktemp("logs") / "hostile\x1b[5m.mcap", seconds=0.7,
        topic_of=lambda name: name.replace(topic, hostile_topic),
        data_of=lambda data: data.replace(frame.encode(), hostile_frame.encode()),
    )  # fmt: skip


@pytest.fixture(scope="module")
def hostile_map(hostile_log, coarse_config, tmp_path_factory):
    folder = tmp_path_factory.mktemp("maps") / "map\x1b[5m"
    arguments = ["--out", str(folder), "--config", str(coarse_config), "--viewer", "none", "--workers", "1"]
    # Few frames confirm no object, which is status 3.
    assert main(["play", str(hostile_log), *arguments]) == 3
    return folder


def check(capsys, *statuses, told=""):
    shown = capsys.readouterr()
    for text in shown:
        assert UNSAFE.search(text) is None
    assert told in shown.out + shown.err


def test_no_command_prints_the_escapes_of_a_log(hostile_log, hostile_map, tmp_path, capsys):
    log, folder, page = str(hostile_log), str(hostile_map), tmp_path / "page.html"
    capsys.readouterr()
    assert main(["doctor", log, "--html", str(page)]) in (0, 3)
    check(capsys, told="r\\x1b]0;owned\\x07\\x9b31m\\u202eb<b>")
    text = page.read_text(encoding="utf-8")
    assert UNSAFE.search(text) is None
    assert "\\u202eb&lt;b&gt;" in text
    assert "b<b>" not in text
    assert main(["doctor", log, "--json"]) in (0, 3)
    check(capsys, told="\\u009b31m\\u202e")
    assert main(["play", log, "--out", folder, "--viewer", "none"]) == 2
    check(capsys, told="map\\x1b[5m")
    assert main(["play", log, "--out", f"{folder}2", "--color-topic", "/no\x1b[2J", "--viewer", "none"]) == 2
    check(capsys, told="/no\\x1b[2J")
    for command in (["inspect", folder], ["inspect", folder, "--json"], ["replay", folder], ["resume", folder]):
        main(command)
        check(capsys)
    with pytest.raises(SystemExit):
        main(["inspect", folder, "--no\x1b[2J"])
    check(capsys, told="--no\\x1b[2J")


def test_a_run_prints_topic_names_without_obeying_them(hostile_log, tmp_path, capsys, coarse_config):
    out = ["--out", str(tmp_path / "map"), "--frames", "1", "--viewer", "none", "--config", str(coarse_config)]
    # One frame confirms no object, which is status 3.
    assert main(["play", str(hostile_log), *out]) == 3
    check(capsys, told="color: /zed/zed_node/r\\x1b]0;owned\\x07\\x9b31m\\u202eb<b>/color")


def test_what_verify_is_at_is_drawn_over_what_it_was_at(monkeypatch):
    screen = io.StringIO()
    monkeypatch.setattr(sys, "stderr", VisibleStream(screen))
    tell("object 3")
    tell("object 4")
    assert screen.getvalue() == "\r\x1b[Kobject 3\r\x1b[Kobject 4"
