import subprocess
from types import SimpleNamespace
import pytest
from tools.benchmarks import headline
from tools.benchmarks.common.documents import keep
from tools.benchmarks.common.figures import Options, figure
from tools.benchmarks.table import BENCHMARKS, code_of


@pytest.mark.parametrize(
    ("options", "code", "is_current"),
    [(" --quick", None, True), (" --quick", "of another commit", False), ("", None, False)],
)
def test_a_row_is_current_with_its_options_and_code(tmp_path, options, code, *, is_current):
    keep("main", [figure("a", 1)], options=options, code=code or code_of("main", options), folder=tmp_path)
    assert headline.is_current("main", ["--quick"], tmp_path) is is_current
    assert not headline.is_current("align", ["--quick"], tmp_path)


def test_a_stopped_call_continues_with_the_next_row(monkeypatch, capsys):
    measured = []

    def run(command, **_):
        measured.append(" ".join(command[3:]))
        return SimpleNamespace(returncode=int("align" in command))

    monkeypatch.setattr(subprocess, "run", run)
    monkeypatch.setattr(headline, "ROWS", (("main", "--quick"), ("align", "--quick"), ("damage",)))
    monkeypatch.setattr(headline, "is_current", lambda name, _arguments: name == "main")
    (current,) = headline.measure(Options(seed=0, quick=False))
    assert measured == ["align --quick --write-docs", "damage --write-docs"]
    assert (current.value, current.of) == (1, "3 rows")
    printed = capsys.readouterr().out
    assert "tools/bench main --quick: as new as the code" in printed
    assert "tools/bench align --quick: failed" in printed
    headline.measure(Options(seed=0, quick=False, minutes=0.0))
    assert len(measured) == 2
    assert "tools/bench damage: not measured for want of time" in capsys.readouterr().out


def test_quick_alignment_does_not_depend_on_the_code_of_maps():
    assert code_of("align", " --quick") != code_of("align") != code_of("main")
    assert BENCHMARKS["align"].whole
