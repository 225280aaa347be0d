"""What `tools/bench` offers can be run."""

from __future__ import annotations

import importlib

import pytest

from tools.benchmarks.__main__ import benchmark_names


@pytest.mark.parametrize("name", benchmark_names())
def test_every_benchmark_that_is_offered_measures_something(name: str) -> None:
    assert callable(importlib.import_module(f"tools.benchmarks.{name}").measure)
