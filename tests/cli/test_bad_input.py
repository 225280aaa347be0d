"""What is wrong outside ends with exit status 2 and one line that names what was found and what is needed.

The logs are of the players' synthetic scene; what each lacks was taken out of a log that plays.
"""

import os
import socket
from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.errors import CalibrationError
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.map_folder.writer import create_map_folder
from players.logs.containers import Topic
from players.logs.log_opening import choose_profile
from players.options import SourceOptions
from tests import player_scenes as scenes
from tests.cli.test_cli import look

pytestmark = pytest.mark.timeout(60)

M = scenes.Messages(ros=2)
FRAMES = scenes.make_scene(num_frames=3)
LOG = scenes.scene_messages(M, FRAMES, scenes.png_images)
BLIND = scenes.scene_messages(
    M, [replace(frame, depth_mm=np.zeros_like(frame.depth_mm)) for frame in FRAMES], scenes.png_images
)


def write(path, messages):
    return scenes.write_mcap(path, M, sorted(messages, key=lambda message: message.stamp_ns))


def without(*topics):
    return [message for message in LOG if message.topic not in topics]


@pytest.fixture
def log(tmp_path):
    return write(tmp_path / "desk.mcap", LOG)


def errors_of(ended):
    return [line for line in ended.stderr.splitlines() if line.startswith("hickory-stream: ")]


def refusal(ended, *told, status=2):
    """Check that something was refused as it has to be, and return the one line."""
    assert ended.status == status, ended.stderr
    assert ended.stdout == ""
    (error,) = errors_of(ended)
    assert ended.stderr.splitlines()[-1] == error
    assert "Traceback" not in ended.stderr
    assert all(text in error for text in told), error
    return error


# How a bad log is written, and what its refusal has to say; `tests/players` has what else a log may lack.
BAD_LOGS = {
    "not_there": (lambda path: None, ("no such file", "log.mcap")),
    "empty": (lambda path: path.write_bytes(b""), ("is empty", "expected an MCAP file")),
    "no_log": (lambda path: path.write_text("to do: buy milk"), ("no known kind", "expected an MCAP file")),
    "torn": (lambda path: path.write_bytes(write(path, LOG).read_bytes()[:300]), ("log.mcap",)),
    "empty_folder": (lambda path: path.mkdir(), ("found nothing", "expected an MCAP file")),
    "no_depth": (lambda p: write(p, without(scenes.PNG_DEPTH)), ("no depth topic", scenes.PNG_COLOR, "--depth-topic")),
    "no_returns": (lambda path: write(path, BLIND), ("no depth in any of", "keyframes")),
}


@pytest.mark.parametrize("name", sorted(BAD_LOGS))
def test_an_unmappable_log_is_refused_and_leaves_no_map(tmp_path, name):
    make, told = BAD_LOGS[name]
    make(tmp_path / "log.mcap")
    # A log that was read to its end, and gave nothing, is no bad input.
    status = 3 if name == "no_returns" else 2
    refusal(look("play", tmp_path / "log.mcap", "--out", tmp_path / "map", "--viewer", "none"), *told, status=status)
    assert not (tmp_path / "map").exists()


def test_a_log_without_poses_is_refused_if_they_must_be_its_own(tmp_path):
    log = write(tmp_path / "log.mcap", without("/odom", "/tf", "/tf_static"))
    refused = look("play", log, "--odometry", "topic", "--out", tmp_path / "map", "--viewer", "none")
    refusal(refused, "no poses", "Odometry", "--odometry depth")
    assert not (tmp_path / "map").exists()


def test_a_file_that_may_not_be_read_is_refused(log, tmp_path):
    if os.geteuid() == 0:
        pytest.skip("root may read everything")
    log.chmod(0)
    refusal(look("play", log, "--out", tmp_path / "map"), "desk.mcap", "Permission denied")


