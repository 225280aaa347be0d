"""A batch goes on where it was left, survives what is killed, and says in one line what it cannot do.

Here a worker is a script that writes a folder instead of mapping; `test_batch_command.py` maps.
"""

import errno
import json
import os
import sys
from dataclasses import fields, replace
import pytest
from hickory_stream.batch import child, executors, one_log
from hickory_stream.batch.page import text_of, write_page
from hickory_stream.batch.run import BatchPlan, run_batch
from hickory_stream.batch.tasks import LogTask, names_of, software
from hickory_stream.config import MapperConfig
from hickory_stream.engine.play import Played
from hickory_stream.errors import ConfigError, InputError, MapFolderError
from hickory_stream.map_folder.layout import FolderLock
from hickory_stream.sinks.disk_sink import DiskSinkConfig
from players import SourceOptions

# Reads a task and answers; a log named "kill" kills its process the first time, "crash" always, "full" has no space.
WORKER = """
import json, os, pickle, signal, sys
class Plain:
    # Whatever a task holds of ours, without an import of it.
    def __init__(self, *_, **__): pass
    def __setstate__(self, state): self.state = state
class Unpickler(pickle.Unpickler):
    def find_class(self, module, name):
        is_ours = module.partition(".")[0] in ("hickory_stream", "players", "numpy")
        return Plain if is_ours else super().find_class(module, name)
task = Unpickler(sys.stdin.buffer).load()
for field, value in zip(FIELDS, task.state): setattr(task, field, value)
task.out.mkdir(exist_ok=True)
begun = task.out / "begun"
resumed = begun.exists()
begun.touch()
with (task.out.parent / "made.txt").open("a") as file:
    file.write(task.name + "\\n")
if task.name == "crash" or (task.name == "kill" and not resumed):
    os.kill(os.getpid(), signal.SIGKILL)
full = {"state": "disk full", "reason": "cannot write: the disk is full"}
done = {"state": "mapped", "digest": task.name * 3, "objects": len(task.cores), "resumed": resumed}
print(json.dumps({"name": task.name, **(full if task.name == "full" else done)}))
"""


@pytest.fixture(autouse=True)
def script(monkeypatch, tmp_path):
    path = tmp_path / "worker.py"
    path.write_text(WORKER.replace("FIELDS", repr([field.name for field in fields(LogTask)])))
    monkeypatch.setattr(child, "COMMAND", (sys.executable, str(path)))
    return path


@pytest.fixture
def planned(tmp_path):
    def plan(*names, workers=2):
        logs = [tmp_path / f"{name}.mcap" for name in names]
        for log in logs:
            if not log.exists():
                log.write_bytes(b"log")
        return BatchPlan(
            uris=tuple(map(str, logs)), options=SourceOptions(), out=tmp_path / "out", mapper=MapperConfig(),
            disk=DiskSinkConfig(), workers=workers,
        )  # fmt: skip

    return plan


def made(plan):
    return sorted((plan.out / "maps" / "made.txt").read_text().split())


