"""`hickory-stream demo`: from nothing to a map and its pictures."""

import json
from pathlib import Path

import cv2
import pytest

from hickory_stream.cli import main
from hickory_stream.engine.saved_map import open_map


@pytest.mark.timeout(600)
def test_a_demo_makes_a_log_its_map_and_its_pictures_and_replaces_only_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "demo"
    assert main(["demo", "--out", str(folder), "--seconds", "2", "--json"]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["map"] == str(folder / "map")
    saved = open_map(folder / "map")
    assert saved.manifest.finished_cleanly
    assert sum(tracked.shape is not None for tracked in saved.snapshot.objects) >= 5
    for path in told["pictures"]:
        picture = cv2.imread(path)
        assert picture.shape == (800, 1600, 3)
        assert picture.std() > 10
    assert (folder / "room.truth" / "truth.json").is_file()

    own = folder / "notes.txt"
    own.write_text("mine")
    assert main(["demo", "--out", str(folder), "--seconds", "2"]) == 2
    assert "room.mcap is there; add --overwrite" in capsys.readouterr().err
    assert main(["demo", "--out", str(folder), "--overwrite", "--seconds", "0"]) == 2
    assert own.read_text() == "mine"
    assert not (folder / "map").exists()


def test_a_demo_that_cannot_be_written_says_where(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert main(["demo", "--out", str(tmp_path / "file" / "demo")]) == 2
    assert "cannot write into" in capsys.readouterr().err
