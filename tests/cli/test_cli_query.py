import json
from dataclasses import replace
import cv2
import numpy as np
import pytest
import trimesh
from hickory_stream.base import caches
from hickory_stream.map_folder.views import write_crop
from hickory_stream.map_folder.writer import create_map_folder
from hickory_stream.records import ObjectKind
from tests.cli.test_cli import answer, ended_as, look, refusal, said
from tests.cli.test_cli_navigation import CRATE, asked, saved
from tests.engine.snapshot_fixtures import make_crop, make_snapshot
from tests.navigation.rooms import table, tracked
from tests.perception.small_pairs import write_pair


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = create_map_folder(tmp_path_factory.mktemp("query") / "map", config={}, source={}, overwrite=False)
    made.save(make_snapshot(made))
    made.finish(finished_cleanly=True)
    return made.path


def test_query_prints_what_answers_and_draws_it(folder, tmp_path):
    told = answer("query", folder, "a blue", "box", "-o", tmp_path / "a.png")
    assert [answer["goal"] for answer in told["answers"]] == ["object:4"]
    assert told["answers"][0]["why"] == {"blue": 1.0, "box": 1.0}
    picture = cv2.imread(str(tmp_path / "a.png")).astype(int)
    assert picture.shape[1] == 1600
    # What does not answer has no colour left: the table was brown.
    is_brown, is_blue = (np.abs(picture[80:836] - bgr).max(axis=2) < 40 for bgr in ((70, 110, 150), (180, 90, 60)))
    assert is_brown.sum() < 200 < is_blue.sum()
    assert said("query", folder, "how many things") == "any object: 2 (#1, #4), by geometry and colour alone\n"


def test_an_unanswered_query_says_so_and_a_bad_one_is_refused(folder):
    assert "nothing in the map answers\n  nearly" not in said("query", folder, "a green box", status=3)
    said("query", folder, "how many green boxes")
    for words, complaint in (
        (["a", "window"], '"window"'),
        (["box", "--top", "0"], "--top 0"),
        (["a", "--from", "x"], "X,Y"),
    ):
        assert complaint in refusal("query", folder, *words)


def test_plan_leads_to_a_place_beside_an_object(tmp_path):
    room = saved(tmp_path / "room.map", tracked(1, table()), tracked(2, CRATE))
    x, y = answer(*asked(room, "0.7,0.6", "object:2"))["points"][-1]
    # The crate reaches from 4.1 to 4.9 m and from 0.7 to 1.3 m, and its layer 4 ends there.
    assert 0 < np.hypot(max(4.1 - x, 0, x - 4.9), max(0.7 - y, 0, y - 1.3)) < 0.3
    assert look(*asked(room, "1.5,2.0", "object:1")).status in (0, 3)
    for goal, complaint in (("object:9", "has no object 9"), ("object:x", "expected X,Y in metres, or object:ID")):
        assert complaint in refusal(*asked(room, "0.7,0.6", goal))


def test_outputs_of_an_object_say_its_kind_and_how_sure(tmp_path):
    crate = replace(tracked(2, CRATE), kind=ObjectKind.FIXTURE, fixture_probability=0.75)
    room = saved(tmp_path / "room.map", tracked(1, table()), crate)
    query, blocked = ("query", room, "a fixture"), asked(room, "0.7,0.6", "4.5,1.0")
    for status, command, name in ((0, query, "answers"), (3, blocked, "blockers")):
        (told,) = answer(*command, status=status)[name]
        assert (told["object"], told["kind"], told["fixture_probability"]) == (2, "fixture", 0.75)
    said("export", room, "-o", tmp_path / "room.glb", "--texture", "0")
    meshes = trimesh.load(tmp_path / "room.glb", force="scene").geometry
    assert meshes["fixture-2"].metadata["fixture_probability"] == 0.75
    assert " 2  fixture 0.75  active" in said("inspect", room)
    assert "fixture 0.75 at (4.50, 1.00, 0.30) m" in said(*query)
    assert "note: these blocking objects are fixtures, which stay: 2" in said(*blocked, status=3)


def test_an_image_text_network_tells_what_words_look_like(tmp_path, monkeypatch):
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
    assert "models add FOLDER --kind image-text" in refusal(*query, "a window")
    # What a mug looks like is unknown so far, its size is not.
    assert json.loads(said(*query, "a mug", status=3))["by"] == "geometry and colour alone"

    pair = write_pair(tmp_path / "colours")
    answer("models", "add", pair, "--kind", "image-text", "--licence", "CC0-1.0")
    assert "colours  image-text  8 x 8  CC0-1.0" in said("models", "list")
    assert answer("models", "check", "colours")["dim"] == 3
    for question, expected in (("a mug", [1]), ("a window", [4]), ("a blue window", [4]), ("a thing on a mug", [4])):
        told = json.loads(said(*query, question))
        assert [answer["object"] for answer in told["answers"]] == expected, question
        assert told["by"] == "geometry, colour and an image-text network"
    said(*query, "a blue mug", status=3)
    assert len(list((tmp_path / "cache" / "image-features").rglob("*.f32"))) == 2

    # A feature that was cut off in the cache is made anew.
    for path in (tmp_path / "cache" / "image-features").rglob("*.f32"):
        path.write_bytes(path.read_bytes()[:5])
    again = ended_as(0, "query", made.path, "a mug")
    assert 'looks like "mug" 1.00' in again.stdout
    assert "views processed by colours: 2 of 2" in again.stderr

    said("models", "add", pair, "--kind", "image-text", "--name", "other")
    assert "there are several image-text networks (colours, other)" in refusal(*query, "a window")
    said(*query, "a mug", "--model", "other")
    (tmp_path / "models" / "other.tokenizer.json").unlink()
    assert "other.tokenizer.json is missing" in refusal(*query, "a mug", "--model", "other")
    (pair / "tokenizer.json").unlink()
    assert "no tokenizer.json" in refusal("models", "add", pair, "--kind", "image-text")
