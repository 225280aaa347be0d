"""`hickory-stream live` from the command line."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from hickory_stream.cli import main
from tests.test_cli import EAGER, run

if TYPE_CHECKING:
    from pathlib import Path

    import pytest


def test_a_stream_becomes_a_map_with_a_ledger_in_which_nothing_is_missing(
    short_log: Path, coarse_config: Path, tmp_path: Path
) -> None:
    out = tmp_path / "map"
    ended = run(
        "live", f"mcap:{short_log}", "--out", out, "--config", coarse_config, "--viewer", "none", "--json", *EAGER
    )
    assert ended.status == 0, ended.stderr
    finished = json.loads(ended.stdout.splitlines()[-1])
    messages = finished["ledger"]["messages"]
    assert messages["declared"] > 200
    assert messages["difference"] == 0
    assert json.loads((out / "manifest.json").read_text())["run"]["mode"] == "live"
    events = [json.loads(line) for line in ended.stderr.splitlines()]
    status = [event for event in events if event.get("event") == "status"][-1]
    assert {topic["role"] for topic in status["topics"]} == {"tf", "color", "depth", "color_info", "depth_info", "pose"}
    assert sum(topic["received"] for topic in status["topics"]) == messages["declared"]


def test_what_is_missing_and_what_cannot_be_is_said_in_one_line(
    short_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    uri = f"mcap:{short_log}"
    for arguments, told in (
        (("zenith://robot",), "found zenith://robot, expected one of"),
        ((f"mcap:{tmp_path}/none",), "no such file or pipe"),
        ((uri, "--wait", "-1"), "found --wait -1, expected seconds, 0 or more"),
        ((uri, "--for", "0"), "found --for 0, expected seconds"),
        ((uri, "--pose-topic", "/none", "--wait", "0"), "has no topic /none for --pose-topic"),
    ):
        assert main(["live", *arguments, "--out", str(tmp_path / "map"), "--viewer", "none"]) == 2
        told_lines = capsys.readouterr().err.splitlines()
        assert told in told_lines[-1]
        assert len(told_lines) <= 2
        assert not (tmp_path / "map").exists()
