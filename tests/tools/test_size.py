from hickory_stream.settings import Settings
from tools import size


def test_keys_are_counted_to_the_last_section():
    found = list(size.keys(Settings()))
    assert len(found) == len(set(found))
    assert {"mapper.run.workers", "mapper.shapes.fit.max_primitives", "rerun.bind"} <= set(found)


def test_minutes_are_the_shells_and_over_the_limit_is_failure(tmp_path, monkeypatch, capsys):
    times = tmp_path / "times"
    monkeypatch.setattr(size, "TEST_TIMES", times)
    assert size.test_minutes() is None
    times.write_text("0m0.010s 0m0.004s\n12m30.000s 1m30.000s\n")
    assert size.test_minutes() == 14.0
    over = [size.Measure(name="files", value=3, limit=2), size.Measure(name="lines", value=None, limit=1)]
    monkeypatch.setattr(size, "measures", lambda: iter(over))
    assert size.main() == 1
    assert "OVER" in capsys.readouterr().out.splitlines()[0]
