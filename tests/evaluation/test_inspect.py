from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from hickory_stream.engine.digest import map_digest
from hickory_stream.engine.session import create_map_folder, open_map
from hickory_stream.evaluation.inspect import MapSummary, as_json, format_table, summarize
from tests.engine.snapshot_fixtures import make_snapshot

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def map_path(tmp_path: Path) -> Path:
    folder = create_map_folder(tmp_path / "m", config={}, source={"uri": "desk.mcap"})
    folder.save(make_snapshot(folder))
    folder.write_json("timings.json", {"layer1_s": 1.5, "layer2_s": 0.5, "layer3_s": 0.25})
    folder.finish(finished_cleanly=True)
    return tmp_path / "m"


@pytest.fixture
def summary(map_path: Path) -> MapSummary:
    return summarize(open_map(map_path))


def test_storage_is_counted_as_the_layers_hold_it(map_path: Path, summary: MapSummary) -> None:
    table, box, ball = summary.objects
    assert table.layer_bytes == (1500 * 15, (map_path / "shapes/000001.glb").stat().st_size, 88, 88)
    assert ball.layer_bytes == (1500 * 15, 0, 0, 0)
    assert (table.layers, ball.layers) == ((1, 2, 3, 4), (1,))
    assert [row.total_bytes for row in summary.layers] == [
        3 * 1500 * 15,
        table.layer_bytes[1] + box.layer_bytes[1],
        2 * 88,
        2 * 88,
    ]
    assert [row.num_objects for row in summary.layers] == [3, 2, 2, 2]


def test_times_come_from_the_folder_and_an_absent_one_stays_absent(summary: MapSummary) -> None:
    assert [row.seconds for row in summary.layers] == [1.5, 0.5, 0.25, None]


def test_the_sizes_are_the_sides_of_the_boxes(summary: MapSummary) -> None:
    assert sorted(summary.objects[0].size_m) == pytest.approx([0.05, 0.8, 1.2], abs=0.03)


def test_json_holds_the_digest_and_the_table_shows_every_object(map_path: Path, summary: MapSummary) -> None:
    entry = json.loads(json.dumps(as_json(summary)))
    assert entry["digest"] == map_digest(open_map(map_path).snapshot)
    assert [row["id"] for row in entry["objects"]] == [1, 4, 9]
    assert entry["objects"][2]["phase"] == "tentative"
    assert (entry["num_checked"], entry["num_outside"]) == (2000, 2)
    table = format_table(summary)
    assert "desk.mcap: 3 objects (1 tentative, 2 active), finished cleanly" in table
    assert "99.90 % of 2000 pieces checked are inside" in table
    assert summary.digest in table
    assert max(len(line) for line in table.splitlines()) <= 120


def test_a_sketch_is_named_as_what_it_is(tmp_path: Path) -> None:
    folder = create_map_folder(tmp_path / "m", config={}, source={})
    snapshot = make_snapshot(folder)
    shaped, bare = snapshot.objects[0], snapshot.objects[1]
    assert shaped.shape is not None
    sketched = replace(bare, shape=None, sketch=shaped.shape.fitted)
    folder.save(replace(snapshot, objects=(shaped, sketched)))
    folder.finish(finished_cleanly=True)
    summary = summarize(open_map(tmp_path / "m"))
    assert [row.is_sketched for row in summary.objects] == [False, True]
    assert (summary.objects[1].num_superquadrics, summary.objects[1].layers) == (0, (1,))
    assert summary.objects[0].num_superquadrics == len(shaped.shape.fitted)
    assert summary.objects[0].num_inflated == len(shaped.shape.inflated)
    assert "1 from points" in format_table(summary)


def test_an_empty_map_has_a_table(tmp_path: Path) -> None:
    create_map_folder(tmp_path / "m", config={}, source={})
    table = format_table(summarize(open_map(tmp_path / "m")))
    assert "0 objects (none), not finished" in table
