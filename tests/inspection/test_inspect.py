import json
import re
from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.cli import main
from hickory_stream.inspection.inspect import as_json, chosen, format_table, summarize
from hickory_stream.inspection.object_geometry import place_of
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.map_folder.writer import create_map_folder
from tests.engine.snapshot_fixtures import box_mesh, make_snapshot


@pytest.fixture
def map_path(tmp_path):
    folder = create_map_folder(tmp_path / "m", config={}, source={"uri": "desk.mcap"})
    folder.save(make_snapshot(folder))
    folder.write_json("timings.json", {"layer1_s": 1.5, "layer2_s": 0.5, "layer3_s": 0.25})
    folder.finish(finished_cleanly=True)
    return tmp_path / "m"


@pytest.fixture
def summary(map_path):
    return summarize(open_map(map_path))


def test_storage_is_counted_as_the_layers_hold_it(map_path, summary):
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


def test_times_of_layers_and_sides_of_boxes_are_listed(summary):
    assert [row.seconds for row in summary.layers] == [1.5, 0.5, 0.25, None]
    assert sorted(summary.objects[0].size_m) == pytest.approx([0.05, 0.8, 1.2], abs=0.03)


def test_json_holds_the_digest_and_the_table_shows_every_object(map_path, summary):
    entry = json.loads(json.dumps(as_json(summary)))
    assert entry["digest"] == map_digest(open_map(map_path).snapshot)
    assert [row["id"] for row in entry["objects"]] == [1, 4, 9]
    assert entry["objects"][2]["phase"] == "tentative"
    assert (entry["num_checked"], entry["num_outside"]) == (2000, 2)
    table = format_table(summary)
    assert "desk.mcap: 3 objects (1 tentative, 2 active), finished cleanly" in table
    assert "99.90 % of 2000 pieces checked are inside" in table
    assert summary.digest in table
    assert len(table.splitlines()) == 3 + 3 + 1 + 2
    whole = format_table(summary, with_layers=True)
    assert "superquadrics" in whole
    assert max(len(line) for line in whole.splitlines()) <= 120


def test_a_sketch_is_named_as_what_it_is(tmp_path):
    folder = create_map_folder(tmp_path / "m", config={}, source={})
    snapshot = make_snapshot(folder)
    shaped, bare = snapshot.objects[0], snapshot.objects[1]
    folder.save(replace(snapshot, objects=(shaped, replace(bare, shape=None, sketch=shaped.shape.fitted))))
    folder.finish(finished_cleanly=True)
    summary = summarize(open_map(tmp_path / "m"))
    assert [row.is_sketched for row in summary.objects] == [False, True]
    assert (summary.objects[1].num_superquadrics, summary.objects[1].layers) == (0, (1,))
    assert summary.objects[0].num_superquadrics == len(shaped.shape.fitted)
    assert summary.objects[0].num_inflated == len(shaped.shape.inflated)
    assert "1 from points" in format_table(summary, with_layers=True)


def test_an_empty_map_has_a_table(tmp_path):
    create_map_folder(tmp_path / "m", config={}, source={})
    assert "0 objects (none), not finished" in format_table(summarize(open_map(tmp_path / "m")))


def test_where_an_object_is_comes_from_its_best_layer(map_path, summary):
    saved = open_map(map_path)
    for row, tracked in zip(summary.objects, saved.snapshot.objects, strict=True):
        assert row.submap_id == tracked.submap_id
        assert row.place.layer == (1 if tracked.shape is None else 2)
        reached = tracked.points_world
        if tracked.shape is not None:
            mesh, pose = saved.mesh(tracked.shape), tracked.shape.world_from_object
            reached = mesh.vertices @ pose[:3, :3].T + pose[:3, 3]
        yaw = np.radians(row.place.yaw_deg)
        turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        local = (reached - np.array(row.place.center_m)) @ turn
        assert np.abs(local).max(axis=0) * 2 == pytest.approx(row.place.size_m, abs=0.002)
        assert 0 <= row.place.yaw_deg < 180
        assert re.fullmatch("#[0-9a-f]{6}", row.place.color)


