import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
import numpy as np
from hickory_stream.cli.maps.align import objects_of
from hickory_stream.cli.option_values import movable_objects
from hickory_stream.engine.relocalise import without
from hickory_stream.map_folder.saved_map import open_map
from tests.alignment.map_fixtures import frame, furniture, snapshot_of
from tests.cli.test_cli import answer, refusal, said
from tests.cli.test_cli_align import save
from tests.navigation.rooms import seen_room


def in_seen_space(made):
    return replace(made, submaps=tuple(replace(one, observed_space=seen_room()) for one in made.submaps))


def test_diff_of_two_maps_prints_every_object_and_writes_a_page(tmp_path):
    items = furniture(12, 1)
    first = save(tmp_path / "monday", in_seen_space(snapshot_of(items, np.eye(4), 1)))
    second = save(tmp_path / "tuesday", in_seen_space(snapshot_of(items[:10], frame(35, 1, 2), 2)))
    page = tmp_path / "page.html"
    objects = answer("diff", first, second, "-o", page)["objects"]
    assert len([one for one in objects if one["verdict"] == "still there"]) == 10
    assert len([one for one in objects if one["id_b"] is None]) == 2
    text = page.read_text()
    assert text.count('class="card"') == len(objects)
    assert "http" not in text
    assert "10 still there" in said("diff", first, second)


def test_maps_that_do_not_align_or_know_no_space_are_refused(tmp_path):
    first = save(tmp_path / "a", in_seen_space(snapshot_of(furniture(12, 1), np.eye(4), 1)))
    other = save(tmp_path / "b", in_seen_space(snapshot_of(furniture(12, 60), np.eye(4), 3)))
    assert answer("diff", first, other, status=3)["aligned"] is False
    blind = save(tmp_path / "c", replace(snapshot_of(furniture(12, 1), np.eye(4), 1), submaps=()))
    assert "has no observed space" in refusal("diff", first, blind)
    assert "expected a name that ends in .html" in refusal("diff", first, other, "-o", tmp_path / "x.png")
    assert "found -o with --other" in refusal("diff", first, "--other", other, "-o", tmp_path / "x.html")


def test_what_moves_day_after_day_is_learnt_and_is_no_landmark(tmp_path):
    items = furniture(12, 1)
    file = tmp_path / "known.json"

    def day(name, shift_m, yaw_deg):
        place, *rest = items[0]
        moved = place.copy()
        moved[0] += shift_m
        made = snapshot_of([(moved, *rest), *items[1:]], frame(yaw_deg, 1, 2), 2)
        return save(tmp_path / name, in_seen_space(made))

    days = [day("monday", 0.0, 0), day("tuesday", 0.9, 35), day("wednesday", 0.0, -20), day("thursday", 0.9, 5)]
    lines = []
    for first, second in pairwise(days):
        lines.append(said("diff", first, second, "--stationarity", file))
    assert "".join(lines).count("no object tends to move yet") == 1
    stays = {row["id"]: row["stays"] for row in json.loads(file.read_text())["objects"]}
    movable = [i for i, share in stays.items() if share < 0.5]
    assert len(movable) == 1
    assert lines[-1].splitlines()[-1].endswith(f"#{movable[0]} tend to move")
    saved = open_map(Path(days[-1]))
    known = movable_objects(file, saved)
    assert known == movable
    assert set(without(objects_of(saved), known).ids) == set(stays) - set(movable)
    # It is of Thursday's map.
    assert "is of a map with the digest" in refusal("diff", days[0], days[1], "--stationarity", file)
    assert "found --stationarity without a second map" in refusal("diff", days[0], "1", "2", "--stationarity", file)