def contents(folder):
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def test_places_that_hold_a_map_or_cannot_be_written_are_refused(log, tmp_path):
    create_map_folder(tmp_path / "map", config={}, source={})
    before = contents(tmp_path / "map")
    refusal(look("play", log, "--out", tmp_path / "map"), "holds a map already", "--out", "--overwrite")
    assert contents(tmp_path / "map") == before
    place = log / "run.rrd"
    refusal(look("play", log, "--out", tmp_path / "none", "--viewer", "none", "--rrd", place), "run.rrd")
    assert not (tmp_path / "none").exists()
    refusal(look("render", tmp_path / "map", "-o", log / "map.png"), "map.png")


@pytest.mark.parametrize("command", ["inspect", "render"])
@pytest.mark.parametrize("place", ["absent", "empty", "log", "damaged"])
def test_what_is_no_map_is_refused_by_those_who_read_maps(log, tmp_path, command, place):
    (tmp_path / "empty").mkdir()
    create_map_folder(tmp_path / "damaged", config={}, source={})
    (tmp_path / "damaged/objects.json").write_text("{")
    refusal(look(command, log if place == "log" else tmp_path / place))


@pytest.mark.parametrize(("options", "told"), [
    (["--rate", "fast"], ("found --rate fast", "max or a number above 0")),
    (["--rate", "0"], ("found --rate 0", "max or a number above 0")),
    (["--rate", "-1"], ("found --rate -1",)),
    (["--rate", "nan"], ("found --rate nan",)),
    (["--rate", "inf"], ("found --rate inf",)),
    (["--loop", "0"], ("found --loop 0", "at least 1")),
    (["--frames", "0"], ("found --frames 0", "at least 1")),
    (["--workers", "0"], ("found --workers 0", "at least 1")),
    (["--sync-tolerance", "-5"], ("found --sync-tolerance -5", "milliseconds")),
    (["--viewer", "tv"], ("'tv'", "auto, none, spawn, web")),
    (["--viewer", "connect=http://here"], ("http://here", "rerun+http://HOST:PORT/proxy")),
    (["--viewer", "connect=nobody.invalid"], ("no host 'nobody.invalid'", "connect=rerun+http://127.0.0.1:9876")),
    (["--robot", "foo"], ("found --robot foo", "knows no robots", "kimera_multi")),
    (["--metrics-port", "99999"], ("found --metrics-port 99999", "1 to 65535")),
    (["--metrics-port", "-1"], ("found --metrics-port -1",)),
    (["--start", "100"], ("found --start 100", "the log is only 0.2 s long")),
    (["--depth-topic", "/nose"], ("/nose", "--depth-topic", scenes.PNG_DEPTH)),
    (["--set", "mapper.keyframes.min_intervall_s=1"], ("did you mean mapper.keyframes.min_interval_s?",)),
    (["--set", "mapper.run.workers=two"], ("mapper.run.workers is 'two'", "expected int")),
    (["--set", "mapper.run.workers=0"], ("mapper.run.workers is 0; expected 1 to 1024 processes",)),
    (["--set", "mapper.mapping.views.strategy=best"], ("'best'", "'s_score'")),
    (["--config", "none.toml"], ("none.toml", "No such file")),
])  # fmt: skip
def test_a_bad_option_is_refused_before_anything_is_written(log, tmp_path, options, told):
    refusal(look("play", log, "--out", tmp_path / "map", *options), *told)
    assert not (tmp_path / "map").exists()


def test_a_taken_metrics_port_is_refused_and_the_map_stays(log, tmp_path):
    create_map_folder(tmp_path / "map", config={}, source={"uri": "of before"}).close()
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        options = ("--overwrite", "--metrics-port", port)
        ended = look("play", log, "--out", tmp_path / "map", "--viewer", "none", *options)
    refusal(ended, f"127.0.0.1:{port}", "choose another --metrics-port")
    assert open_map(tmp_path / "map").manifest.source == {"uri": "of before"}


def test_a_robot_not_in_the_log_is_refused_with_those_in_it():
    image = {"type_name": "sensor_msgs/msg/Image", "num_messages": None, "wire": "ros1", "definition": ""}
    names = ("color/image_raw", "color/camera_info", "depth/image_rect_raw")
    topics = [Topic(name=f"/hathor/forward/{name}", definition_format="none", **image) for name in names]
    with pytest.raises(CalibrationError, match="no topics; robots in it: hathor"):
        choose_profile(topics, SourceOptions(robot="thoth"))
    profile, is_guessed = choose_profile(topics, SourceOptions(robot="hathor"))
    assert (profile.name, is_guessed) == ("kimera_multi", True)


