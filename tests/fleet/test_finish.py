import json
import numpy as np
import pytest
from hickory_stream.cli.runs.fleet import result_text
from hickory_stream.fleet.finish import finish
from hickory_stream.fleet.messages import Ended
from hickory_stream.fleet.result import result_of
from hickory_stream.fleet.run import end_texts
from hickory_stream.geometry.rigid import invert
from hickory_stream.map_folder.saved_map import open_map
from tests.alignment.map_fixtures import frame, furniture, snapshot_of
from tests.cli.test_cli import answer
from tests.merging.test_merge_maps import save

HERE, THERE = furniture(14, 7), furniture(12, 60)
FRAMES = {"alone": frame(5, 1, 1), "a": frame(20, 1, 1), "x": frame(33, 0, 2), "b": frame(70, 2, -1),
          "y": frame(10, 4, 0), "c": frame(-130, 0.5, 3)}  # fmt: skip
ITEMS = {"alone": furniture(6, 90), "a": HERE[:10], "x": THERE, "b": HERE[2:], "y": THERE, "c": HERE[:12]}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Maps of three robots in one place, two in another, one alone, and one map that was altered."""
    base = tmp_path_factory.mktemp("fleet")
    for i, (name, pose) in enumerate(FRAMES.items()):
        save(base / f"{name}.map", snapshot_of(ITEMS[name], pose, i))
    save(base / "altered.map", snapshot_of(HERE[:5], np.eye(4), 9))
    manifest = base / "altered.map" / "manifest.json"
    entry = json.loads(manifest.read_text())
    manifest.write_text(json.dumps(entry | {"digest": "0" * 64}))
    return base


@pytest.fixture(scope="module")
def finished(folder):
    return finish({name: folder / f"{name}.map" for name in [*FRAMES, "altered"]}, folder, overwrite=False)


def test_every_frame_of_several_robots_has_a_map_largest_first(folder, finished):
    made = [(one.path.name, one.names, one.num_objects) for one in finished.merged]
    assert made == [("fleet.map", ("a", "b", "c"), 14), ("fleet-2.map", ("x", "y"), 12)]
    assert len(open_map(folder / "fleet.map").snapshot.objects) == 14
    assert [one.names for one in finished.frames] == [("alone",), ("a", "b", "c"), ("x", "y")]
    for name, pose in zip(*(getattr(finished.frames[1], part) for part in ("names", "frame_from_robot")), strict=True):
        assert np.allclose(pose, FRAMES["a"] @ invert(FRAMES[name]), atol=0.02)


def test_the_fleets_map_is_the_merge_of_the_finished_maps(folder, finished, tmp_path):
    maps = [folder / f"{name}.map" for name in finished.merged[0].names]
    assert answer("merge", *maps, "-o", tmp_path / "merged.map")["digest"] == finished.merged[0].digest


def test_a_lone_robot_has_a_reason_and_an_altered_map_joins_none(folder, finished):
    assert "is not the map that was saved" in finished.problems["altered"]
    names = [*FRAMES, "altered", "dead"]
    ended = {name: Ended(is_finished=name != "dead", reason="killed" if name == "dead" else "") for name in names}
    result = result_of(ended, {name: folder / f"{name}.map" for name in names}, {}, finished, ())
    robots = {robot.name: robot for robot in result.robots}
    assert [one.name for one in robots["b"].joined] == ["a", "c"]
    assert (robots["b"].frame, robots["b"].reason) == ("a", "")
    assert (robots["alone"].frame, robots["alone"].joined) == ("alone", ())
    assert "a: too-few" in robots["alone"].reason
    assert "is not the map that was saved" in robots["altered"].reason
    assert (robots["dead"].reason, robots["dead"].map, robots["dead"].is_finished) == ("killed", None, False)
    assert not result.is_whole
    table, *reasons = result_text(result).split("\nalone is in")
    lines = table.splitlines()
    assert lines[0].split() == "robot keyframes objects joined with pairs sigma since keyframe".split()
    assert len(lines) == 1 + len(names) + 3  # of three robots that are joined each has two others
    assert "no other robot's frame: a: too-few" in reasons[0]


def test_merges_reasons_against_and_clocks_apart_are_named(finished, folder):
    merged, other, alone = end_texts(finished)
    assert merged == "the finished maps of a, b, c are merged"
    assert other == "the finished maps of x, y are merged"
    assert alone.startswith("alone is in no other robot's frame: a: ")
    spans = {"a": (0, 10), "b": (5, 20), "x": (30, 40)}
    ended = {name: Ended(is_finished=True, start_ns=start, end_ns=end) for name, (start, end) in spans.items()}
    (note,) = result_of(ended, dict.fromkeys(spans, folder), {}, finished, ()).notes
    assert note.startswith("the clocks of a and x, b and x do not overlap")
    del ended["x"]
    assert result_of(ended, dict.fromkeys(ended, folder), {}, finished, ()).notes == ()
