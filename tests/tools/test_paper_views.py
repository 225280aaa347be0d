import json
import sys
from hickory_stream.config import MapperConfig
from hickory_stream.map_folder.saved_map import open_map
from tests.examples.generators import HERE
from tools.evaluation.views.trials import BEST, OURS, STRATEGIES
from tools.paper_tables.__main__ import main
from tools.paper_tables.own_maps import reconstructors_of

COARSE = (
    "--set", "mapper.shapes.single_view.volume.cells=16",
    "--set", "mapper.shapes.single_view.symmetry.num_yaws=4",
    "--set", "mapper.shapes.single_view.symmetry.num_offsets=3",
)  # fmt: skip
BOXES = """
name = "boxes"
command = ["{python}", "{program}"]
"""


def test_every_strategy_chooses_among_the_views_of_one_playback(short_log, demo_truth, tmp_path, capsys):
    out = tmp_path / "maps"
    command = ["views", str(short_log), "--truth", str(demo_truth), "--out", str(out), "--json", *COARSE]
    assert main([*command, "--reconstructor", "single_view"]) == 0
    rows = json.loads(capsys.readouterr().out.splitlines()[-1])["strategies"]
    by_name = {row["strategy"]: row for row in rows}
    assert set(by_name) == {*STRATEGIES, BEST}
    assert {row["reconstructor"] for row in rows} == {"single_view"}
    assert by_name[OURS]["s_minus_this"] is None
    # Nothing surpasses the best view, and the first one of an object is rarely it.
    assert all(row["f1_5pct"] <= by_name[BEST]["f1_5pct"] for row in rows)
    assert 0.0 < by_name["initial"]["f1_5pct"] < by_name[BEST]["f1_5pct"]
    assert all(item.shape is None for item in open_map(out / "0").snapshot.objects)


def test_an_unusable_generator_is_named_before_playing(short_log, demo_truth, tmp_path, capsys):
    (tmp_path / "none.toml").write_text('name = "none"\ncommand = ["no-such-program"]\n')
    command = ["views", str(short_log), "--truth", str(demo_truth), "--reconstructor"]
    assert main([*command, str(tmp_path / "none.toml")]) == 2
    assert "no-such-program" in capsys.readouterr().err


def test_startable_generators_are_compared_and_others_named(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("HICKORY_GENERATORS", str(tmp_path))
    boxes = BOXES.replace("{python}", sys.executable).replace("{program}", str(HERE / "box_generator.py"))
    (tmp_path / "boxes.toml").write_text(boxes)
    (tmp_path / "none.toml").write_text('name = "none"\ncommand = ["no-such-program"]\n')
    (tmp_path / "research.toml").write_text(boxes.replace("boxes", "research") + 'acceptance = "research only"\n')
    assert list(reconstructors_of(None, MapperConfig())) == ["single_view", "boxes"]
    said = capsys.readouterr().err
    assert "left out: " in said
    assert "no-such-program" in said
    assert "research only" in said
