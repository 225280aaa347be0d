import logging
import re
import threading
import pytest
from hickory_stream.box_scene import SceneSource
from hickory_stream.config import MapperConfig
from hickory_stream.errors import InputError, RecordingError
from hickory_stream.fleet.crew import run_crew
from hickory_stream.fleet.robot_process import RobotTask
from hickory_stream.fleet.robots import Robot
from hickory_stream.sinks.disk_sink import DiskSinkConfig
from players import SourceOptions, make_source_note, open_from_note, open_source
from players.doctor.diagnosis import UNUSABLE
from players.doctor.motion_agreement import MotionSampler, step_between
from players.doctor.motion_mends import check_motion, motion_warnings, watched
from players.live import open_live
from players.profile import mended_profile
from tests.cli.test_cli import look, said
from tests.players.test_motion_faults import DEPTH, ODOM, cut, stamped, unit

FEW = ("--set", "mapper.mapping.requests.max_failures=0")


@pytest.fixture
def logs(tmp_path):
    return [cut(tmp_path / "sound.mcap", seconds=3.0), cut(tmp_path / "far.mcap", unit(10), seconds=3.0)]


def test_a_batch_refuses_what_play_refuses(logs, tmp_path):
    told = look("batch", *logs, "-o", tmp_path / "out", "--workers", "1", *FEW).stdout
    assert "too far for the motion of the poses: it is in 0.1 mm" in " ".join(told.split())
    assert "--anyway" in told
    assert not (tmp_path / "out/maps/far.map").exists()
    assert (tmp_path / "out/maps/sound.map").exists()


def test_a_robot_of_a_fleet_is_refused_as_play_does(logs, tmp_path):
    task = RobotTask(
        robot=Robot(name="far", uris=(str(logs[1]),), options=SourceOptions()),
        out=tmp_path / "far.map", overwrite=False, resumes=False, mapper=MapperConfig(), disk=DiskSinkConfig(),
        every_keyframes=10, most_s=None, patience_s=1.0, debug=False,
    )  # fmt: skip
    ended = run_crew([task], 1, lambda name, message: None)["far"]
    assert not ended.is_finished
    assert "too far for the motion of the poses: it is in 0.1 mm" in ended.reason
    assert not (tmp_path / "far.map").exists()


def test_the_part_that_is_played_is_compared_once(logs, monkeypatch):
    note = make_source_note([logs[1]], SourceOptions(), start_s=0.5, first_frames=14)
    source = open_from_note(note)
    monkeypatch.setattr("players.source_note.open_source", None)
    with pytest.raises(InputError, match=r"depth_units_per_m = 10000 .*--anyway"):
        check_motion(source, note)
    (reason,) = check_motion(source, note, anyway=True)
    assert "too far" in reason
    assert len(list(source.frames())) == 14


@pytest.mark.parametrize(("change", "num_steps"), [(None, 8), (unit(10), 17)])
def test_a_sound_log_is_compared_as_far_as_certainty_needs(tmp_path, monkeypatch, change, num_steps):
    steps = []
    monkeypatch.setattr(
        "players.doctor.motion_agreement.step_between",
        lambda before, after: steps.append(step_between(before, after)) or steps[-1],
    )
    source = open_source(cut(tmp_path / "log.mcap", change or (lambda rows: None), seconds=3.0))
    assert motion_warnings(source)[1] == (change is not None)
    assert len(steps) == num_steps


def replayed(seconds):
    """Poses that a replay stamped and recorded later: their log times tell nothing."""

    def change(rows):
        stamped(seconds, "/tf", ODOM)(rows)
        for row in rows:
            row.log_ns += round(seconds * 1e9) * (row.topic in ("/tf", ODOM))

    return change


@pytest.mark.parametrize(
    ("change", "offset_ms"),
    [(stamped(-3.0, "/tf", ODOM), 3000), (stamped(9.0, "/tf", ODOM), -9000), (replayed(20.0), -20000)],
)
def test_poses_of_another_time_are_refused_with_their_offset(tmp_path, change, offset_ms):
    log, profile = cut(tmp_path / "log.mcap", change, 8.0), tmp_path / "mended.toml"
    with pytest.raises(RecordingError, match=r"no image has a pose.*pose_offset_ms = -?\d+ under \[time\]") as refused:
        open_source(log)
    assert float(re.search(r"pose_offset_ms = (-?\d+)", str(refused.value))[1]) == pytest.approx(offset_ms, abs=20)
    said("doctor", log, "--fix", profile, status=UNUSABLE)
    source = open_source(log, SourceOptions(profile=str(profile)))
    assert len(list(source.frames())) >= 47
    assert source.findings() == {}


@pytest.mark.parametrize("seconds", [-5.0, 7.0])
def test_depth_of_another_clock_is_refused_with_its_offset(tmp_path, seconds):
    log, profile = cut(tmp_path / "log.mcap", stamped(seconds, DEPTH), 4.0), tmp_path / "mended.toml"
    with pytest.raises(RecordingError, match=r"depth_offset_ms = -?\d+ under \[time\]") as refused:
        open_source(log)
    assert refused.value.fixes["time"]["depth_offset_ms"] == pytest.approx(-1e3 * seconds, abs=20)
    profile.write_text(mended_profile("", refused.value.fixes))
    assert len(list(open_source(log, SourceOptions(profile=str(profile))).frames())) == 24


@pytest.mark.parametrize(
    ("change", "text"), [(unit(10), "too far"), (stamped(0.3, "/tf", ODOM), "too late"), (None, "")]
)
def test_a_live_run_is_told_once_and_goes_on(tmp_path, caplog, change, text):
    log = cut(tmp_path / "log.mcap", change or (lambda rows: None), seconds=4.0)
    with caplog.at_level(logging.WARNING):
        source = open_live(f"mcap:{log}")
        frames = [raw.decode() for raw in source.frames()]
        source.close()
    assert len(frames) > 20
    told = [record.getMessage() for record in caplog.records if "put " in record.getMessage()]
    assert len(told) == bool(text)
    assert all(text in one for one in told)
    assert [one for one in source.account().findings if "put " in one] == told


def test_no_frame_of_a_live_run_waits_for_its_comparison(monkeypatch):
    all_came, compared = threading.Event(), []
    monkeypatch.setattr(MotionSampler, "add", lambda self, raw: compared.append(all_came.wait(5.0)))
    source = SceneSource(10)
    frames = watched(source, source.frames(), [])
    assert [next(frames).index for _ in range(10)] == list(range(10))
    all_came.set()
    frames.close()
    assert compared == [True] * 10
