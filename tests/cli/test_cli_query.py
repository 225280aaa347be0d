import json
from dataclasses import replace
import cv2
import numpy as np
import pytest
import trimesh
from hickory_stream.base import caches
from hickory_stream.cli import main
from hickory_stream.map_folder.views import write_crop
from hickory_stream.map_folder.writer import create_map_folder
from hickory_stream.records import ObjectKind
from tests.cli.test_cli_navigation import CRATE, saved
from tests.engine.snapshot_fixtures import make_crop, make_snapshot
from tests.navigation.rooms import table, tracked
from tests.perception.small_pairs import write_pair


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = create_map_folder(tmp_path_factory.mktemp("query") / "map", config={}, source={}, overwrite=False)
    made.save(make_snapshot(made))
    made.finish(finished_cleanly=True)
    return made.path


def test_query_prints_what_answers_and_draws_it(folder, tmp_path, capsys):
    assert main(["query", str(folder), "a blue", "box", "--json", "-o", str(tmp_path / "a.png")]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [answer["goal"] for answer in told["answers"]] == ["object:4"]
    assert told["answers"][0]["why"] == {"blue": 1.0, "box": 1.0}
    picture = cv2.imread(str(tmp_path / "a.png")).astype(int)
    assert picture.shape[1] == 1600
    # What does not answer has no colour left: the table was brown.
    is_brown, is_blue = (np.abs(picture[80:836] - bgr).max(axis=2) < 40 for bgr in ((70, 110, 150), (180, 90, 60)))
    assert is_brown.sum() < 200 < is_blue.sum()
    assert main(["query", str(folder), "how many things"]) == 0
    assert capsys.readouterr().out == "any object: 2 (#1, #4), by geometry and colour alone\n"


def test_an_unanswered_query_says_so_and_a_bad_one_is_refused(folder, capsys):
    assert main(["query", str(folder), "a green box"]) == 3
    assert "nothing in the map answers\n  nearly" not in capsys.readouterr().out
    assert main(["query", str(folder), "how many green boxes"]) == 0
    for words, complaint in (
        (["a", "window"], '"window"'),
        (["box", "--top", "0"], "--top 0"),
        (["a", "--from", "x"], "X,Y"),
    ):
        assert main(["query", str(folder), *words]) == 2
        assert complaint in capsys.readouterr().err


def test_plan_leads_to_a_place_beside_an_object(tmp_path, capsys):
    room = saved(tmp_path / "room.map", tracked(1, table()), tracked(2, CRATE))
    command = ["plan", str(room), "--start", "0.7,0.6", "--robot", "point", "--json"]
    assert main([*command, "--goal", "object:2"]) == 0
    x, y = json.loads(capsys.readouterr().out)["points"][-1]
    # The crate reaches from 4.1 to 4.9 m and from 0.7 to 1.3 m, and its layer 4 ends there.
    assert 0 < np.hypot(max(4.1 - x, 0, x - 4.9), max(0.7 - y, 0, y - 1.3)) < 0.3
    assert main([*command, "--goal", "object:1", "--start", "1.5,2.0"]) in (0, 3)
    capsys.readouterr()
    for goal, complaint in (("object:9", "has no object 9"), ("object:x", "expected X,Y in metres, or object:ID")):
        assert main([*command, "--goal", goal]) == 2
        assert complaint in capsys.readouterr().err


def test_outputs_of_an_object_say_its_kind_and_how_sure(tmp_path, capsys):
    crate = replace(tracked(2, CRATE), kind=ObjectKind.FIXTURE, fixture_probability=0.75)
    room = str(saved(tmp_path / "room.map", tracked(1, table()), crate))
    blocked = ["plan", room, "--start", "0.7,0.6", "--goal", "4.5,1.0", "--robot", "point"]
    for status, command, name in ((0, ["query", room, "a fixture"], "answers"), (3, blocked, "blockers")):
        assert main([*command, "--json"]) == status
        (told,) = json.loads(capsys.readouterr().out)[name]
        assert (told["object"], told["kind"], told["fixture_probability"]) == (2, "fixture", 0.75)
    assert main(["export", room, "-o", str(tmp_path / "room.glb"), "--texture", "0"]) == 0
    meshes = trimesh.load(tmp_path / "room.glb", force="scene").geometry
    assert meshes["fixture-2"].metadata["fixture_probability"] == 0.75
    capsys.readouterr()
    for command, text in (
        (["inspect", room], " 2  fixture 0.75  active"),
        (["query", room, "a fixture"], "fixture 0.75 at (4.50, 1.00, 0.30) m"),
        (blocked, "note: these blocking objects are fixtures, which stay: 2"),
    ):
        main(command)
        assert text in capsys.readouterr().out


def test_an_image_text_network_tells_what_words_look_like(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("HICKORY_MODELS", str(tmp_path / "models"))
    monkeypatch.setattr(caches, "cache_root", lambda: tmp_path / "cache")
    made = create_map_folder(tmp_path / "map", config={}, source={}, overwrite=False)
    snapshot = make_snapshot(made)
    # The view of the table is red and that of the box is blue, whatever their points are.
    for item, color in zip(snapshot.objects, ((220, 20, 20), (20, 20, 220)), strict=False):
        picture = np.full((12, 16, 3), color, np.uint8)
        write_crop(made.views, item.best_view.name, replace(make_crop(), rgb=picture))
    made.save(snapshot)
    made.finish(finished_cleanly=True)
    query = ["query", str(made.path), "--json"]
    assert main([*query, "a window"]) == 2
    assert "models add FOLDER --kind image-text" in capsys.readouterr().err
    # What a mug looks like is unknown so far, its size is not.
    assert main([*query, "a mug"]) == 3
    assert json.loads(capsys.readouterr().out)["by"] == "geometry and colour alone"

    pair = write_pair(tmp_path / "colours")
    assert main(["models", "add", str(pair), "--kind", "image-text", "--licence", "CC0-1.0", "--json"]) == 0
    assert main(["models", "list"]) == 0
    assert "colours  image-text  8 x 8  CC0-1.0" in capsys.readouterr().out
    assert main(["models", "check", "colours", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["dim"] == 3
    for question, expected in (("a mug", [1]), ("a window", [4]), ("a blue window", [4]), ("a thing on a mug", [4])):
        assert main([*query, question]) == 0
        told = json.loads(capsys.readouterr().out)
        assert [answer["object"] for answer in told["answers"]] == expected, question
        assert told["by"] == "geometry, colour and an image-text network"
    assert main([*query, "a blue mug"]) == 3
    assert len(list((tmp_path / "cache" / "image-features").rglob("*.f32"))) == 2

    # A feature that was cut off in the cache is made anew.
    for path in (tmp_path / "cache" / "image-features").rglob("*.f32"):
        path.write_bytes(path.read_bytes()[:5])
    capsys.readouterr()
    assert main(["query", str(made.path), "a mug"]) == 0
    told, progress = capsys.readouterr()
    assert 'looks like "mug" 1.00' in told
    assert "views processed by colours: 2 of 2" in progress

    assert main(["models", "add", str(pair), "--kind", "image-text", "--name", "other"]) == 0
    assert main([*query, "a window"]) == 2
    assert "there are several image-text networks (colours, other)" in capsys.readouterr().err
    assert main([*query, "a mug", "--model", "other"]) == 0
    (tmp_path / "models" / "other.tokenizer.json").unlink()
    assert main([*query, "a mug", "--model", "other"]) == 2
    assert "other.tokenizer.json is missing" in capsys.readouterr().err
    (pair / "tokenizer.json").unlink()
    assert main(["models", "add", str(pair), "--kind", "image-text"]) == 2
    assert "no tokenizer.json" in capsys.readouterr().err
