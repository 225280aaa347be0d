from dataclasses import replace
import cv2
import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rerun.chunk import RrdReader
from hickory_stream.alignment.align import align
from hickory_stream.alignment.object_map import object_map
from hickory_stream.geometry.rigid import invert
from hickory_stream.navigation.free_space import free_space_of
from hickory_stream.navigation.robot import load_robot
from hickory_stream.navigation.search import NoPath, NoPathReason, SearchConfig, plan
from hickory_stream.navigation.stand_ins import box_as_superquadric
from hickory_stream.records import Phase
from hickory_stream.sinks.rerun.alignment import write_alignment
from hickory_stream.sinks.rerun.config import RerunConfig
from hickory_stream.sinks.rerun.eye import MAIN_ASPECT, SIDE_ASPECT, eye_on
from hickory_stream.sinks.rerun.fleet import FleetRecording, ShownRobot, color_of_robot
from hickory_stream.sinks.rerun.labels import MEANINGS, label_size, label_threads
from hickory_stream.sinks.rerun.path import write_plan
from hickory_stream.sinks.rerun.sink import RerunSink, parse_viewer
from hickory_stream.sinks.rerun.viewer import ViewerChoice, ViewerKind
from tests.alignment.map_fixtures import frame, furniture, snapshot_of
from tests.navigation.rooms import snapshot, table, tracked
from tests.sinks.report_fixtures import reports


def arrangement_of(path):
    """Return by the name of a view what the last arrangement of a file says of it: entity below the view -> columns."""
    reader = RrdReader(path)
    stores = []
    for store in reader.blueprints():
        entities = {}
        sent_ns = 0
        for chunk in reader.stream(store=store):
            batch = chunk.to_record_batch()
            columns = {name: batch.column(name).to_pylist()[-1] for name in batch.schema.names if ":" in name}
            entities.setdefault(chunk.entity_path, {}).update(columns)
            if "log_time" in batch.schema.names:
                sent_ns = max(sent_ns, *batch.column("log_time").cast(pa.int64()).to_pylist())
        stores.append((sent_ns, entities))
    _, last = max(stores, key=lambda store: store[0])
    views = {path: columns for path, columns in last.items() if "ViewBlueprint:display_name" in columns}
    return {
        columns["ViewBlueprint:display_name"][0]: {
            path.removeprefix(f"{view}/"): columns for path, columns in last.items() if path.startswith(f"{view}/")
        }
        for view, columns in views.items()
    }


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arrangement")
    sink = RerunSink(RerunConfig(), folder, folder / "run.rrd", parse_viewer("none"))
    *_, last = (sink.show(report) or report for report in reports(9, folder, width=96))
    sink.close()
    return folder / "run.rrd", last.snapshot


@pytest.fixture(scope="module")
def views(played):
    return arrangement_of(played[0])


@pytest.fixture(scope="module")
def corners_of_the_map(played):
    return np.concatenate([o.box.corners_world() for o in played[1].objects if o.phase is not Phase.TENTATIVE])


MAPS = {
    "Layers 1 and 2: points, boxes, meshes": MAIN_ASPECT,
    "Layer 3: superquadrics": SIDE_ASPECT,
    "Layer 4: inflated, over the meshes": SIDE_ASPECT,
}


@pytest.mark.parametrize(("name", "aspect"), MAPS.items())
def test_the_map_fills_its_view_from_rim_to_rim(views, corners_of_the_map, name, aspect):
    eye = views[name]["EyeControls3D"]
    position, target = (np.array(eye[f"EyeControls3D:{end}"][0]) for end in ("position", "look_target"))
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, (0, 0, 1)) / np.linalg.norm(np.cross(forward, (0, 0, 1)))
    offsets = corners_of_the_map - position
    # The viewer's angle of view is 55 degrees from top to bottom.
    reach = np.column_stack([offsets @ right / aspect, offsets @ np.cross(right, forward)])
    shares = reach / (offsets @ forward)[:, None] / np.tan(np.deg2rad(27.5))
    assert np.abs(shares).max() <= 0.9 + 1e-6
    assert np.ptp(shares, axis=0).max() == pytest.approx(1.8, abs=0.01)


