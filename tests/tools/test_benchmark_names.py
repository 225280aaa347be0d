import pytest
from tools.benchmarks.headline import ROWS
from tools.benchmarks.table import BENCHMARKS, code_of


@pytest.mark.parametrize("name", BENCHMARKS)
def test_every_benchmark_has_a_function_description_and_code(name):
    assert callable(BENCHMARKS[name].measure)
    assert BENCHMARKS[name].about
    assert len(code_of(name)) == 64


def test_the_rows_of_the_headline_are_benchmarks():
    assert {name for name, *_ in ROWS} <= BENCHMARKS.keys() - {"headline"}
