import json
from dataclasses import replace
import cv2
import numpy as np
import pytest
from hickory_stream.changes.stationarity import Stationarity, StayCount, write_stationarity
from hickory_stream.cli import main
from hickory_stream.evaluation.truth import Truth, TruthObject, truth_record
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.mesh import write_glb
from hickory_stream.map_folder.writer import create_map_folder
from hickory_stream.navigation.free_space import obstacle_grid
from hickory_stream.navigation.robot import Part, Posture, Robot
from tests.engine.snapshot_fixtures import box_mesh, placed
from tests.navigation.rooms import boxes, snapshot, table, tracked
from tools.paper_tables.__main__ import main as paper

CRATE = boxes(((4.5, 1.0, 0.3), (0.4, 0.3, 0.3)))


def saved(folder, *objects, floors_m=(0.0,)):
    made = create_map_folder(folder, config={}, source={}, overwrite=False)
    for item in objects:
        if item.shape is not None:
            half = item.shape.inflated
            low = (half.world_from_local[:, :3, 3] - half.semi_axes_m).min(axis=0)
            high = (half.world_from_local[:, :3, 3] + half.semi_axes_m).max(axis=0)
            write_glb(box_mesh(tuple(high - low), (120, 90, 60)), made.shapes / item.shape.mesh_name)
    room = snapshot(*objects)
    submaps = [
        replace(room.submaps[0], id=i, world_from_submap=placed(0.0, 0.0, z_m)) for i, z_m in enumerate(floors_m)
    ]
    made.save(replace(room, submaps=tuple(submaps)))
    made.finish(finished_cleanly=True)
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return saved(tmp_path_factory.mktemp("maps") / "room.map", tracked(1, table()), tracked(2, CRATE))


def told(capsys):
    return json.loads(capsys.readouterr().out)


def test_plan_prints_the_path_and_draws_it(folder, tmp_path, capsys):
    command = ["plan", str(folder), "--start", "0.7,0.6", "--goal", "5.3,3.4", "--robot", "point"]
    assert main([*command, "--json", "-o", str(tmp_path / "plan.png")]) == 0
    found = told(capsys)
    assert found["found"] is True
    assert found["points"][0] == [0.7, 0.6]
    assert found["objects_by_box"] == []
    picture = cv2.imread(str(tmp_path / "plan.png"))[..., ::-1].astype(int)
    # Path, start and goal are there in their colours.
    for color in ((28, 98, 196), (24, 140, 84), (206, 66, 40)):
        assert (np.abs(picture - color).max(axis=-1) <= 6).sum() > 50
    assert main([*command, "-o", str(tmp_path / "plan.rrd"), "--robot", "jackal", "--cell", "0.05"]) == 0
    assert (tmp_path / "plan.rrd").stat().st_size > 10_000
    assert "verified along the whole length for jackal" in capsys.readouterr().out


def test_plan_exits_with_3_without_a_path_and_2_on_bad_requests(folder, tmp_path, capsys):
    assert main(["plan", str(folder), "--start", "0.7,0.6", "--goal", "4.5,1.0", "--robot", "point", "--json"]) == 3
    assert told(capsys)["reason"] == "goal-in-collision"
    for arguments, complaint in (
        (["--start", "0.7,0.6", "--goal", "99,1"], "outside of the map"),
        (["--start", "nan,0.6", "--goal", "1,1"], "two finite numbers"),
        (["--start", "one", "--goal", "1,1"], "expected X,Y in metres"),
        (["--start", "1,1", "--goal", "2,1", "--robot", "rover"], "known are b2, go2, jackal, point"),
        (["--start", "1,1", "--goal", "2,1", "--cell", "0.0001"], "MiB, allowed are"),
        (["--start", "1,1", "--goal", "2,1", "-o", str(tmp_path / "plan.jpg")], "ends in .png or .rrd"),
    ):
        assert main(["plan", str(folder), "--robot", "point", *arguments]) == 2
        assert complaint in capsys.readouterr().err


