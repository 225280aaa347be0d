"""Maps of three small logs are what they were: to the byte, and in how much of the truth they find.

A change that moves a map on purpose moves `baseline.json` with it: `tools/bench golden --set-baseline "why"`.
"""

import pytest
from tools.benchmarks.common.baseline import baseline_file, compare, read_baseline
from tools.benchmarks.maps.golden import LOGS, figures_of


@pytest.mark.parametrize("name", LOGS)
def test_the_map_of_a_golden_log_is_the_committed_one(name, tmp_path):
    baseline = read_baseline(baseline_file("golden"))
    own = {key: entry for key, entry in baseline["figures"].items() if key.startswith(f"{name}_")}
    found = compare(figures_of(name, tmp_path / "map"), {"figures": own})
    assert (found.regressions, found.missing) == ([], [])
    assert len(own) == 4