def test_a_mesh_volume_is_what_it_encloses():
    box = box_mesh((0.4, 0.2, 0.1), (10, 200, 30))
    tracked = make_snapshot().objects[0]
    colors = np.full((len(tracked.points_world), 3), (200, 100, 0), dtype=np.uint8)
    colors[: len(colors) // 3] = (0, 0, 255)
    place = place_of(replace(tracked, colors=colors), box)
    assert place.volume_m3 == pytest.approx(0.4 * 0.2 * 0.1, rel=1e-5)
    assert sorted(place.size_m) == pytest.approx([0.1, 0.2, 0.4], abs=1e-3)
    assert place.color == "#c86400"


def test_objects_are_sorted_and_filtered_and_the_totals_stay(summary):
    by_volume = chosen(summary, sort="volume").objects
    assert [row.place.volume_m3 for row in by_volume] == sorted((r.place.volume_m3 for r in by_volume), reverse=True)
    last = summary.objects[-1]
    x, y, _ = last.place.center_m
    assert chosen(summary, sort="distance", near=(x, y)).objects[0] == last
    near = chosen(summary, near=(x, y), within_m=0.001)
    assert near.objects == (last,)
    assert (near.num_objects, near.layers, near.digest) == (3, summary.layers, summary.digest)
    longest = max(max(row.place.size_m) for row in summary.objects)
    assert len(chosen(summary, min_size_m=longest).objects) == 1
    assert chosen(summary, min_size_m=longest + 1).objects == ()
    assert "1 of 3 objects, finished cleanly" in format_table(near)


def test_near_a_place_the_table_is_sorted_and_shows_distances(map_path, summary, capsys):
    x, y, _ = summary.objects[-1].place.center_m
    assert main(["inspect", str(map_path), f"--near={x},{y}"]) == 0
    header, *rows = (line.split() for line in capsys.readouterr().out.splitlines()[2:6])
    assert header[-2:] == ["away", "m"]
    away_m = [float(row[-1]) for row in rows]
    assert (rows[0][0], away_m[0]) == (str(summary.objects[-1].id), 0.0)
    assert away_m == sorted(away_m) and away_m[-1] > 0


def test_the_help_explains_the_words_of_the_table(map_path, capsys):
    with pytest.raises(SystemExit):
        main(["inspect", "--help"])
    explained = re.findall(r"^  (\w[\w, ]*?)  +\w", capsys.readouterr().out.partition("columns:")[2], re.MULTILINE)
    assert {"phase", "submap", "held by", "outside"} <= set(explained)


@pytest.mark.parametrize(("arguments", "told"), [
    (["--near", "1"], "expected X,Y in metres"), (["--near", "1,2,x"], "expected X,Y,R in metres"),
    (["--near", "1,2,-1"], "expected X,Y,R in metres"), (["--near", "1,2,nan"], "expected X,Y,R in metres"),
    (["--min-size", "nan"], "expected metres, 0 or more"),
])  # fmt: skip
def test_a_place_or_a_size_that_is_none_is_refused(map_path, arguments, told, capsys):
    assert main(["inspect", str(map_path), *arguments]) == 2
    assert told in capsys.readouterr().err


def test_the_command_sorts_and_filters(map_path, summary, capsys):
    x, y, _ = summary.objects[1].place.center_m
    assert main(["inspect", str(map_path), "--json", f"--near={x},{y},0.01", "--sort", "volume"]) == 0
    assert [row["id"] for row in json.loads(capsys.readouterr().out)["objects"]] == [summary.objects[1].id]


def test_the_table_names_the_source_of_layer_three(map_path):
    saved = open_map(map_path)
    table = saved.snapshot.objects[0]
    hollow = replace(table.shape, fit_kind="envelope", verdict="triposr: agrees with 0.93 of the surface")
    objects = (replace(table, shape=hollow), *saved.snapshot.objects[1:])
    found = summarize(replace(saved, snapshot=replace(saved.snapshot, objects=objects)))
    assert (found.objects[0].fit_kind, found.objects[2].fit_kind) == ("envelope", None)
    text = format_table(found, with_layers=True)
    assert re.search(r"^ +1 .* 1 \(envelope, 88 B\)", text, re.MULTILINE)
    assert f"shape of 1: {hollow.verdict}" in text
    with pytest.raises(ValueError, match="layer 3 is of kind 'ball', not one of solid, panels, envelope"):
        replace(hollow, fit_kind="ball")