def test_a_path_avoids_movable_things_where_it_can(tmp_path, capsys):
    made = saved(tmp_path / "map", tracked(4, boxes(((1.5, 2.6, 0.4), (0.25, 0.25, 0.4)))))
    digest = json.loads((made / "manifest.json").read_text())["digest"]
    known = Stationarity(digest=digest, counts={4: StayCount(moved=3.0)})
    (tmp_path / "known.json").write_bytes(write_stationarity(known))
    command = ["plan", str(made), "--start", "0.5,2.1", "--robot", "jackal", "--json"]
    knowing = [*command, "--stationarity", str(tmp_path / "known.json")]
    assert main([*command, "--goal", "2.4,2.1"]) == 0
    plain = told(capsys)
    assert main([*knowing, "--goal", "2.4,2.1"]) == 0
    wide = told(capsys)
    assert (plain["objects_movable"], wide["objects_movable"], wide["passes_movable"]) == ([], [4], [])
    assert wide["length_m"] > plain["length_m"] + 0.03
    # Right before the chair there is no room for a berth.
    assert main([*knowing, "--goal", "1.5,2.05"]) == 0
    assert told(capsys)["passes_movable"] == [4]
    assert main([*knowing[:-3], "--stationarity", str(tmp_path / "known.json"), "--goal", "1.5,2.05"]) == 0
    assert "the path passes near objects that tend to move: 4" in capsys.readouterr().out
    assert main([*knowing, "--goal", "2.4,2.1", "--berth", "-1"]) == 2
    assert "found --berth -1.0, expected 0 to 5 m" in capsys.readouterr().err


def test_coordinates_may_be_negative(folder, capsys):
    for start in ("-1,-1", "-1.5,2", "-.5,1", "-inf,0"):
        assert main(["plan", str(folder), "--start", start, "--goal", "5.3,3.4", "--robot", "point"]) == 2
        told = capsys.readouterr().err
        assert "outside of the map" in told or "two finite numbers" in told


def test_obstacles_at_start_or_goal_are_named_with_distances(folder, capsys):
    # The crate reaches from x = 4.1 to 4.9 m; the wall at x = 3 m has a door from y = 1.5 m on.
    for goal, blockers in (
        ("4.5,1.0", [{"object": 2, "distance_m": 0.0}]),
        ("4.0,1.0", [{"object": 2, "distance_m": 0.1}]),
        ("3.15,1.0", [{"object": None, "distance_m": 0.1}]),
    ):
        command = ["plan", str(folder), "--start", "0.7,0.6", "--goal", goal, "--robot", "point"]
        assert main([*command, "--json"]) == 3
        told_blockers = told(capsys)["blockers"]
        assert [blocker["object"] for blocker in told_blockers] == [blocker["object"] for blocker in blockers]
        apart_m = [blocker["distance_m"] for blocker in told_blockers]
        assert apart_m == pytest.approx([blocker["distance_m"] for blocker in blockers], abs=0.01)
    assert main(["plan", str(folder), "--start", "4.0,1.0", "--goal", "0.7,0.6", "--robot", "point"]) == 3
    assert "start-in-collision" in (text := capsys.readouterr().out)
    assert "object 2, 0.10 m away" in text


def test_objects_without_layer_4_are_named(tmp_path, capsys):
    bare = saved(tmp_path / "bare.map", tracked(7, table(), with_shape=False))
    assert main(["plan", str(bare), "--start", "0.7,0.6", "--goal", "5.3,3.4", "--robot", "point"]) == 0
    assert "1 objects have no layer 4, their boxes are avoided: 7" in capsys.readouterr().out


def two_storeys(folder):
    """The room twice, one above the other: the table is in the lower one, a crate in the upper one."""
    upper = boxes(((4.5, 1.0, 3.3), (0.4, 0.3, 0.3)))
    return saved(folder, tracked(1, table()), tracked(2, upper), floors_m=(0.0, 3.0))


def test_two_storeys_are_planned_on_the_named_or_goal_storey(tmp_path, capsys):
    house = str(two_storeys(tmp_path / "house.map"))
    across = ["plan", house, "--start", "0.7,0.6", "--goal", "4.5,1.0", "--robot", "point", "--json"]
    assert main(across) == 2
    assert "the map has 2 floors, at z = 0.00 and 3.00 m; choose one with --floor" in capsys.readouterr().err
    assert main([*across, "--floor", "0.2"]) == 0
    assert told(capsys)["floor_m"] == 0.0
    assert main([*across, "--floor", "3"]) == 3
    above = told(capsys)
    assert (above["floor_m"], [one["object"] for one in above["blockers"]]) == (3.0, [2])
    to_crate = ["plan", house, "--start", "0.7,0.6", "--goal", "object:2", "--robot", "point", "--json"]
    assert main(to_crate) == 0
    assert told(capsys)["floor_m"] == 3.0
    assert main([*to_crate, "--floor", "0"]) == 2
    assert "object 2 is on the floor at z = 3.00 m; choose that floor" in capsys.readouterr().err
    assert main([*across, "--floor", "1.5"]) == 2
    assert "no floor within 1 m of it: its floors are at z = 0.00 and 3.00 m" in capsys.readouterr().err


