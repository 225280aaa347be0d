from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.geometry.rigid import from_rotation_translation, invert, yaw_rotation
from hickory_stream.graph.config import GraphConfig
from hickory_stream.graph.factors import DEGENERATE_SHARE, FLOOR_M
from hickory_stream.graph.solution import Solution
from hickory_stream.graph.solve import solve
from hickory_stream.loops.pose_graph import graph_record, is_correction, pose_graph, submap_places
from hickory_stream.records import Loop, SurveyedSubmap

CONFIG = GraphConfig()
NONE = np.empty((0, 3), np.float32)


def submap(submap_id, x_m, y_m, *, after_jump=False):
    return SurveyedSubmap(
        id=submap_id, world_from_submap=np.eye(4),
        anchor=from_rotation_translation(yaw_rotation(0.3 * submap_id), np.array([x_m, y_m, 1.0])), way_m=5.0,
        turn_rad=1.0, after_jump=after_jump, points=NONE, normals=NONE, free=np.empty(0, np.int64), voxel_m=0.05,
    )  # fmt: skip


WALK = [submap(i, x, y) for i, (x, y) in enumerate([(0, 0), (5, 0), (5, 5), (0, 5), (0.3, 0.1)])]
HOME = Loop(
    earlier=0, later=4, earlier_from_later=from_rotation_translation(np.eye(3), np.array([-0.25, -0.1, 0.0])),
    covariance=np.diag([1e-5] * 3 + [2e-4] * 3), method="surface", score=0.97,
)  # fmt: skip
STAMPS = [10 * i for i in range(5)]


def test_a_loop_bends_the_path_and_holds_in_the_places():
    solution = solve(pose_graph(WALK, [HOME], STAMPS, CONFIG), CONFIG)
    places = submap_places(WALK, solution.world_from_node, [np.eye(4)] * 5)
    assert solution.accepted == (0,)
    assert np.array_equal(places[0], np.eye(4))
    between = invert(places[0]) @ places[4]
    assert np.allclose(between, HOME.earlier_from_later, atol=0.03)
    moved_m = [
        float(np.linalg.norm((place @ s.anchor - s.anchor)[:3, 3])) for place, s in zip(places, WALK, strict=True)
    ]
    assert moved_m == sorted(moved_m)
    assert is_correction(WALK, places, [np.eye(4)] * 5)


def test_an_unbelieved_search_is_in_the_record_and_not_the_graph():
    other = replace(HOME, earlier=1, reason="it fits elsewhere nearby as well")
    graph = pose_graph(WALK, [other, HOME], STAMPS, CONFIG)
    assert [loop.id for loop in graph.loops] == [1]
    solution = solve(graph, CONFIG)
    assert isinstance(solution, Solution)
    record = graph_record(graph, solution, [other, HOME], STAMPS)
    assert [(edge.earlier, edge.status, edge.reason) for edge in record.loops] == [
        (0, "accepted", ""),
        (1, "rejected", "it fits elsewhere nearby as well"),
    ]


def test_submaps_that_hardly_move_against_each_other_stay_one():
    nodes = np.array([s.anchor for s in WALK])
    nodes[1, 0, 3] += 0.005
    nodes[2, 0, 3] += 0.5
    before = [from_rotation_translation(np.eye(3), np.array([9.0, 0.0, 0.0])), *[np.eye(4)] * 4]
    places = submap_places(WALK, nodes, [before[0]] * 5)
    assert places[4] is places[3]
    assert np.allclose(places[2][:3, 3], [0.5, 0, 0])
    assert np.allclose(places[1][:3, 3], [0.005, 0, 0])
    assert places[0] is places[1]
    stays = submap_places(WALK, nodes, before)
    assert [places is then for places, then in zip(stays, before, strict=True)] == [False, True, False, True, True]
    assert not is_correction(WALK, [places[4]] * 5, [np.eye(4)] * 5)