def test_a_killed_process_restarts_and_a_dying_one_is_a_row(planned, tmp_path):
    plan = planned("a", "kill", "crash")
    result = run_batch(plan)
    _check_table(result, tmp_path)
    told = {row.name: row for row in result.rows}
    assert (told["a"].state, told["kill"].state, told["crash"].state) == ("mapped", "mapped", "failed")
    assert told["kill"].resumed
    assert not told["a"].resumed
    assert told["crash"].reason == "its process ended with signal SIGKILL, 3 times"
    assert not result.is_whole
    assert made(plan) == ["a", "crash", "crash", "crash", "kill", "kill"]
    assert told["a"].objects in (0, max(1, len(os.sched_getaffinity(0)) // 2))


def _check_table(result, tmp_path):
    text = text_of(result).splitlines()
    assert text[0].split()[:3] == ["log", "state", "objects"]
    assert [line.split()[:2] for line in text[1:3]] == [["a", "mapped"], ["kill", "gone"]]
    assert text[4] == "crash: its process ended with signal SIGKILL, 3 times"
    write_page(tmp_path / "page.html", result)
    page = (tmp_path / "page.html").read_text()
    assert "<h1>2 of 3 logs mapped</h1>" in page
    assert page.count("<tr class=") == 4


def test_mapped_logs_are_kept_and_new_ones_may_follow(planned):
    first = run_batch(planned("a", "b"))
    said = []
    again = run_batch(planned("a", "b", "c"), said.append)
    assert [row.was_there for row in again.rows] == [True, True, False]
    assert [row.digest for row in again.rows[:2]] == [row.digest for row in first.rows]
    assert made(planned("a", "b", "c")) == ["a", "b", "c"]
    assert said[0] == "2 of 3 logs were mapped before"


def test_the_same_command_goes_on_after_a_full_disk(planned):
    plan = planned("a", "full", "b", workers=1)
    result = run_batch(plan)
    assert result.stopped == "the disk is full: free space, then continue with the same command"
    assert [row.state for row in result.rows] == ["mapped", "disk full", "failed"]
    assert not result.is_whole
    assert run_batch(plan).rows[0].was_there


def test_a_second_batch_in_one_folder_is_refused(planned, tmp_path):
    plan = planned("a", "b")
    run_batch(plan)
    with pytest.raises(InputError, match="holds a batch whose log b is another one, or has changed"):
        run_batch(planned("a"))
    with pytest.raises(InputError, match="made with another configuration"):
        run_batch(replace(plan, options=SourceOptions(color_topic="/c")))
    (tmp_path / "b.mcap").write_bytes(b"another log")
    with pytest.raises(InputError, match="log b is another one, or has changed since"):
        run_batch(plan)
    lock = FolderLock(plan.out)
    try:
        with pytest.raises(MapFolderError, match=f"is being written by process {os.getpid()}"):
            run_batch(plan)
    finally:
        lock.release()
    (plan.out / "batch.json").unlink()
    with pytest.raises(MapFolderError, match="is there and holds no batch"):
        run_batch(plan)


def test_a_missing_log_is_refused_before_anything_is_made(planned):
    plan = planned("a")
    with pytest.raises(InputError, match=r"there is no log .*missing\.mcap"):
        run_batch(replace(plan, uris=(*plan.uris, "missing.mcap")))
    assert not plan.out.exists()


def test_logs_of_one_name_get_names_of_their_own():
    assert names_of(["r1/log.mcap", "r2/log.mcap", "r2/log-2.bag", "a b.mcap"]) == ("log", "log-2", "log-2-2", "a-b")


class FakeClient:
    def __init__(self, answer):
        self.answer = answer

    def run(self, _):
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer


@pytest.mark.parametrize(("answer", "said"), [
    ({}, "has no worker; start some with `dask worker tcp://s:1`"),
    ({"tcp://w:2": "hickory-stream 0.0.1"}, "the worker tcp://w:2 has hickory-stream 0.0.1, this machine hickory"),
    (ModuleNotFoundError("No module named 'hickory_stream'"), "cannot run hickory-stream .*No module named"),
])  # fmt: skip
def test_a_cluster_with_other_workers_is_refused(answer, said):
    with pytest.raises(ConfigError, match=said):
        executors._check_workers(FakeClient(answer), "tcp://s:1")
    executors._check_workers(FakeClient({"tcp://w:2": software()}), "tcp://s:1")


def task(tmp_path):
    return LogTask(
        name="a", note={"uris": [str(tmp_path / "a.mcap")]}, out=tmp_path / "a.map", mapper=MapperConfig(),
        disk=DiskSinkConfig(), software=software(),
    )  # fmt: skip


def test_a_worker_of_another_version_says_so_and_maps_nothing(tmp_path):
    outcome = one_log.outcome_of(replace(task(tmp_path), software="hickory-stream 9"))
    assert outcome.state == "failed"
    assert "the batch hickory-stream 9; install the same version" in outcome.reason
    assert not (tmp_path / "a.map").exists()


@pytest.mark.parametrize(("number", "state"), [(errno.ENOSPC, "disk full"), (errno.EACCES, "failed")])
def test_a_disk_that_fills_up_is_told_from_other_failures(tmp_path, monkeypatch, number, state):
    def refuse(*_, **__):
        try:
            raise OSError(number, os.strerror(number))
        except OSError as error:
            raise MapFolderError(f"cannot write {tmp_path}: {error.strerror}") from error

    monkeypatch.setattr(one_log, "_mapped", refuse)
    outcome = one_log.outcome_of(task(tmp_path))
    assert (outcome.state, outcome.reason) == (state, f"cannot write {tmp_path}: {os.strerror(number)}")


def test_a_damaged_log_is_a_row_that_says_so(tmp_path, monkeypatch):
    def mapped(task, **_):
        task.out.mkdir()
        damage = {"damaged_places": 1, "damage": ["a.mcap at byte 7: the file is cut off"]}
        (task.out / "ledger.json").write_text(json.dumps({"messages": damage, "frames": {"keyframes": 9}}))
        return Played(
            snapshot=None, finished_cleanly=True, was_stopped=False, is_reproducible=True, processor="", digest="d"
        )

    monkeypatch.setattr(one_log, "_mapped", mapped)
    outcome = one_log.outcome_of(task(tmp_path))
    assert (outcome.state, outcome.keyframes) == ("mapped", 9)
    assert "1 damaged place" in outcome.reason
    assert "a.mcap at byte 7" in outcome.reason