def test_a_storey_is_exported_and_drawn_alone(tmp_path, capsys):
    house = two_storeys(tmp_path / "house.map")
    assert main(["export", str(house), "--format", "mjcf", "-o", str(tmp_path / "x")]) == 2
    assert "choose one with --floor" in capsys.readouterr().err
    assert main(["export", str(house), "--format", "mjcf", "-o", str(tmp_path / "x"), "--floor", "3"]) == 0
    scene = (tmp_path / "x" / "scene.xml").read_text()
    assert "object-2" in scene
    assert "object-1" not in scene
    drawn = tmp_path / "upper.png"
    assert main(["render", str(house), "-o", str(drawn), "--size", "480x240", "--floor", "3"]) == 0
    assert main(["render", str(house), "-o", str(tmp_path / "all.png"), "--size", "480x240"]) == 0
    assert drawn.read_bytes() != (tmp_path / "all.png").read_bytes()


@pytest.mark.parametrize(("form", "made"), [("nav2", "room.pgm"), ("mjcf", "x/scene.xml"), ("urdf", "x/scene.urdf")])
def test_export_writes_what_the_formats_need(folder, tmp_path, form, made, capsys):
    out = tmp_path / ("room.yaml" if form == "nav2" else "x")
    assert main(["export", str(folder), "--format", form, "--robot", "point", "-o", str(out), "--json"]) == 0
    assert told(capsys)["objects"] == 2
    assert (tmp_path / made).stat().st_size > 1000


@pytest.mark.parametrize(
    ("command", "option"),
    [
        (("plan", "--start", "0.7,0.6", "--goal", "5.3,3.4"), "--robot"),
        (("export", "--format", "nav2"), "--robot"),
        (("play", "--viewer", "none", "--costmap", "costmap.mcap"), "--costmap-robot"),
    ],
)
def test_no_robot_is_taken_that_nobody_named(folder, demo_log, tmp_path, command, option, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    name, *arguments = command
    assert main([name, str(demo_log if name == "play" else folder), *arguments]) == 2
    expected = "a robot: b2, go2, jackal, point, spot"
    assert f"found no {option}, expected {expected}" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_low_posture_still_marks_what_the_tall_robot_hits():
    top = snapshot(tracked(1, boxes(((3.0, 2.0, 0.72), (0.6, 0.4, 0.03)))))
    low, high = (Posture(name=n, parts=(Part(low_m=0.05, high_m=z),)) for n, z in (("low", 0.3), ("high", 0.8)))
    cells = [
        (obstacle_grid(top, Robot(name="tall", postures=postures), cell_m=0.05).is_occupied()).sum()
        for postures in ((low,), (low, high), (high,))
    ]
    assert cells[0] < cells[1] == cells[2]


def test_paper_compares_obstacles_of_one_map(folder, tmp_path, capsys):
    truth = tmp_path / "truth"
    (truth / "meshes").mkdir(parents=True)
    write_glb(box_mesh((0.8, 0.6, 0.6), (90, 90, 90)), truth / "meshes/1.glb")
    write_glb(box_mesh((6.0, 4.0, 0.02), (90, 90, 90)), truth / "meshes/floor.glb")
    crate = TruthObject(
        id=1, kind="box", mesh="meshes/1.glb", world_from_object=placed(4.5, 1.0, 0.3), seen_fraction=1.0, frames=()
    )
    camera = Camera(width=8, height=8, fx=8.0, fy=8.0, cx=4.0, cy=4.0)
    record = truth_record(Truth(folder=truth, camera=camera, objects=(crate,), structure=(), frames=()))
    # A floor around the origin: the grid of the truth is the quarter of it that the room covers.
    record["structure"] = ["meshes/floor.glb"]
    (truth / "truth.json").write_text(json.dumps(record))
    command = ["navigation", str(folder), "--truth", str(truth), "--trials", "4", "--seeds", "1"]
    assert paper([*command, "--unknown", "free", "--cell", "0.06", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert [row["name"] for row in rows] == ["mesh-obb", "mesh-full", "layer-4"]
    assert all(row["pairs"] == 4 for row in rows)
    assert paper([*command, "--robot", "b2"]) == 2
    assert "is not round" in capsys.readouterr().err
