import json
from dataclasses import replace
import pytest
from hickory_stream.cli import CompileNotice
from hickory_stream.engine.modes import Progress
from hickory_stream.progress import ProgressPrinter

AT_START = Progress(phase="mapping", frames=0, total=1000, keyframes=0, objects=0, open_shapes=0)
PROGRESS = Progress(phase="mapping", frames=3, total=6, keyframes=2, objects=4, open_shapes=0)


def test_one_of_several_runs_says_which_it_is(capsys):
    ProgressPrinter("lines", part="2 of 5")(PROGRESS)
    assert capsys.readouterr().err.startswith("2 of 5, mapping: 50%")
    for named in ({"part": "2 of 5"}, {}):
        ProgressPrinter("json", **named)(PROGRESS)
        assert json.loads(capsys.readouterr().err).get("part") == named.get("part")


class Clock:
    """A clock that is set by hand."""

    now_s = 100.0

    def __call__(self):
        return self.now_s


def test_no_time_is_given_before_it_means_something(capsys):
    clock = Clock()
    printer = ProgressPrinter("lines", clock=clock)
    printer(AT_START)
    clock.now_s += 60.0  # the first frame loads what later ones have
    printer(replace(AT_START, frames=1))
    clock.now_s += 5.0
    printer(replace(AT_START, frames=4))
    assert "left" not in capsys.readouterr().err


def test_the_time_that_is_left_is_told_by_the_speed_of_late(capsys):
    clock = Clock()
    printer = ProgressPrinter("lines", clock=clock)
    for frames in range(1, 10):  # a slow start: one frame in 10 s
        clock.now_s += 10.0
        printer(replace(AT_START, frames=frames))
    for frames in range(10, 410):
        clock.now_s += 0.05
        printer(replace(AT_START, frames=frames))
    clock.now_s += 5.0
    last = capsys.readouterr().err.splitlines()[-1]
    # 20 frames a second, and fewer than 600 to come.
    assert "20/s" in last
    assert 25 <= float(last.split(" s left")[0].split()[-1]) <= 40


def test_nothing_is_left_when_all_frames_are_mapped(capsys):
    clock = Clock()
    printer = ProgressPrinter("lines", clock=clock)
    for frames in range(1001):
        clock.now_s += 0.1
        printer(replace(AT_START, frames=frames))
    clock.now_s += 6.0
    printer(replace(AT_START, phase="shapes", frames=1000, open_shapes=7))
    last = capsys.readouterr().err.splitlines()[-1]
    assert "left" not in last
    assert "7 shapes to come" in last


@pytest.mark.parametrize("style", ["lines", "bar"])
def test_compiling_is_told_with_what_is_done(capsys, style):
    clock = Clock()
    printer = ProgressPrinter(style, clock=clock)
    compiling = replace(AT_START, phase="compiling", num_kernels=140)
    printer(compiling)
    clock.now_s += 35.0
    printer(replace(compiling, num_compiled=70))
    told = capsys.readouterr().err
    assert "compiling kernels" in told
    assert "70 of about 140, 35 s so far" in told
    assert "left" not in told
    ProgressPrinter("json")(replace(compiling, num_compiled=3))
    told = json.loads(capsys.readouterr().err)
    assert (told["phase"], told["num_compiled"], told["num_kernels"]) == ("compiling", 3, 140)


def test_a_command_speaks_of_kernels_only_when_they_take_long(capsys):
    clock = Clock()
    notice = CompileNotice(as_json=False, clock=clock)
    for kernel in ("a", "b", "c"):  # one now and then is not worth a word
        notice(kernel)
        clock.now_s += 20.0
    assert capsys.readouterr().err == ""
    notice("d")
    notice("e")
    clock.now_s += 1.0
    notice("f")
    clock.now_s += 4.0
    notice("g")
    assert capsys.readouterr().err.splitlines() == [
        "compiling kernels, once after an installation or update: 4 so far, 60 s",
        "compiling kernels, once after an installation or update: 6 so far, 65 s",
    ]
