import pytest
from players import open_source
from tests import player_scenes as scenes
from tools.benchmarks.logs.damaged_logs import run_cases

pytestmark = pytest.mark.timeout(60)


@pytest.fixture(scope="module")
def tally():
    return run_cases(168, seed=2)


def test_no_damage_crashes_or_hangs(tally):
    assert tally.cases == 168
    assert tally.crashes == []


def test_no_message_is_wrong_where_a_checksum_covers_it(tally):
    assert tally.silent == []


def test_nearly_every_message_outside_the_damage_is_read(tally):
    assert tally.expected > 10_000
    assert tally.recovered >= 0.99 * tally.expected


def test_a_chunk_of_a_bag_without_a_compression_is_read(tmp_path):
    m = scenes.Messages(ros=1)
    log = scenes.write_ros1(tmp_path / "log.bag", m, scenes.scene_messages(m, scenes.make_scene(), scenes.png_images))
    data = log.read_bytes()
    named, unnamed = b"\x10\x00\x00\x00compression=none", b"\x10\x00\x00\x00comqression=none"
    assert named in data
    log.write_bytes(data.replace(named, unnamed))
    assert list(open_source(log).frames()) != []
