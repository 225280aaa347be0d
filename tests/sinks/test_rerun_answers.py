from dataclasses import replace
import numpy as np
import pytest
from rerun.chunk import RrdReader
from hickory_stream.alignment.align import align
from hickory_stream.alignment.object_map import object_map
from hickory_stream.navigation.free_space import free_space_of
from hickory_stream.navigation.robot import load_robot
from hickory_stream.navigation.search import NoPath, NoPathReason, SearchConfig, plan
from hickory_stream.navigation.stand_ins import box_as_superquadric
from hickory_stream.sinks.rerun.alignment import write_alignment
from hickory_stream.sinks.rerun.path import write_plan
from tests.alignment.map_fixtures import frame, furniture, snapshot_of
from tests.navigation.rooms import snapshot, table, tracked
from tests.sinks.test_rerun_arrangement import arrangement_of

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
