import json
import os
import signal
import subprocess
from subprocess import PIPE
from tests.cli.test_cli import COMMAND, answer, look, refusal

NO_SHAPES = ("--set", "mapper.mapping.requests.max_failures=0")


def test_a_stream_becomes_a_map_with_a_complete_ledger(short_log, coarse_config, tmp_path):
    out = tmp_path / "map"
    said = ("--config", coarse_config, "--viewer", "none", "--json", *NO_SHAPES)
    ended = look("live", f"mcap:{short_log}", "--out", out, "--record", tmp_path / "session.mcap", *said)
    finished = json.loads(ended.stdout.splitlines()[-1])
    # A loaded machine drops frames, and with few of them nothing is confirmed.
    assert ended.status == (0 if finished["objects"] else 3), ended.stderr
    messages = finished["ledger"]["messages"]
    assert messages["declared"] > 200
    assert messages["difference"] == 0
    assert json.loads((out / "manifest.json").read_text())["run"]["mode"] == "live"
    events = [json.loads(line) for line in ended.stderr.splitlines()]
    status = [event for event in events if event.get("event") == "status"][-1]
    assert {topic["role"] for topic in status["topics"]} == {"tf", "color", "depth", "color_info", "depth_info", "pose"}
    assert sum(topic["received"] for topic in status["topics"]) == messages["declared"]
    played = look("play", tmp_path / "session.mcap", "--out", tmp_path / "again", "--frames", 6, *said)
    again = json.loads(played.stdout.splitlines()[-1])
    assert again["is_reproducible"]
    assert again["ledger"]["messages"]["declared"] == messages["declared"]
    found = answer("diff", out, "--other", tmp_path / "again")
    assert len(found["both"]) + len(found["only_in_a"]) == finished["objects"]
    assert len(found["both"]) + len(found["only_in_b"]) == again["objects"]


def test_a_signal_ends_a_live_run_while_it_waits(short_log, coarse_config, tmp_path):
    pipe, out = tmp_path / "pipe", tmp_path / "map"
    os.mkfifo(pipe)
    live = ("live", f"mcap:{pipe}", "--out", out, "--config", coarse_config, "--viewer", "none")
    command = [*COMMAND, *live, *NO_SHAPES]
    # All but the footer: for the reader the robot is still there.
    with (
        subprocess.Popen([str(word) for word in command], stdout=PIPE, stderr=PIPE, text=True) as process,
        pipe.open("wb") as stream,
    ):
        stream.write(short_log.read_bytes()[:-100])
        stream.flush()
        assert any("mapping: frame" in line for line in process.stderr)
        process.send_signal(signal.SIGTERM)
        process.stderr.read()
        assert "stopped, and saved; a live run cannot be continued" in process.stdout.read()
        assert process.wait(60) == 130
    ledger = json.loads((out / "ledger.json").read_text())
    assert ledger["messages"]["difference"] == 0
    assert json.loads((out / "manifest.json").read_text())["finished_cleanly"] is False


def test_what_is_missing_and_what_cannot_be_is_said_in_one_line(short_log, tmp_path):
    uri, b2 = f"mcap:{short_log}", ("--publish-robot", "b2")
    for arguments, told in (
        (("zenith://robot",), "found zenith://robot, expected one of"),
        ((f"mcap:{tmp_path}/none",), "no such file or pipe"),
        ((uri, "--wait", "-1"), "found --wait -1, expected seconds, 0 or more"),
        ((uri, "--for", "0"), "found --for 0, expected seconds"),
        ((uri, "--publish"), "--publish-robot"),
        ((uri, "--publish", "--publish-robot", "tank"), "found no robot tank"),
        ((uri, "--publish-only", "map", *b2), "found --publish-only map, expected some of costmap,"),
        ((uri, "--publish", *b2), "cannot publish; --publish needs zenoh://, foxglove:// or dds://"),
        ((uri, "--pose-topic", "/none", "--wait", "0"), "has no topic /none for --pose-topic"),
    ):
        lines = refusal("live", *arguments, "--out", tmp_path / "map", "--viewer", "none").splitlines()
        assert told in lines[-1]
        assert len(lines) <= 2
        assert not (tmp_path / "map").exists()
