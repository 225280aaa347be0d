from pathlib import Path
import pytest
from mcap.writer import CompressionType, IndexType
from players import SourceOptions
from players.doctor import stream_stats
from players.doctor.diagnosis import SOUND, examine
from players.logs import log_parts
from players.opening import open_container
from tests import player_scenes as scenes

DEMO = Path(__file__).parents[3] / "recordings" / "demo.mcap"
SECOND = 1_000_000_000
M = scenes.Messages(ros=2)


def messages(ros):
    """Return two minutes of images at 5 Hz, each after a pose, and a link that is published once between two parts."""
    m = scenes.Messages(ros=ros)
    found = [scenes.Message(topic="/tf_static", stamp_ns=36 * SECOND, message=m.tf(36 * SECOND))]
    for i in range(600):
        ns = SECOND + i * SECOND // 5
        pose, image = m.odometry(ns, "odom", "base", scenes.pose_at(0)), m.compressed(ns, "cam", "jpeg", b"x" * 99)
        found += [scenes.Message(topic="/odom", stamp_ns=ns, message=pose)]
        found += [scenes.Message(topic="/image", stamp_ns=ns + 1, message=image)]
    return sorted(found, key=lambda message: message.stamp_ns)


@pytest.fixture
def _is_long(monkeypatch):
    monkeypatch.setattr(log_parts, "_WHOLE_MESSAGES", 100)


def written(folder, kind):
    if kind == "ros1":
        return scenes.write_ros1(folder / "log.bag", scenes.Messages(ros=1), messages(1))
    if kind == "sqlite3":
        return scenes.write_ros2(folder / "bag", M, messages(2))
    settings = {"loose": {"use_chunking": False}, "unindexed": {"index_types": IndexType.NONE}}.get(kind, {})
    settings |= {"chunk_size": 4000, "compression": CompressionType.NONE}
    return scenes.write_mcap(folder / "log.mcap", M, messages(2), **settings)


@pytest.mark.usefixtures("_is_long")
@pytest.mark.parametrize("kind", ["mcap", "loose", "unindexed", "ros1", "sqlite3"])
def test_the_messages_of_the_parts_are_read_in_order(tmp_path, kind):
    log = open_container(written(tmp_path, kind))
    names = {"/image", "/odom", "/tf_static"}
    whole = [(message.topic, message.log_ns) for message in log.messages(names)]
    log_parts.divide(log)
    parts = log_parts.parts_of(log)
    read = [(message.topic, message.log_ns) for message in log.messages(names)]
    assert read == [message for message in whole if parts.wants(*message)]
    assert 0.2 < len(read) / len(whole) < 0.4
    assert "/tf_static" in dict(read)
    assert {read[0][1] // SECOND, read[-1][1] // SECOND} == {whole[0][1] // SECOND, whole[-1][1] // SECOND}


@pytest.mark.usefixtures("_is_long")
@pytest.mark.parametrize(("share", "num_flaws"), [(0.1, 0), (0.4, 1)])
def test_damage_between_parts_is_not_read(tmp_path, share, num_flaws):
    path = written(tmp_path, "mcap")
    data = bytearray(path.read_bytes())
    place = data.index(b"x" * 99, round(share * len(data)))
    data[place] ^= 1
    path.write_bytes(data)
    log = open_container(path)
    log_parts.divide(log)
    assert (log_parts.parts_of(log).at(round(SECOND + share * 120 * SECOND)) is None) == (num_flaws == 0)
    assert sum(1 for _ in log.messages({"/image", "/odom"})) > 100
    assert len(log.flaws) == num_flaws


def test_a_short_log_is_read_whole():
    log = open_container(DEMO)
    log_parts.divide(log)
    assert log_parts.parts_of(log) is None


@pytest.mark.usefixtures("_is_long")
@pytest.mark.parametrize(("step_s", "said"), [(0, []), (-2, ["set back by 2.00 s"]), (3, ["set ahead by 3.00 s"])])
def test_a_step_of_the_clock_between_parts_is_told(tmp_path, step_s, said):
    late = messages(2)
    for message in late[600:]:
        message.message.header.stamp.sec += step_s
    log = stream_stats.CountedLog(open_container(scenes.write_mcap(tmp_path / "log.mcap", M, late)))
    log_parts.divide(log)
    parts = log_parts.parts_of(log)
    assert len(list(log.messages({"/odom"}))) > 100
    told = stream_stats.clock_steps(log.stats, parts)
    assert len(told) == len(said)
    assert all(text in told[0] for text in said)


@pytest.mark.usefixtures("_is_long")
def test_doctor_judges_a_long_log_by_its_parts(monkeypatch):
    for name, seconds in (("_MOST_NS", 1.6), ("_LEAST_NS", 1.0), ("_MARGIN_NS", 0.2)):
        monkeypatch.setattr(log_parts, name, round(SECOND * seconds))
    found = examine([DEMO], SourceOptions())
    assert (found.status, found.problems) == (SOUND, [])
    assert "a long log: 6 parts" in found.notes[0]
    assert found.frames["frames"] == pytest.approx(120, abs=15)
    assert found.frames["keyframes"] == pytest.approx(60, abs=10)
    assert found.topics["/tf"]["messages"] == found.topics["/tf"]["declared"] > 200
    assert found.topics["/tf"]["gaps"] == 0
    assert found.ledger["not_played"] > 500
    assert found.ledger["difference"] == 0
