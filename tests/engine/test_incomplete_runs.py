import io
import json
import resource
import sys
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
import pytest
from hickory_stream.base.atomic_files import write_output
from hickory_stream.cli import main
from hickory_stream.cli.runs.summary import failures_line
from hickory_stream.engine.shape_jobs.job_folder import FailedShapes, failed_shapes
from hickory_stream.errors import OutputError
from hickory_stream.sinks.rerun.file import RrdFile
from hickory_stream.sinks.rerun.items import LogItem, Moment, new_stream
from hickory_stream.sinks.rerun.piped_file import recorded_to
from tests.shape_jobs.bad_worker import write_interpreter

FULL = Path("/dev/full")  # every write there fails as on a full disk
OLD = b"what was there before"

needs_full_device = pytest.mark.skipif(not FULL.exists(), reason="needs /dev/full")


@contextmanager
def files_of_at_most(num_bytes):
    """Have every file end there, as it would on a disk that fills up."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    # Python would keep the cut bytecode of a module, and fail to load it in later runs.
    writes_no_bytecode, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    resource.setrlimit(resource.RLIMIT_FSIZE, (num_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        sys.dont_write_bytecode = writes_no_bytecode


@dataclass(frozen=True)
class Ended:
    status: int
    folder: Path
    said: dict[str, Any]
    stderr: str


@pytest.fixture(scope="module")
def failed(demo_log, coarse_config, tmp_path_factory):
    """A log that was cut off, played with workers whose every job fails and with a recording on a full disk."""
    folder = tmp_path_factory.mktemp("failed")
    content = demo_log.read_bytes()
    (folder / "cut.mcap").write_bytes(content[: len(content) // 3])
    python = write_interpreter(folder / "python", "raises")
    arguments = ["play", folder / "cut.mcap", "--config", coarse_config, "--viewer", "none", "--json", "--frames", 10]
    arguments += ["--out", folder / "map", "--set", f"mapper.run.worker_python={python}", "--workers", 1]
    if FULL.exists():
        arguments += ["--rrd", FULL]
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        status = main([str(argument) for argument in arguments])
    return Ended(status, folder / "map", json.loads(out.getvalue().splitlines()[-1]), err.getvalue())


def test_a_run_with_only_failed_jobs_says_why_and_exits_with_3(failed):
    assert failed.status == 3
    assert failed.said["objects"] > 2
    assert failed.said["objects_with_shape"] == 0
    (group,) = failed.said["failed_shapes"]
    assert group["reason"] == "RuntimeError: out of ideas"
    assert len(group["objects"]) >= 2
    for object_id, folder in zip(group["objects"], group["inputs"], strict=True):
        assert Path(folder) == failed.folder / "failed" / f"{object_id:06d}"
        assert (Path(folder) / "job.json").is_file()


def test_the_inputs_of_failed_jobs_can_be_repeated(failed, capsys):
    assert main(["reconstruct", failed.said["failed_shapes"][0]["inputs"][0], "--json"]) in (0, 3)
    assert json.loads(capsys.readouterr().out)


def test_damage_of_the_log_is_told_and_kept_in_the_ledger(failed):
    assert "cut.mcap at byte" in failed.said["damage"]
    messages = json.loads((failed.folder / "ledger.json").read_text())["messages"]
    assert messages["damaged_places"] >= 1
    assert messages["damage"][0] in failed.said["damage"]


@needs_full_device
def test_a_recording_that_the_disk_cut_short_is_told_in_one_line(failed):
    (lost,) = failed.said["lost_outputs"]
    assert "/dev/full could not be written to its end (No space left on device)" in lost
    assert FULL.exists()
    # Progress is JSON; our own warning goes through logging. Nothing else is said.
    assert all(json.loads(line)["event"] for line in failed.stderr.splitlines())


def test_reasons_are_grouped_and_objects_counted():
    rare = FailedShapes(reason="torn", object_ids=(7,), folders=(Path("m/failed/000007"),))
    often = replace(rare, reason="slow", object_ids=tuple(range(8)), folders=(Path("m/failed/000000"),) * 8)
    assert failures_line((often, rare), 12) == (
        "the shape jobs of 9 of 12 objects failed: 8 x slow (objects 0, 1, 2, 3, 4 and 3 more); 1 x torn (object 7). "
        "Their input lies in m/failed; repeat one with `hickory-stream reconstruct m/failed/000000`"
    )
    assert failures_line((), 12) == ""


def test_a_reason_that_cannot_be_read_is_unknown(tmp_path):
    for object_id, text in ((1, '{"reason": "slow"}'), (2, "no json"), (3, '{"reason": ["slow"]}'), (4, None)):
        folder = tmp_path / "failed" / f"{object_id:06d}"
        folder.mkdir(parents=True)
        if text is not None:
            (folder / "failure.json").write_text(text)
    found = failed_shapes(tmp_path, [1, 2, 3, 4, 5])
    assert [(group.reason, group.object_ids) for group in found] == [("no reason was kept", (2, 3, 4)), ("slow", (1,))]


@pytest.mark.parametrize(("ending", "arguments"), [
    ("json", ("export", "{map}", "--out", "{out}")), ("ply", ("export", "{map}", "--out", "{out}")),
    ("png", ("render", "{map}", "--layers", "1", "--size", "480x240", "-o", "{out}")),
    ("html", ("doctor", "{log}", "--html", "{out}")),
])  # fmt: skip
def test_a_full_disk_leaves_the_file_that_was_there(failed, ending, arguments, tmp_path, capsys):
    out = tmp_path / f"out.{ending}"
    out.write_bytes(OLD)
    places = {"map": failed.folder, "out": out, "log": failed.folder.parent / "cut.mcap"}
    with files_of_at_most(1000):
        assert main([*(argument.format(**places) for argument in arguments), "--overwrite"]) == 2
    assert "File too large" in capsys.readouterr().err
    assert out.read_bytes() == OLD
    assert list(tmp_path.iterdir()) == [out]


def test_a_recording_that_the_disk_cut_short_is_removed(tmp_path):
    import rerun as rr

    recording = RrdFile(tmp_path / "run.rrd", recording_id="cut", cap_mb=100.0)
    item = LogItem(path="points", archetypes=(rr.Points3D([[float(i), 0.0, 0.0] for i in range(10_000)]),))
    with files_of_at_most(10_000):
        recording.write(Moment(frame=0, stamp_ns=0, keyframe=0), [item])
        with pytest.raises(OutputError, match=r"File too large.* and was removed; `hickory-stream replay"):
            recording.close()
    recording.close()
    assert list(tmp_path.iterdir()) == []


def test_a_recording_is_written_whole_or_not_at_all(tmp_path):
    import rerun as rr

    out = tmp_path / "plan.rrd"
    out.write_bytes(OLD)
    points = rr.Points3D([[float(i), 0.0, 0.0] for i in range(10_000)])
    stream = new_stream("cut")
    with pytest.raises(OSError, match=r"File too large"), files_of_at_most(10_000), recorded_to(out, stream):
        stream.log("points", points)
    assert out.read_bytes() == OLD
    assert list(tmp_path.iterdir()) == [out]
    stream = new_stream("whole")
    with recorded_to(out, stream):
        stream.log("points", points)
    assert out.stat().st_size > 10_000
    assert out.read_bytes()[-12:-4] == b"RRF2FOOT"  # the end of a recording that is complete


def test_a_link_goes_on_pointing_to_its_file(tmp_path):
    (tmp_path / "far").mkdir()
    (tmp_path / "far" / "file").write_bytes(OLD)
    (tmp_path / "link").symlink_to(tmp_path / "far" / "file")
    write_output(tmp_path / "link", b"new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "far" / "file").read_bytes() == b"new"


@needs_full_device
def test_what_is_no_file_is_written_as_it_is():
    write_output(Path("/dev/null"), b"new")
    assert Path("/dev/null").is_char_device()
    with pytest.raises(OSError, match="No space left"):
        write_output(FULL, b"new")
    assert FULL.is_char_device()
