"""What the command line shows of work that takes long."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from hickory_stream.cli.evaluate_views import planned_runs
from hickory_stream.engine.run import Progress
from hickory_stream.progress import ProgressPrinter

if TYPE_CHECKING:
    import pytest

PROGRESS = Progress(phase="mapping", frames=3, total=6, keyframes=2, objects=4, open_shapes=0)


def test_one_of_several_runs_says_which_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    ProgressPrinter("lines", part="2 of 5")(PROGRESS)
    assert capsys.readouterr().err.startswith("2 of 5, mapping: 50%")
    ProgressPrinter("json", part="2 of 5")(PROGRESS)
    assert json.loads(capsys.readouterr().err)["part"] == "2 of 5"
    ProgressPrinter("json")(PROGRESS)
    assert "part" not in json.loads(capsys.readouterr().err)


def test_evaluate_views_counts_its_runs() -> None:
    runs = list(planned_runs(("s_score", "box_2d"), ("a.mcap", "b.mcap")))
    assert runs == [
        ("1 of 4", "s_score", 0, "a.mcap"),
        ("2 of 4", "s_score", 1, "b.mcap"),
        ("3 of 4", "box_2d", 0, "a.mcap"),
        ("4 of 4", "box_2d", 1, "b.mcap"),
    ]