def test_filled_boxes_are_hidden_until_they_are_switched_on(views):
    main = views["Layers 1 and 2: points, boxes, meshes"]
    assert "+ world/filled/**" in main["ViewContents"]["ViewContents:query"]
    assert main["ViewContents/overrides/world/filled/visualizers"] == {"EntityBehavior:visible": [False]}
    assert not any(
        "filled" in query for name in list(MAPS)[1:] for query in views[name]["ViewContents"]["ViewContents:query"]
    )


def test_decisions_on_objects_come_first_and_scores_on_demand(views):
    names = ["Merges, drops, splits, confirmations", "All decisions, with scores of views", "Decisions by object"]
    levels = [views[name].get("TextLogRows", {}).get("TextLogRows:filter_by_log_level") for name in names]
    assert levels == [["WARN", "INFO"], None, None]


def test_a_legend_of_colours_is_beside_them(played, views):
    assert views["Legend"]["ViewContents"]["ViewContents:query"] == ["$origin/**"]
    (blob,) = [c.to_record_batch() for c in RrdReader(played[0]).stream() if c.entity_path == "/legend"]
    image = cv2.imdecode(np.array(blob.column("EncodedImage:blob").to_pylist()[0][0], np.uint8), cv2.IMREAD_COLOR)
    pixels = set(map(tuple, image[..., ::-1].reshape(-1, 3).tolist()))
    assert {color for _, color in MEANINGS} <= pixels


def test_all_best_views_lie_within_the_sheet_that_is_shown(views):
    shown = views["Best views"]["VisualBounds2D"]["VisualBounds2D:range"][0]
    assert shown["x_range"][0] == shown["y_range"][0] == 0.0
    assert shown["x_range"][1] >= 7 * 128
    assert shown["y_range"][1] >= 128


place = st.tuples(st.floats(-3, 3), st.floats(-3, 3), st.floats(0, 2))


@given(st.lists(place, min_size=1, max_size=20))
def test_labels_of_close_things_do_not_overlap_for_the_first_eye(places):
    tops = np.array(places)
    texts = [str(7 * i) for i in range(len(tops))]
    eye = eye_on(np.concatenate([tops, tops * (1, 1, 0)]), MAIN_ASPECT)
    threads = label_threads(tops, texts, eye)
    assert np.array_equal(threads[:, 0], tops)
    assert (np.diff(threads[:, :, 2], axis=1) > 0).all()
    bottom, top = eye.project(threads[:, 1]), eye.project(threads[:, 2])
    half = np.array([label_size(text)[0] for text in texts]) / 2
    for i in range(len(tops)):
        for j in range(i):
            is_beside = abs(top[i, 0] - top[j, 0]) >= 0.85 * (half[i] + half[j])
            high, low = max(top[i, 1], top[j, 1]), min(bottom[i, 1], bottom[j, 1])
            # A perspective is not quite linear in height: a fifth of a label is let through.
            assert is_beside or low - high < 0.2 * 0.036


NO_PATH = NoPath(reason=NoPathReason.UNREACHABLE, text="there is a wall")
START, GOAL = np.array([0.5, 0.5]), np.array([5.0, 3.0])


def static_of(path):
    """Return the columns of each entity that is logged regardless of time, and the names of the others."""
    found, moving = {}, set()
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        if chunk.is_static:
            names = [name for name in batch.schema.names if ":" in name]
            found.setdefault(chunk.entity_path, {}).update({name: batch.column(name).to_pylist()[-1] for name in names})
        else:
            moving.add(chunk.entity_path)
    return found, moving


def heights(vectors):
    return np.array(vectors)[..., 2]


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    path = tmp_path_factory.mktemp("plan") / "plan.rrd"
    room = snapshot(tracked(1, table()))
    space = free_space_of(room, load_robot("point"), cell_m=0.1, unknown="free")
    answer = plan(space, START, GOAL, SearchConfig(planner="rrt-connect"), np.random.default_rng(0))
    assert not isinstance(answer, NoPath)
    write_plan(path, room, space, answer, start=START, goal=GOAL)
    return path, space, answer


def test_a_plan_opens_in_one_view_that_looks_at_all_of_it(planned):
    view = arrangement_of(planned[0])["Plan"]
    assert view["ViewContents"]["ViewContents:query"] == ["+ /world/**"]
    assert {"EyeControls3D:position", "EyeControls3D:look_target"} <= view["EyeControls3D"].keys()


