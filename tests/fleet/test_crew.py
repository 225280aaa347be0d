import os
import signal
from collections import defaultdict
from types import SimpleNamespace
import pytest
from hickory_stream.fleet.crew import run_crew
from hickory_stream.fleet.messages import Ended, Opened
from tests.fleet import crew_robots


def task(name):
    """Return what the processes of `crew_robots` know of a task; the configuration of one takes a second to load."""
    return SimpleNamespace(robot=SimpleNamespace(name=name))


def test_a_robot_whose_process_dies_is_missing_with_the_reason():
    names, heard = ["killed", "good", "silent", "also-good"], defaultdict(list)
    tasks = [task(name) for name in names]
    ended = run_crew(tasks, 2, lambda name, message: heard[name].append(message), crew_robots.main)
    assert set(ended) == set(names)
    assert ended["killed"] == Ended(is_finished=False, reason="its process was killed by SIGKILL")
    assert ended["silent"].reason == "its process ended with status 7 and without a word"
    assert [ended[name].digest for name in ("good", "also-good")] == ["good", "also-good"]
    for name in ("good", "killed"):
        assert [type(message) for message in heard[name]] == [Opened, Ended]


def test_with_one_process_the_robots_are_mapped_in_their_order():
    order, tasks = [], [task(name) for name in "ba"]
    run_crew(tasks, 1, lambda name, message: order.append((name, type(message))), crew_robots.main)
    assert order == [(name, kind) for name in "ba" for kind in (Opened, Ended)]


# By one process, all that still wait end at once when the only robot has ended.
@pytest.mark.parametrize("begun", [["endless-1"], ["endless-1", "endless-2"]])
def test_a_signal_stops_all_robots_in_order_and_begins_no_more(begun):
    opened = []

    def hear(name, message):
        if isinstance(message, Opened):
            opened.append(name)
            if len(opened) == len(begun):
                os.kill(os.getpid(), signal.SIGINT)

    ended = run_crew([*map(task, begun), task("waiting")], len(begun), hear, crew_robots.main)
    assert sorted(opened) == begun
    assert all(one.was_stopped and not one.is_finished for one in ended.values())
    assert ended["endless-1"].digest == "endless-1"
    assert ended["waiting"].reason == "stopped before it began"


def test_a_signal_reaches_a_robot_that_does_not_listen_yet():
    def hear(name, message):
        if name == "endless" and isinstance(message, Opened):
            os.kill(os.getpid(), signal.SIGINT)

    ended = run_crew([task("endless"), task("late-endless")], 2, hear, crew_robots.main)
    stopped = {name: (one.was_stopped, one.digest) for name, one in ended.items()}
    assert stopped == {"endless": (True, "endless"), "late-endless": (True, "late-endless")}


def test_a_second_signal_ends_them_at_once():
    def hear(name, message):
        os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGTERM)

    with pytest.raises(KeyboardInterrupt):
        run_crew([task("endless")], 1, hear, crew_robots.main)


def test_a_failure_of_whoever_listens_leaves_no_process_behind():
    def hear(name, message):
        raise ValueError("no")

    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(ValueError, match="no"):
        run_crew([task("endless")], 1, hear, crew_robots.main)
    assert signal.getsignal(signal.SIGINT) is before
