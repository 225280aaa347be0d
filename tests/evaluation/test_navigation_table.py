import numpy as np
import pytest
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.navigation.observed import box_corners
from hickory_stream.navigation.occupancy import frame_around
from hickory_stream.navigation.robot import load_robot
from hickory_stream.navigation.search import SearchConfig, plan
from tests.engine.snapshot_fixtures import box_mesh
from tests.navigation.rooms import boxes
from tools.evaluation.navigation_table import (
    Obstacles,
    OptimalLengths,
    built,
    draw_pairs,
    format_table,
    table_of,
    triangles,
    true_scene,
)


def shifted(mesh, by):
    return Mesh(vertices=mesh.vertices + np.float32(by), faces=mesh.faces, colors=mesh.colors, is_seen=mesh.is_seen)


def test_the_shortest_path_avoids_touching_corners():
    frame = frame_around(np.zeros(2), np.array([8.0, 6.0]), 1.0)
    blocked = np.zeros(frame.shape, bool)
    blocked[1:5, 3:5] = True
    optimum = OptimalLengths(blocked, frame)
    start, goal = np.array([1.0, 3.0]), np.array([7.0, 3.0])
    # Over the two corners (3, 5), (5, 5), or those below at y = 1.
    assert optimum.length_m(start, goal) == pytest.approx(2 * np.hypot(2, 2) + 2)
    assert optimum.length_m(start, np.array([1.0, 5.5])) == pytest.approx(2.5)
    blocked[:, 3:5] = True
    assert np.isinf(OptimalLengths(blocked, frame).length_m(start, goal))
    diagonal = np.zeros((4, 4), bool)
    diagonal[[0, 1, 2, 3], [3, 2, 1, 0]] = True
    through = OptimalLengths(diagonal, frame_around(np.zeros(2), np.full(2, 4.0), 1.0))
    assert np.isinf(through.length_m(np.array([0.5, 0.5]), np.array([3.5, 3.5])))


def test_layer_four_finds_the_way_under_a_table_that_boxes_close():
    """A table that spans the room from wall to wall: under it is the only way."""
    robot, frame = load_robot("point"), frame_around(np.zeros(2), np.array([4.0, 1.2]), 0.04)
    low, high = np.array([[0, -0.1, 0], [0, 1.2, 0]]), np.array([[4, 0, 1], [4, 1.3, 1]])
    walls = box_corners(np.column_stack([low, high]))
    top = shifted(box_mesh((1.2, 1.2, 0.02), (120, 90, 60)), (2.0, 0.6, 0.7))
    legs = [shifted(box_mesh((0.05, 0.05, 0.7), (120, 90, 60)), (x, y, 0.35)) for x in (1.45, 2.55) for y in (0.1, 1.1)]
    vertices = np.concatenate([part.vertices for part in (top, *legs)])
    starts = np.cumsum([0, *(len(part.vertices) for part in (top, *legs))])[:-1]
    faces = np.concatenate([part.faces + start for part, start in zip((top, *legs), starts, strict=True)])
    colors = np.zeros((len(vertices), 3), np.uint8)
    mesh = Mesh(vertices=vertices, faces=faces.astype(np.int32), colors=colors, is_seen=np.ones(len(vertices), bool))
    grown = boxes(
        ((2.0, 0.6, 0.7), (0.66, 0.66, 0.04)),
        *(((x, y, 0.35), (0.05, 0.05, 0.4)) for x in (1.45, 2.55) for y in (0.1, 1.1)),
    )
    obstacles = Obstacles(load=lambda: {1: mesh}, inflated={1: grown}, walls=walls, unknown=np.empty((0, 8, 3)))
    answers = {}
    for name in ("mesh-obb", "mesh-full", "layer-4"):
        space = built(name, obstacles, robot, frame, floor_z_m=0.0, r_safe_m=0.02).space
        answers[name] = plan(space, np.array([0.5, 0.6]), np.array([3.5, 0.6]))
    assert answers["mesh-obb"].reason == "unreachable"
    for name in ("mesh-full", "layer-4"):
        assert answers[name].length_m == pytest.approx(3.0)


def test_the_table_counts_what_is_missed_lost_and_solved():
    robot, frame = load_robot("point"), frame_around(np.zeros(2), np.array([5.0, 4.0]), 0.05)
    mesh = shifted(box_mesh((0.6, 0.6, 0.8), (90, 90, 90)), (2.5, 2.0, 0.4))
    border = box_corners(
        np.array([[0, 0, 0, 5, 0.1, 1], [0, 3.9, 0, 5, 4, 1], [0, 0, 0, 0.1, 4, 1], [4.9, 0, 0, 5, 4, 1]], dtype=float)
    )
    scene = true_scene({1: triangles(mesh)}, [], robot, frame, floor_z_m=0.0, r_safe_m=0.02)
    pairs = draw_pairs(scene, 10, 3)
    assert np.array_equal(pairs, draw_pairs(scene, 10, 3))
    assert (np.linalg.norm(pairs[:, 1] - pairs[:, 0], axis=1) >= 1.0).all()
    holding = boxes(((2.5, 2.0, 0.4), (0.36, 0.36, 0.5)))
    rows = {}
    for name, inflated in (("holds", holding), ("nothing", boxes(((4.0, 3.0, 5.0), (0.1, 0.1, 0.1))))):
        obstacles = Obstacles(load=lambda: {1: mesh}, inflated={1: inflated}, walls=border, unknown=np.empty((0, 8, 3)))
        found = table_of(obstacles, scene, robot, r_safe_m=0.02, trials=10, seeds=[3], config=SearchConfig(attempts=2))
        assert [row.name for row in found] == ["mesh-obb", "mesh-full", "layer-4"]
        rows[name] = found
        assert "10 pairs" in format_table(found)
    full, holds, nothing = rows["holds"][1], rows["holds"][2], rows["nothing"][2]
    assert (full.missed_cells, holds.missed_cells) == (0, 0)
    # A box without anything around it: the border of its 0.84 x 0.84 m, 17 or 18 cells wide.
    assert nothing.missed_cells == pytest.approx(17.5**2 - 9**2, abs=60)
    assert full.over_optimum is not None
    assert 1.0 <= full.over_optimum < 1.05
    assert full.success <= 1.0
    assert nothing.free_space > holds.free_space
