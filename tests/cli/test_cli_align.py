import json
from dataclasses import replace
from pathlib import Path
import cv2
import numpy as np
import pytest
from hickory_stream.alignment.align import align
from hickory_stream.alignment.answer import NoAlignment, Refusal
from hickory_stream.alignment.object_map import object_map
from hickory_stream.box_scene import SceneSource
from hickory_stream.cli.maps.align import answer_json, answer_text, load_objects, named_maps, pose_text
from hickory_stream.config import MapperConfig
from hickory_stream.engine.relocalise import relocalise
from hickory_stream.geometry.rigid import invert
from hickory_stream.map_folder.manifest import MANIFEST
from hickory_stream.map_folder.writer import create_map_folder
from tests.alignment.map_fixtures import frame, furniture, snapshot_of
from tests.cli.test_cli import answer, refusal, said

B_FROM_WORLD = frame(35, 1, 2)


def save(path, snapshot):
    folder = create_map_folder(path, config={}, source={"uri": path.name})
    folder.save(snapshot)
    folder.finish(finished_cleanly=True)
    return str(path)


@pytest.fixture(scope="module")
def maps(tmp_path_factory):
    base = tmp_path_factory.mktemp("maps")
    items = furniture(12, 1)
    return {
        "a": save(base / "a", snapshot_of(items, np.eye(4), 1)),
        "b": save(base / "b", snapshot_of(items[:10], B_FROM_WORLD, 2)),
        "other": save(base / "other", snapshot_of(furniture(12, 60), np.eye(4), 3)),
        "empty": save(base / "empty", snapshot_of([], np.eye(4))),
    }


def test_two_maps_of_one_place_are_aligned(maps):
    told = answer("align", maps["a"], maps["b"])
    assert (told["aligned"], len(told["pairs"])) == (True, 10)
    assert np.allclose(told["a_from_b"], invert(B_FROM_WORLD), atol=0.01)
    assert "10 pairs" in said("align", maps["a"], maps["b"])


@pytest.mark.parametrize(("log10_chance", "is_weak"), [(-20, False), (-3, True)])
def test_an_alignment_with_weak_odds_says_so(maps, log10_chance, is_weak):
    answer = replace(align(*(load_objects(Path(maps[name])) for name in "ab")), log10_chance=log10_chance)
    assert answer_json(answer)["is_weak"] is is_weak
    assert ("weak" in answer_text(answer)) is is_weak


@pytest.mark.parametrize(("other", "known"), [("other", None), ("empty", "empty")])
def test_two_different_places_end_with_status_3_and_the_reason(maps, other, known):
    told = answer("align", maps["a"], maps[other], status=3)
    assert told["aligned"] is False and told["reason"]
    assert known is None or told["refusal"] == known
    assert "not aligned" in said("align", maps["a"], maps[other], status=3)


def test_pictures_and_recordings_are_written_or_refused_by_name(maps, tmp_path):
    said("align", maps["a"], maps["b"], "-o", tmp_path / "p.png")
    assert cv2.imread(str(tmp_path / "p.png")).shape == (800, 1600, 3)
    said("align", maps["a"], maps["other"], "-o", tmp_path / "q.rrd", status=3)
    assert (tmp_path / "q.rrd").stat().st_size > 1000
    for out in ("p.jpg", "nowhere/p.png"):
        assert out in refusal("align", maps["a"], maps["b"], "-o", tmp_path / out)


def test_a_map_of_another_version_is_refused(maps, tmp_path):
    old = tmp_path / "old"
    save(old, snapshot_of(furniture(4, 0), np.eye(4)))
    entry = json.loads((old / MANIFEST).read_text())
    (old / MANIFEST).write_text(json.dumps(entry | {"format": 0}))
    assert "format 0" in refusal("align", maps["a"], old)
    assert "format 0" in refusal("merge", maps["a"], old, "-o", tmp_path / "m")


def test_a_place_has_no_negative_zero_and_a_reason_its_maps():
    nearly = np.eye(4)
    nearly[:3, 3] = (-1e-5, 0.0004, -2.0)
    assert pose_text(nearly) == ("(0.000, 0.000, -2.000) m", "turned by 0.00 deg")
    assert named_maps("map b holds 3 objects, map a more", "old map b", "new") == "new holds 3 objects, old map b more"


def test_a_log_of_another_place_is_not_found_in_a_map():
    heard = []
    stored = object_map(snapshot_of(furniture(12, 1), np.eye(4)))
    last = relocalise(stored, SceneSource(8), MapperConfig(), rate=None, stops_when_found=True, report=heard.append)
    assert heard[-1] is last
    assert not last.is_confirmed
    assert isinstance(last.answer, NoAlignment)
    assert last.answer.refusal in (Refusal.EMPTY, Refusal.TOO_FEW_OBJECTS)