def test_cells_path_and_surfaces_have_heights_of_their_own(planned):
    path, space, answer = planned
    static, moving = static_of(path)
    cells = np.unique(heights(static["/world/grid/blocked"]["Mesh3D:vertex_positions"]))
    assert np.array_equal(cells, np.unique(heights(static["/world/grid/free"]["Mesh3D:vertex_positions"])))
    line = static["/world/path"]
    (strip,) = line["LineStrips3D:strips"]
    assert np.allclose(np.array(strip)[:, :2], answer.points, atol=1e-6)
    # Below the path's whole tube the floor, and below that the cells.
    assert heights(strip).min() - line["LineStrips3D:radii"][0] > space.floor_z_m + 0.02
    assert cells.max() < space.floor_z_m - 0.05
    surfaces = [c["Mesh3D:vertex_positions"] for name, c in static.items() if name.startswith("/world/layer4/")]
    assert surfaces
    assert min(heights(surface).min() for surface in surfaces) > cells.max() + 0.005
    assert moving == {"/world/robot", "/world/robot/posture"}
    assert static["/world/labels/1"]["Points3D:labels"] == ["1"]
    assert "/legend" in static


def test_the_tiles_of_a_plan_cover_the_grid_once(planned):
    path, space, _ = planned
    static, _ = static_of(path)
    area = 0.0
    for name in ("free", "blocked"):
        corners = np.array(static[f"/world/grid/{name}"]["Mesh3D:vertex_positions"]).reshape(-1, 4, 3)
        area += float(np.prod(corners[:, 2, :2] - corners[:, 0, :2], axis=1).sum())
    assert area == pytest.approx(space.frame.rows * space.frame.columns * space.frame.cell_m**2, rel=1e-4)


def test_a_plan_without_a_path_shows_start_and_goal(tmp_path, planned):
    write_plan(tmp_path / "none.rrd", snapshot(), planned[1], NO_PATH, start=START, goal=GOAL)
    static, moving = static_of(tmp_path / "none.rrd")
    assert static["/world/ends"]["Points3D:labels"] == ["start", "goal"]
    assert np.allclose(np.array(static["/world/ends"]["Points3D:positions"])[:, :2], [START, GOAL])
    assert "/world/path" not in static
    assert not moving


def solid(of):
    """Return a map whose objects have a layer 3: their boxes."""
    objects = object_map(of)
    return replace(objects, shapes=tuple(box_as_superquadric(box, 0.0) for box in objects.boxes))


@pytest.fixture(scope="module")
def maps():
    items = furniture(12, 1)
    return solid(snapshot_of(items, np.eye(4), 1)), solid(snapshot_of(items[:10], frame(35, 1, 2), 2))


def test_an_alignment_shows_the_maps_joined_and_apart(tmp_path, maps):
    answer = align(*maps)
    write_alignment(tmp_path / "join.rrd", *maps, answer)
    views = arrangement_of(tmp_path / "join.rrd")
    assert [view["ViewContents"]["ViewContents:query"] for _, view in sorted(views.items())] == [
        ["+ /world/joined/**"],
        ["$origin/**"],
        ["+ /world/apart/**"],
    ]
    static, _ = static_of(tmp_path / "join.rrd")
    alphas = {
        part: {
            c["Mesh3D:albedo_factor"][0] & 255
            for name, c in static.items()
            if name.startswith(f"/world/{part}/") and "Mesh3D:albedo_factor" in c
        }
        for part in ("joined", "apart")
    }
    assert alphas["apart"] == {255}
    assert max(alphas["joined"]) < 200
    labels = [c["Points3D:labels"][0] for name, c in static.items() if name.startswith("/world/apart/labels/")]
    assert sorted(labels) == sorted(f"a{pair.id_a} = b{pair.id_b}" for pair in answer.pairs)
    # Apart: the lowest of map b is above the highest of map a.
    ends = np.array(static["/world/apart/pairs"]["LineStrips3D:strips"])
    assert (ends[:, 1, 2] > ends[:, 0, 2].max()).all()


def test_maps_that_are_not_aligned_are_side_by_side(tmp_path, maps):
    other = solid(snapshot_of(furniture(12, 60), np.eye(4), 3))
    answer = align(maps[0], other)
    write_alignment(tmp_path / "none.rrd", maps[0], other, answer)
    assert arrangement_of(tmp_path / "none.rrd").keys() == {"Not aligned", "Legend"}
    static, _ = static_of(tmp_path / "none.rrd")
    right_of_a = max(reach_x(c).max() for name, c in static.items() if name.startswith("/world/a/"))
    assert right_of_a < max(reach_x(c).max() for name, c in static.items() if name.startswith("/world/b/"))


