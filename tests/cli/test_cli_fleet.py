import json
import shutil
from types import SimpleNamespace
import numpy as np
import pytest
from rerun.chunk import RrdReader
from hickory_stream.evaluation.truth import load_truth
from hickory_stream.geometry.rigid import invert
from hickory_stream.journal.format import JOURNAL
from hickory_stream.map_folder.saved_map import open_map
from tests.cli.test_cli import answer, look, refusal
from tests.conftest import COARSE_SHAPES
from tools.worlds.fleet import make_fleet
from tools.worlds.recording_config import RecordingConfig

NO_SHAPES = ("--set", "mapper.mapping.requests.max_failures=0")
SMALL = RecordingConfig(seed=7, seconds=5.0, rate_hz=2.0, width=240, height=136)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Logs of two robots in one room, and one that is no log at all."""
    folder = tmp_path_factory.mktemp("robots")
    make_fleet(SMALL, folder, "f", 2, caster=None)
    (folder / "broken.mcap").write_bytes(b"no log at all" * 100)
    # What is merged has shapes all the same.
    (folder / "coarse.toml").write_text(COARSE_SHAPES)
    return folder


def fleet(made, out, *arguments):
    options = (
        "--config", made / "coarse.toml", *NO_SHAPES, "--every", "2", "--workers", "1", "--viewer", "none", "--json",
    )  # fmt: skip
    ended = look("fleet", *arguments, "-o", out, *options)
    return SimpleNamespace(out=out, ended=ended, told=ended.json())


@pytest.fixture(scope="module")
def by_two(made, tmp_path_factory):
    """The fleet of FLEET.toml and a robot whose log is broken, by two processes."""
    text = (made / "f.toml").read_text() + '[[robot]]\nname = "broken"\nlog = "broken.mcap"\n'
    (made / "three.toml").write_text(text)
    return fleet(made, tmp_path_factory.mktemp("out") / "two", made / "three.toml", "--processes", "2")


def test_two_robots_join_and_the_one_with_a_bad_log_is_named(by_two):
    assert by_two.ended.status == 3
    told = by_two.told
    first, second, broken = robots = told["robots"]
    assert told["joined"] is False
    assert [one["name"] for one in robots] == ["robot-1", "robot-2", "broken"]
    assert [one["name"] for one in first["joined_with"]] == ["robot-2"]
    assert [one["finished"] for one in (first, second, broken)] == [True, True, False]
    assert (first["frame"], second["frame"]) == ("robot-1", "robot-1")
    assert "broken.mcap" in broken["reason"] and "internal failure" not in broken["reason"]
    assert broken["map"] is None and not (by_two.out / "broken.map").exists()
    assert f"broken: {broken['reason']}" in by_two.ended.stderr
    assert [one["robots"] for one in told["merged"]] == [["robot-1", "robot-2"]]
    assert any("clocks of robot-1 and robot-2 do not overlap" in note for note in told["notes"])
    assert json.loads((by_two.out / "fleet.json").read_text()) == told


def test_robots_lie_where_they_truly_are(made, by_two):
    one, other = ({item.id: item for item in load_truth(made / f"f-{i}.truth").objects} for i in (1, 2))
    first_from_second = one[1].world_from_object @ invert(other[1].world_from_object)
    found = np.array(by_two.told["robots"][1]["frame_from_robot"])
    assert np.abs(invert(first_from_second) @ found - np.eye(4)).max() < 0.06


def test_one_process_after_another_gives_the_same_maps(made, by_two, tmp_path):
    robots = [f"--robot=robot-{i}={made / f'f-{i}.mcap'}" for i in (1, 2)]
    by_one = fleet(made, tmp_path / "one", *robots, "--processes", "1")
    assert by_one.ended.status == 0
    assert by_one.told["joined"] is True
    for i in (0, 1):
        assert by_one.told["robots"][i]["digest"] == by_two.told["robots"][i]["digest"]
    assert by_one.told["merged"][0]["digest"] == by_two.told["merged"][0]["digest"]
    assert by_one.told["joins"] == by_two.told["joins"]


def test_the_merged_map_is_the_one_that_merge_makes(by_two, tmp_path):
    maps = [by_two.out / f"robot-{i}.map" for i in (1, 2)]
    assert answer("merge", *maps, "-o", tmp_path / "m")["digest"] == by_two.told["merged"][0]["digest"]
    saved = open_map(by_two.out / "fleet.map")
    assert saved.manifest.finished_cleanly
    assert any(len(members) > 1 for members in saved.manifest.source["provenance"].values())


def test_a_killed_fleet_resumes_to_the_same_joins_and_map(made, by_two, tmp_path):
    """Robot 1 has ended, robot 2 was killed as soon as its folder was there."""
    for i in (1, 2):
        shutil.copytree(by_two.out / f"robot-{i}.map", tmp_path / f"robot-{i}.map")
    killed = tmp_path / "robot-2.map"
    (killed / JOURNAL).write_bytes(b"")
    manifest = json.loads((killed / "manifest.json").read_text())
    (killed / "manifest.json").write_text(json.dumps({**manifest, "finished_cleanly": False}))
    again = fleet(made, tmp_path, made / "f.toml", "--resume")
    assert again.ended.status == 0, again.ended.stderr
    assert again.told["joins"] == by_two.told["joins"]
    assert [one["digest"] for one in again.told["robots"]] == [one["digest"] for one in by_two.told["robots"][:2]]
    assert again.told["merged"][0]["digest"] == by_two.told["merged"][0]["digest"]
    assert again.told["notes"] == by_two.told["notes"]


def test_a_fleet_goes_on_with_nothing_but_its_own_maps(made, by_two, tmp_path):
    assert "there is nothing to --resume" in refusal("fleet", made / "f.toml", "-o", tmp_path / "none", "--resume")
    robots = [f"--robot=robot-{i}={made / f'f-{j}.mcap'}" for i, j in ((1, 2), (2, 1))]
    other = refusal("fleet", *robots, "-o", by_two.out, "--resume")
    assert "robot robot-1: " in other and "was made of" in other


def test_the_recording_has_every_robot_and_moves_joined_ones(by_two):
    columns = {}
    for chunk in RrdReader(by_two.out / "fleet.rrd").stream():
        if not chunk.is_static:
            found = columns.setdefault(chunk.entity_path, {})
            for name, values in chunk.to_record_batch().to_pydict().items():
                found.setdefault(name, []).extend(values)
    for name in ("/world/robot-1", "/world/robot-2"):
        assert f"{name}/path" in columns
        assert any(path.startswith(f"{name}/objects/") for path in columns)
        assert columns[name]["keyframe"] == [2, 4, 6, 8, 10, 10, 11]
    assert not any(path.startswith("/world/broken") for path in columns)
    places = [tuple(np.ravel(place)) for place in columns["/world/robot-2"]["Transform3D:translation"]]
    joined_at = by_two.told["robots"][1]["joined_with"][0]["since_keyframe"]
    assert joined_at in columns["/world/robot-2"]["keyframe"][2:6]
    first_from_second = np.array(by_two.told["robots"][1]["frame_from_robot"])
    assert np.allclose(places[-1], first_from_second[:3, 3], atol=1e-3)
    assert np.linalg.norm(np.array(places[0]) - places[-1]) > 1.0
    texts = [text for row in columns["/fleet/joins"]["TextLog:text"] for text in row]
    assert any("robot-1 and robot-2 are joined by" in text for text in texts)


@pytest.mark.parametrize(("arguments", "said"), [
    (("--robot", "a=MADE/f-1.mcap", "--robot", "a=MADE/f-2.mcap"), "two robots are called a"),
    (("--robot", "a=MADE/f-1.mcap", "--robot", "b=MADE/none.mcap"), "robot b: there is no"),
    (("--robot", "a=MADE/f-1.mcap"), "robots, found 1;"),
    ((), "expected either FLEET.toml, or --robot"),
    (("MADE/f.toml", "--robot", "a=b"), "expected either FLEET.toml, or --robot"),
    (("MADE/f.toml", "--every", "0"), "every_keyframes"),
    (("MADE/f.toml", "--processes", "-1"), "processes"),
    (
        ("--robot", "a=MADE/broken.mcap", "--robot", "b=MADE/broken.mcap"),
        "no robot gave a map (a, b): each reason is above",
    ),
])  # fmt: skip
def test_what_is_no_fleet_is_refused_in_one_line(made, tmp_path, arguments, said):
    refused = refusal("fleet", *(one.replace("MADE", str(made)) for one in arguments), "-o", tmp_path / "out")
    lines = refused.splitlines()
    last = lines[-1]
    assert last.startswith("hickory-stream: ")
    assert not list((tmp_path / "out").glob("*")), "nothing is left that a second try would stumble over"
    assert said in last
    assert max(map(lines.count, lines)) == 1
    assert refused.count("broken.mcap is") == 2 * ("a=MADE/broken.mcap" in arguments)


def test_play_maps_a_fleet_where_robots_are_named(made, tmp_path):
    robots = ("--robot", f"a={made / 'broken.mcap'}", "--robot", f"a={made / 'broken.mcap'}")
    for more, said in (
        (("--out", tmp_path / "out"), "two robots are called a"),
        (("--out", tmp_path / "out", "--frames", "3"), "found --frames, which needs a single log"),
        ((), "found no --out"),
    ):
        assert said in refusal("play", *robots, *more)
    assert "found no log" in look("play", "--out", tmp_path / "out").stderr


def test_what_is_there_is_not_replaced_unless_asked(made, by_two, tmp_path):
    refused = refusal("fleet", made / "f.toml", "-o", by_two.out)
    assert "robot-1.map exists; replace it with --overwrite, continue with --resume" in refused
    (tmp_path / "robot-1.map").mkdir()
    (tmp_path / "robot-1.map" / "photos").touch()
    refusal("fleet", made / "f.toml", "-o", tmp_path, "--overwrite")
    assert (tmp_path / "robot-1.map" / "photos").exists()
