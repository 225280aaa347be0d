import json
from dataclasses import replace
import cv2
import numpy as np
import pytest
from hickory_stream.changes.stationarity import Stationarity, StayCount, write_stationarity
from hickory_stream.evaluation.truth import Truth, TruthObject, load_truth, truth_record
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.mesh import write_glb
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.map_folder.writer import create_map_folder
from hickory_stream.navigation.free_space import obstacle_grid
from hickory_stream.navigation.robot import Part, Posture, Robot, load_robot
from tests.cli.test_cli import answer, refusal, said
from tests.engine.snapshot_fixtures import box_mesh, placed
from tests.navigation.rooms import boxes, snapshot, table, tracked
from tools.evaluation.navigation_table import score_saved_map

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


def asked(made, start, goal="5.3,3.4", robot="point"):
    return "plan", made, "--start", start, "--goal", goal, "--robot", robot


def test_plan_prints_the_path_and_draws_it(folder, tmp_path):
    found = answer(*asked(folder, "0.7,0.6"), "-o", tmp_path / "plan.png")
    assert (found["found"], found["points"][0], found["objects_by_box"]) == (True, [0.7, 0.6], [])
    picture = cv2.imread(str(tmp_path / "plan.png"))[..., ::-1].astype(int)
    # Path, start and goal are there in their colours.
    for color in ((28, 98, 196), (24, 140, 84), (206, 66, 40)):
        assert (np.abs(picture - color).max(axis=-1) <= 6).sum() > 50
    told = said(*asked(folder, "0.7,0.6", robot="jackal"), "-o", tmp_path / "plan.rrd", "--cell", "0.05")
    assert (tmp_path / "plan.rrd").stat().st_size > 10_000
    assert "verified along the whole length for jackal" in told


def test_plan_exits_with_2_on_bad_requests_and_takes_negatives(folder, tmp_path):
    for start, goal, more, complaint in (
        ("0.7,0.6", "99,1", (), "outside of the map"),
        ("nan,0.6", "1,1", (), "two finite numbers"),
        ("one", "1,1", (), "expected X,Y in metres"),
        ("1,1", "2,1", ("--robot", "rover"), "known are b2, go2, jackal, point"),
        ("1,1", "2,1", ("--cell", "0.0001"), "MiB, allowed are"),
        ("1,1", "2,1", ("-o", tmp_path / "plan.jpg"), "ends in .png or .rrd"),
        *((start, "5.3,3.4", (), "outside of the map") for start in ("-1,-1", "-1.5,2", "-.5,1")),
        ("-inf,0", "5.3,3.4", (), "two finite numbers"),
    ):
        assert complaint in refusal(*asked(folder, start, goal), *more)


def test_a_path_avoids_movable_things_where_it_can(tmp_path):
    made = saved(tmp_path / "map", tracked(4, boxes(((1.5, 2.6, 0.4), (0.25, 0.25, 0.4)))))
    digest = json.loads((made / "manifest.json").read_text())["digest"]
    known = Stationarity(digest=digest, counts={4: StayCount(moved=3.0)})
    (tmp_path / "known.json").write_bytes(write_stationarity(known))
    past, near = (asked(made, "0.5,2.1", goal, "jackal") for goal in ("2.4,2.1", "1.5,2.05"))
    knowing = ("--stationarity", tmp_path / "known.json")
    plain, wide = answer(*past), answer(*past, *knowing)
    assert (plain["objects_movable"], wide["objects_movable"], wide["passes_movable"]) == ([], [4], [])
    assert wide["length_m"] > plain["length_m"] + 0.03
    # Right before the chair there is no room for a berth.
    assert answer(*near, *knowing)["passes_movable"] == [4]
    assert "the path passes near objects that tend to move: 4" in said(*near, *knowing)
    assert "found --berth -1.0, expected 0 to 5 m" in refusal(*past, *knowing, "--berth", "-1")


@pytest.mark.parametrize(
    ("goal", "object_id", "distance_m"), [("4.5,1.0", 2, 0.0), ("4.0,1.0", 2, 0.1), ("3.15,1.0", None, 0.1)]
)
def test_obstacles_at_start_or_goal_are_named_with_distances(folder, goal, object_id, distance_m):
    # The crate reaches from x = 4.1 to 4.9 m; the wall at x = 3 m has a door from y = 1.5 m on.
    found = answer(*asked(folder, "0.7,0.6", goal), status=3)
    assert found["reason"] == "goal-in-collision"
    (blocker,) = found["blockers"]
    assert blocker["object"] == object_id
    assert blocker["distance_m"] == pytest.approx(distance_m, abs=0.01)
    if goal == "4.0,1.0":
        text = said(*asked(folder, goal, "0.7,0.6"), status=3)
        assert "start-in-collision" in text and "object 2, 0.10 m away" in text