@pytest.mark.parametrize(("option", "expected", "values"), [
    ("--layers", "1,2,3,4", ["5", "0,1", "", "one", "1,x", "1.5"]),
    ("--size", "WIDTHxHEIGHT", ["big", "10x10", "479x240", "1600", "99999x100", "-1x100"]),
])  # fmt: skip
def test_layers_and_sizes_that_there_are_not_are_refused(tmp_path, option, expected, values):
    create_map_folder(tmp_path / "map", config={}, source={})
    for value in values:
        refusal(look("render", tmp_path / "map", f"{option}={value}"), f"found {option} {value}", expected)


@pytest.mark.parametrize(("text", "told"), [
    ("[mapper.run]\nworker = 1", "did you mean mapper.run.workers?"),
    ('[mapper.run]\nworkers = "two"', "expected int"),
    ("[mapper", "is not TOML"),
])  # fmt: skip
def test_a_bad_configuration_is_refused_by_its_check_and_by_play(log, tmp_path, text, told):
    (tmp_path / "robot.toml").write_text(text)
    checked = refusal(look("config", "check", tmp_path / "robot.toml"), told)
    played = refusal(look("play", log, "--out", tmp_path / "map", "--config", tmp_path / "robot.toml"), told)
    assert checked == played
    assert not (tmp_path / "map").exists()


@pytest.mark.parametrize(
    "command", ["play no.mcap", "inspect no", "render no", "config dump --set a=1", "config check no.toml"]
)
def test_with_json_the_refusal_is_one_json_object(command):
    ended = look(*command.split(), "--json")
    told = ended.json()
    assert (ended.status, told["event"]) == (2, "error")
    assert errors_of(ended) == [f"hickory-stream: {told['message']}"]


def test_a_map_larger_than_memory_is_said_to_be(tmp_path, monkeypatch):
    def too_large(*_):
        raise MemoryError("Unable to allocate 446. GiB")

    monkeypatch.setattr("hickory_stream.cli.maps.inspect.run", too_large)
    assert refusal(look("inspect", tmp_path)) == (
        "hickory-stream: found too little memory: Unable to allocate 446. GiB; use a machine with more, or a "
        "smaller map or log"
    )


def test_our_own_failure_exits_with_1_and_one_line(log, tmp_path, monkeypatch):
    def broken(*_):
        raise ZeroDivisionError("somewhere\nin the segmenter")

    monkeypatch.setattr("hickory_stream.perception.network_segmenter.NetworkSegmenter.segment", broken)
    command = ("play", log, "--out", tmp_path / "map", "--viewer", "none")
    assert refusal(look(*command), status=1) == (
        "hickory-stream: internal failure, ZeroDivisionError: somewhere in the segmenter; run with --debug to see where"
    )
    assert not open_map(tmp_path / "map").manifest.finished_cleanly
    debugged = look(*command, "--overwrite", "--debug")
    assert debugged.status == 1
    assert "Traceback" in debugged.stderr


@pytest.mark.parametrize("kind", ["config", "robot", "profile"])
@pytest.mark.parametrize("value", ["1" + "0" * 400, "1" + "0" * 5000, "[" * 5000, "1e999", "{}", "[[]]"])
def test_a_bad_number_is_refused_in_one_line(log, tmp_path, kind, value):
    file, made = tmp_path / f"{kind}.toml", tmp_path / "map"
    key, command = {
        "config": ("[mapper.run]\ngrace_s", ("config", "check", file)),
        "robot": (
            "[[posture]]\nname = 'up'\nlow_m = 0.0\nhigh_m",
            ("plan", made, "--start", "0,0", "--goal", "1,1", "--robot", file),
        ),
        "profile": ("depth_units_per_m", ("play", log, "--profile", file, "--out", tmp_path / "out")),
    }[kind]
    file.write_text(f"{key} = {value}\n")
    create_map_folder(made, config={}, source={}).close()
    refusal(look(*command))
