import subprocess
import sys
from pathlib import Path
import cv2
import numpy as np
import pytest
from hickory_stream.sinks.rerun.config import RerunConfig
from hickory_stream.sinks.rerun.sink import RerunSink, parse_viewer
from tests.sinks.report_fixtures import reports

LOOK = Path(__file__).resolve().parents[2] / "tools" / "look"


def look(*arguments):
    return subprocess.run([sys.executable, LOOK, *arguments], capture_output=True, text=True, check=False)


def test_the_default_arrangement_is_drawn_without_complaint(tmp_path):
    sink = RerunSink(RerunConfig(), tmp_path, tmp_path / "run.rrd", parse_viewer("none"))
    for report in reports(17, tmp_path):
        sink.show(report)
    sink.close()
    done = look(tmp_path / "run.rrd", "-o", tmp_path / "picture.png", "--size", "800x600")
    if done.returncode == 2 and "Vulkan" in done.stderr:
        pytest.skip(done.stderr)
    assert done.returncode == 0, done.stderr
    assert " 0 complaints" in done.stdout
    picture = cv2.imread(str(tmp_path / "picture.png"))
    assert picture.shape == (600, 800, 3)
    colorful = np.ptp(picture.astype(int), axis=2) > 60
    assert colorful.mean() > 0.01


def test_a_file_that_is_not_there_is_named(tmp_path):
    done = look(tmp_path / "none.rrd", "-o", tmp_path / "picture.png")
    assert done.returncode == 2
    assert "none.rrd" in done.stderr


def test_a_size_that_is_none_is_refused(tmp_path):
    (tmp_path / "a.rrd").touch()
    done = look(tmp_path / "a.rrd", "-o", tmp_path / "picture.png", "--size", "big")
    assert done.returncode == 2
    assert "1600x900" in done.stderr
