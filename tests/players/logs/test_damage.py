"""A seeded sample of damaged logs; `tools/bench damage` has the whole."""

import pytest
from tools.benchmarks.logs.damaged_logs import Tally, run_cases

pytestmark = pytest.mark.timeout(60)


@pytest.fixture(scope="module")
def tally() -> Tally:
    return run_cases(168, seed=2)


def test_no_damage_crashes_or_hangs(tally):
    assert tally.cases == 168
    assert tally.crashes == []


def test_no_message_is_wrong_where_a_checksum_covers_it(tally):
    assert tally.silent == []


def test_nearly_every_message_outside_the_damage_is_read(tally):
    assert tally.expected > 10_000
    assert tally.recovered >= 0.99 * tally.expected