def test_objects_without_layer_4_are_named(tmp_path):
    bare = saved(tmp_path / "bare.map", tracked(7, table(), with_shape=False))
    assert "1 objects have no layer 4, their boxes are avoided: 7" in said(*asked(bare, "0.7,0.6"))


def two_storeys(folder):
    """The room twice, one above the other: the table is in the lower one, a crate in the upper one."""
    upper = boxes(((4.5, 1.0, 3.3), (0.4, 0.3, 0.3)))
    return saved(folder, tracked(1, table()), tracked(2, upper), floors_m=(0.0, 3.0))


def test_two_storeys_are_planned_on_the_named_or_goal_storey(tmp_path):
    house = two_storeys(tmp_path / "house.map")
    across, to_crate = (asked(house, "0.7,0.6", goal) for goal in ("4.5,1.0", "object:2"))
    assert "the map has 2 floors, at z = 0.00 and 3.00 m; choose one with --floor" in refusal(*across)
    assert answer(*across, "--floor", "0.2")["floor_m"] == 0.0
    above = answer(*across, "--floor", "3", status=3)
    assert (above["floor_m"], [one["object"] for one in above["blockers"]]) == (3.0, [2])
    assert answer(*to_crate)["floor_m"] == 3.0
    assert "object 2 is on the floor at z = 3.00 m; choose that floor" in refusal(*to_crate, "--floor", "0")
    assert "no floor within 1 m of it: its floors are at z = 0.00 and 3.00 m" in refusal(*across, "--floor", "1.5")


def test_a_storey_is_exported_and_drawn_alone(tmp_path):
    house, drawn = two_storeys(tmp_path / "house.map"), tmp_path / "upper.png"
    export = ("export", house, "--format", "mjcf", "-o", tmp_path / "x")
    assert "choose one with --floor" in refusal(*export)
    said(*export, "--floor", "3")
    scene = (tmp_path / "x" / "scene.xml").read_text()
    assert "object-2" in scene and "object-1" not in scene
    said("render", house, "-o", drawn, "--size", "480x240", "--floor", "3")
    said("render", house, "-o", tmp_path / "all.png", "--size", "480x240")
    assert drawn.read_bytes() != (tmp_path / "all.png").read_bytes()


@pytest.mark.parametrize(("form", "made"), [("nav2", "room.pgm"), ("mjcf", "x/scene.xml"), ("urdf", "x/scene.urdf")])
def test_export_writes_what_the_formats_need(folder, tmp_path, form, made):
    out = tmp_path / ("room.yaml" if form == "nav2" else "x")
    assert answer("export", folder, "--format", form, "--robot", "point", "-o", out)["objects"] == 2
    assert (tmp_path / made).stat().st_size > 1000


@pytest.mark.parametrize(("command", "option"), [
    (("plan", "--start", "0.7,0.6", "--goal", "5.3,3.4"), "--robot"),
    (("export", "--format", "nav2"), "--robot"),
    (("play", "--viewer", "none", "--costmap", "costmap.mcap"), "--costmap-robot"),
])  # fmt: skip
def test_no_robot_is_taken_that_nobody_named(folder, demo_log, tmp_path, command, option, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name, *arguments = command
    refused = refusal(name, demo_log if name == "play" else folder, *arguments)
    assert f"found no {option}, expected a robot: b2, go2, jackal, point, spot" in refused
    assert list(tmp_path.iterdir()) == []


def test_a_low_posture_still_marks_what_the_tall_robot_hits():
    top = snapshot(tracked(1, boxes(((3.0, 2.0, 0.72), (0.6, 0.4, 0.03)))))
    low, high = (Posture(name=n, parts=(Part(low_m=0.05, high_m=z),)) for n, z in (("low", 0.3), ("high", 0.8)))
    cells = [
        (obstacle_grid(top, Robot(name="tall", postures=postures), cell_m=0.05).is_occupied()).sum()
        for postures in ((low,), (low, high), (high,))
    ]
    assert cells[0] < cells[1] == cells[2]


def test_obstacles_of_one_map_are_compared_with_truth(folder, tmp_path):
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
    rows = score_saved_map(
        open_map(folder), load_truth(truth), load_robot("point"), cell_m=0.06, unknown="free", trials=4, seeds=[0]
    )
    assert [row.name for row in rows] == ["mesh-obb", "mesh-full", "layer-4"]
    assert all(row.pairs == 4 for row in rows)
