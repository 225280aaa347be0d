import json
from hickory_stream.cli import main
from players.doctor.report import diagnosis_text
from players.live.examine import examine_live
from players.live.transport import Health
from players.options import SourceOptions
from tests.players.live.live_fixtures import ScriptedRoute, scene_packets


def test_what_would_be_mapped_is_said_with_the_table_of_topics():
    route = ScriptedRoute(at_start=scene_packets(12))
    found = examine_live(route.uri, SourceOptions(), seconds=1.0, route=route)
    assert found.refusal is None
    assert found.frames["frames"] == 12
    assert found.streams["pose"] == "/odom"
    text = diagnosis_text(found)
    assert "script://robot" in text
    assert "heard.mcap" not in text
    assert {topic["topic"]: topic["received"] for topic in found.live["topics"]} == route.sent


def test_why_nothing_would_be_mapped_is_said():
    packets = [packet for packet in scene_packets() if "depth" not in packet.topic.name]
    found = examine_live("script://robot", SourceOptions(), seconds=0.8, route=ScriptedRoute(at_start=packets))
    assert found.status == 2
    assert "script://robot has no depth topic" in str(found.refusal)
    away = ScriptedRoute(state=Health(is_connected=False, problem="robot:7447 does not answer"))
    found = examine_live(away.uri, SourceOptions(), seconds=0.3, route=away)
    assert found.refusal == "robot:7447 does not answer"
    silent = ScriptedRoute(announced=[packet.topic for packet in scene_packets()])
    found = examine_live(silent.uri, SourceOptions(), seconds=0.8, route=silent)
    assert found.refusal == "script://robot has sent nothing"


def test_the_command_examines_an_address(short_log, capsys):
    # The end of the stream ends the examination early.
    status = main(["doctor", str(short_log), "--json"])
    logged = json.loads(capsys.readouterr().out)
    assert main(["doctor", f"mcap:{short_log}", "--json"]) == status
    heard = json.loads(capsys.readouterr().out)
    assert heard["frames"]["keyframes"] == logged["frames"]["keyframes"]
    assert heard["problems"] == logged["problems"]
    assert heard["notes"] == ["the stream has ended"]
    assert main(["doctor", f"mcap:{short_log}"]) == status
    assert "/zed/zed_node/odom" in capsys.readouterr().out
    assert main(["doctor", "gopher://robot"]) == 2
    assert "expected one of zenoh://HOST" in capsys.readouterr().out
    assert main(["doctor", f"mcap:{short_log}", "--seconds", "0"]) == 2