def test_a_common_move_is_none_and_a_jump_edge_gives_way():
    away = from_rotation_translation(yaw_rotation(1.0), np.array([3.0, 4.0, 0.0]))
    assert not is_correction(WALK, [away] * 5, [np.eye(4)] * 5)
    edges = pose_graph([*WALK[:2], replace(WALK[2], after_jump=True), *WALK[3:]], [], STAMPS, CONFIG).odometry
    assert [edge.is_jump for edge in edges] == [False, True, False, False]
    assert edges[1].covariance[3, 3] > 100 * edges[0].covariance[3, 3]


def test_a_registered_edge_is_as_sure_as_its_least_sure_keyframe():
    covariance = np.diag([1e-6, 1e-6, 1e-6, 4e-4, 1e-6, 1e-6])  # unsure along the map's x
    turned = replace(WALK[1], anchor=from_rotation_translation(yaw_rotation(np.pi / 2), np.array([5.0, 0.0, 1.0])))
    registered = [replace(WALK[0], registered=covariance), turned, *WALK[2:]]
    edges = pose_graph(registered, [], STAMPS, CONFIG).odometry
    by_way = pose_graph(WALK, [], STAMPS, CONFIG).odometry
    floor = FLOOR_M**2
    expected = [floor + 4e-6, floor + 16e-4, floor + 4e-6]  # the map's x is the next anchor's -y
    assert np.allclose(edges[0].covariance.diagonal()[3:], expected)
    assert np.array_equal(edges[1].covariance, by_way[1].covariance)
    wide = [replace(WALK[0], registered=np.eye(6)), *WALK[1:]]
    assert np.array_equal(pose_graph(wide, [], STAMPS, CONFIG).odometry[0].covariance, by_way[0].covariance)
    torn = [registered[0], replace(turned, after_jump=True), *WALK[2:]]
    assert pose_graph(torn, [], STAMPS, CONFIG).odometry[0].covariance[3, 3] > 100


def test_an_unregistered_direction_is_as_wide_as_odometry():
    covariance = np.eye(6) * 1e-6
    sure = [replace(WALK[0], registered=covariance), *WALK[1:]]
    half = np.zeros((6, 6))
    half[3, 3] = 0.5 * WALK[0].way_m  # along the map's x, for half of the way
    open_x = [replace(sure[0], unfixed=half), *WALK[1:]]
    narrow, wide, by_way = (pose_graph(each, [], STAMPS, CONFIG).odometry[0] for each in (sure, open_x, WALK))
    along = np.concatenate([np.zeros(3), WALK[1].anchor[:3, :3].T[:, 0]])
    across = np.concatenate([np.zeros(3), WALK[1].anchor[:3, :3].T[:, 1]])
    added = wide.covariance - narrow.covariance
    assert along @ added @ along == pytest.approx(0.5 * by_way.covariance[3, 3])
    assert across @ added @ across == pytest.approx(0.0, abs=1e-12)


def test_an_edge_is_wider_where_odometry_was_blind():
    blind = np.zeros((6, 6))
    blind[4, 4] = 4.0  # along the map's y, for four of five metres
    unseen = [replace(WALK[0], blind=blind), *WALK[1:]]
    plain, wide = (pose_graph(each, [], STAMPS, CONFIG).odometry[0].covariance for each in (WALK, unseen))
    along = np.concatenate([np.zeros(3), WALK[1].anchor[:3, :3].T[:, 1]])
    assert along @ (wide - plain) @ along == pytest.approx((DEGENERATE_SHARE * 4.0) ** 2)
    seen = [replace(unseen[0], registered=np.eye(6) * 1e-6), *WALK[1:]]
    assert (pose_graph(seen, [], STAMPS, CONFIG).odometry[0].covariance.diagonal() < plain.diagonal()).all()


def test_a_submap_without_a_keyframe_is_no_node():
    with pytest.raises(ValueError, match="anchor"):
        pose_graph([WALK[0], replace(WALK[1], anchor=np.eye(3))], [], STAMPS, CONFIG)
