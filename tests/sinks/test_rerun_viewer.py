from pathlib import Path
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.errors import ViewerError
from hickory_stream.geometry.display import color_of_id
from hickory_stream.sinks.rerun.viewer import (
    ViewerChoice,
    ViewerKind,
    free_port,
    host_and_port,
    parse_viewer,
    start_viewer,
)

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("kind", ["none", "spawn", "web"])
def test_a_viewer_is_chosen_by_its_name(kind):
    assert parse_viewer(kind) == ViewerChoice(kind=ViewerKind(kind))


@pytest.mark.parametrize("text", ["rerun+http://10.0.0.7:9001/proxy", "10.0.0.7:9001"])
def test_a_running_viewer_is_named_by_url_or_host_and_port(text):
    choice = parse_viewer(f"connect={text}")
    assert choice.kind is ViewerKind.CONNECT
    assert host_and_port(choice.url) == ("10.0.0.7", 9001)


@pytest.mark.parametrize(
    "text", ["", "windo", "connect", "connect=", "connect=http://a/proxy", "connect=rerun://a/other", "connect=a:b"]
)
def test_anything_else_is_refused(text):
    with pytest.raises(ViewerError):
        parse_viewer(text)


def test_the_refusal_names_the_choices():
    with pytest.raises(ViewerError, match="auto, none, spawn, web, or connect=URL"):
        parse_viewer("windo")


def test_a_window_opens_only_where_there_is_a_screen(monkeypatch):
    monkeypatch.setattr("sys.platform", "linux")
    for name in ("WAYLAND_DISPLAY", "DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert parse_viewer("auto").kind is ViewerKind.NONE
    with pytest.raises(ViewerError, match="--viewer web"):
        start_viewer(parse_viewer("spawn"), bind="127.0.0.1", server_memory_limit="1MB")
    monkeypatch.setenv("DISPLAY", ":0")
    assert parse_viewer("auto").kind is ViewerKind.SPAWN


def test_an_address_that_is_not_ours_is_refused():
    with pytest.raises(ViewerError, match=r"192\.0\.2\.1"):
        free_port(0, bind="192.0.2.1")


@pytest.mark.parametrize("file", ["README.md", "tools/demo"])
def test_commands_for_a_viewer_listen_on_this_machine_only(file):
    lines = [line for line in (ROOT / file).read_text().splitlines() if "bin/rerun " in line]
    assert lines
    assert all("bin/rerun --bind 127.0.0.1 " in line for line in lines)


@given(st.integers(0, 2000), st.integers(1, 4))
def test_neighbouring_ids_have_distinct_colours(object_id, step):
    a, b = color_of_id(object_id), color_of_id(object_id + step)
    assert sum(abs(x - y) for x, y in zip(a, b, strict=True)) >= 60
