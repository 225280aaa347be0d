import pytest
from players import open_source
from tests import player_scenes as scenes
from tools.benchmarks.logs.damaged_logs import run_cases

pytestmark = pytest.mark.timeout(60)


def test_damage_crashes_nothing_and_costs_only_what_it_touches():
    tally = run_cases(168, seed=2)
    assert (tally.cases, tally.crashes) == (168, [])
    assert tally.silent == [], "a message was wrong where a checksum covers it"
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
