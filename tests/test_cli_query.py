"""Questions from the command line, and a way to what answers, on a map of a table with a box on it."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from hickory_stream.cli import main
from hickory_stream.engine.map_folder import create_map_folder
from tests.engine.snapshot_fixtures import make_snapshot
from tests.navigation.rooms import table, tracked
from tests.test_cli_navigation import CRATE, saved

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = create_map_folder(tmp_path_factory.mktemp("query") / "map", config={}, source={}, overwrite=False)
    made.save(make_snapshot(made))
    made.finish(finished_cleanly=True)
    return made.path


def test_query_prints_what_answers_and_draws_it(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["query", str(folder), "a blue", "box", "--json", "-o", str(tmp_path / "a.png")]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [answer["goal"] for answer in told["answers"]] == ["object:4"]
    assert told["answers"][0]["why"] == {"blue": 1.0, "box": 1.0}
    picture = cv2.imread(str(tmp_path / "a.png")).astype(int)
    assert picture.shape[1] == 1600
    # What does not answer has no colour left: the table was brown.
    is_brown, is_blue = (np.abs(picture[80:836] - bgr).max(axis=2) < 40 for bgr in ((70, 110, 150), (180, 90, 60)))
    assert is_brown.sum() < 200 < is_blue.sum()
    assert main(["query", str(folder), "how many things"]) == 0
    assert capsys.readouterr().out == "any object: 2 (#1, #4)\n"


def test_query_that_nothing_answers_says_so_and_one_that_is_none_is_refused(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["query", str(folder), "a green box"]) == 3
    assert "nothing in the map answers\n  nearly" not in capsys.readouterr().out
    assert main(["query", str(folder), "how many green boxes"]) == 0
    for words, complaint in (
        (["a", "window"], '"window"'),
        (["box", "--top", "0"], "--top 0"),
        (["a", "--from", "x"], "X,Y"),
    ):
        assert main(["query", str(folder), *words]) == 2
        assert complaint in capsys.readouterr().err


def test_plan_leads_to_a_place_beside_an_object(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    room = saved(tmp_path / "room.map", tracked(1, table()), tracked(2, CRATE))
    command = ["plan", str(room), "--start", "0.7,0.6", "--robot", "point", "--json"]
    assert main([*command, "--goal", "object:2"]) == 0
    x, y = json.loads(capsys.readouterr().out)["points"][-1]
    # The crate reaches from 4.1 to 4.9 m and from 0.7 to 1.3 m, and its layer 4 ends there.
    beside = np.hypot(max(4.1 - x, 0, x - 4.9), max(0.7 - y, 0, y - 1.3))
    assert 0 < beside < 0.3
    assert main([*command, "--goal", "object:1", "--start", "1.5,2.0"]) in (0, 3)
    capsys.readouterr()
    for goal, complaint in (("object:9", "has no object 9"), ("object:x", "expected X,Y in metres, or object:ID")):
        assert main([*command, "--goal", goal]) == 2
        assert complaint in capsys.readouterr().err