def reach_x(columns):
    return np.array(columns["Mesh3D:vertex_positions"])[..., 0]


FLEET_ITEMS = furniture(6, 7)
B_FROM_WORLD = frame(70, 2, -1)
NOWHERE = ViewerChoice(kind=ViewerKind.NONE)


def robot_shown(name, count, *, in_frame_of=None, poses=1):
    pose = np.eye(4) if name == "a" else B_FROM_WORLD
    return ShownRobot(
        name=name, stamp_ns=1_000 * count, objects=snapshot_of(FLEET_ITEMS[:count], pose).objects,
        world_from_camera=np.tile(np.eye(4), (poses, 1, 1)), frame=in_frame_of or name,
        frame_from_robot=np.eye(4) if in_frame_of is None else invert(B_FROM_WORLD),
    )  # fmt: skip


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Two robots that are joined in the second of two rounds, when b has lost its last object."""
    path = tmp_path_factory.mktemp("fleet") / "fleet.rrd"
    with FleetRecording(path, ["a", "b"], RerunConfig(), NOWHERE) as made:
        made.show(5, [robot_shown("a", 4), robot_shown("b", 4)], [])
        made.show(10, [robot_shown("a", 5), robot_shown("b", 3, in_frame_of="a", poses=2)], ["a and b are joined"])
    return path


@pytest.fixture(scope="module")
def columns(recording):
    found = {}
    for chunk in RrdReader(recording).stream():
        for name, values in chunk.to_record_batch().to_pydict().items():
            found.setdefault(chunk.entity_path, {}).setdefault(name, []).extend(values)
    return found


def test_a_robot_stands_apart_until_it_is_joined(columns):
    apart, joined = (np.ravel(place) for place in columns["/world/b"]["Transform3D:translation"])
    assert columns["/world/b"]["keyframe"] == [5, 10]
    reach_m = max(item.box.corners_world()[:, 0].max() for item in robot_shown("a", 4).objects)
    least_m = min(item.box.corners_world()[:, 0].min() for item in robot_shown("b", 4).objects)
    assert apart[0] + least_m > reach_m
    assert np.allclose(joined, invert(B_FROM_WORLD)[:3, 3], atol=1e-5)


def test_objects_hang_on_their_robot_and_go_when_they_are_gone(columns):
    assert {path for path in columns if path.startswith("/world/a/objects/")} == {
        f"/world/a/objects/{i}" for i in range(1, 6)
    }
    assert "Clear:is_recursive" in columns["/world/b/objects/4"]
    assert columns["/world/b/objects/1"]["keyframe"] == [5], "what looks the same is not logged again"


def test_paths_grow_and_labels_say_who_is_alone(columns):
    assert [len(line[0]) for line in columns["/world/b/path"]["LineStrips3D:strips"]] == [1, 3]
    assert columns["/world/b/robot"]["Points3D:labels"] == [["b, alone"], ["b"]]
    assert columns["/fleet/joins"]["TextLog:text"] == [["a and b are joined"]]
    assert columns["/plots/frames"]["Scalars:scalars"] == [[2.0], [1.0]]
    assert columns["/plots/frames"]["SeriesLines:interpolation_mode"] == [[2]], "a step, no slope"


def test_it_opens_with_the_end_and_with_all_there_was(recording):
    views = arrangement_of(recording)
    for name in ("Robots, a colour each, where they are in the end", "All frames beside one another"):
        assert {"EyeControls3D:position", "EyeControls3D:look_target"} <= views[name]["EyeControls3D"].keys()


def test_robots_of_a_fleet_have_colours_of_their_own():
    assert len({color_of_robot(i) for i in range(24)}) == 24


def test_nothing_is_left_of_the_recording_of_a_fleet_that_failed(tmp_path):
    path = tmp_path / "fleet.rrd"
    with pytest.raises(ValueError, match="no"), FleetRecording(path, ["a"], RerunConfig(), NOWHERE) as made:
        made.show(1, [robot_shown("a", 2)], [])
        raise ValueError("no")
    assert not path.exists()
