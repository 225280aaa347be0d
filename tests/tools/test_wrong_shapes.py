import pytest
from tools.benchmarks.shapes.generated import kept_figures
from tools.benchmarks.shapes.outcomes import Outcome


def test_what_is_kept_costs_what_fused_was_better_or_nothing():
    outcomes = [
        Outcome(blended=0.7, fused=0.9, is_kept=True), Outcome(blended=0.95, fused=0.85, is_kept=True),
        Outcome(blended=0.2, fused=1.0, is_kept=False), None,
    ]  # fmt: skip
    share, less = kept_figures("wrong", outcomes, 10, "objects")
    assert (share.name, share.value) == ("wrong_kept_fraction", pytest.approx(0.2))
    assert share.of.startswith("2 of 10 objects")
    # Lost 0.2 by one and won 0.1 by another, of ten.
    assert (less.name, less.value) == ("wrong_kept_f1_less", pytest.approx(0.01))
    assert "mean over 10 objects; 1 lose more than 0.02" in less.of
    share, less = kept_figures("stranger", [], 5, "objects")
    assert share.value == less.value == 0
