import numpy as np
import pytest
from hickory_stream.geometry.rigid import from_rotation_translation, invert, rotation_of_vector, yaw_rotation
from hickory_stream.graph import factors
from hickory_stream.graph.config import GraphConfig
from hickory_stream.graph.gtsam_solver import sharper, smoothest, weights_of
from hickory_stream.graph.solve import solve
from tests.graph.graph_fixtures import solved_graph, walk

CONFIG = GraphConfig()


def test_covariance_of_odometry_grows_with_the_path_however_cut():
    short, long = factors.odometry_covariance(1.0, 0.0, CONFIG), factors.odometry_covariance(10.0, 0.0, CONFIG)
    assert (np.diag(long) > np.diag(short)).all()
    turned = factors.odometry_covariance(1.0, 3.0, CONFIG)
    assert turned[2, 2] > short[2, 2]
    assert turned[5, 5] == short[5, 5]
    whole, half = factors.odometry_covariance(30.0, 0.0, CONFIG), factors.odometry_covariance(15.0, 0.0, CONFIG)
    assert whole[3, 3] == pytest.approx(2 * half[3, 3], rel=0.1)


def test_odometry_is_wider_along_what_scans_left_open():
    plain = factors.odometry_covariance(5.0, 0.2, CONFIG)
    along = np.array([0.0, 0.0, 0.0, 0.6, 0.8, 0.0])
    wider = factors.odometry_covariance(5.0, 0.2, CONFIG, blind=5.0 * np.outer(along, along)) - plain
    assert along @ wider @ along == pytest.approx((factors.DEGENERATE_SHARE * 5.0) ** 2)
    assert np.abs(wider @ np.array([0.0, 0.0, 0.0, -0.8, 0.6, 0.0])).max() == pytest.approx(0.0, abs=1e-12)
    jumped = factors.odometry_covariance(5.0, 0.2, CONFIG, jump_m=29.0, jump_rad=2.9)
    assert np.sqrt(jumped[3, 3]) > 29.0
    assert np.sqrt(jumped[2, 2]) > 2.9


def test_the_covariance_of_an_alignment_becomes_that_of_an_edge():
    """By sampling: small motions as an alignment has them, seen as motions in the frame of the second node."""
    rng = np.random.default_rng(1)
    a_from_b = from_rotation_translation(yaw_rotation(0.7), np.array([2.0, -1.0, 0.3]))
    center_a = np.array([4.0, 1.0, 0.5])
    sigmas = np.array([0.001, 0.002, 0.004, 0.01, 0.02, 0.03])
    errors = []
    for turn_and_shift in rng.normal(0, sigmas, (4000, 6)):
        turn = rotation_of_vector(turn_and_shift[:3])
        moved = from_rotation_translation(turn, center_a - turn @ center_a + turn_and_shift[3:])
        error = invert(a_from_b) @ moved @ a_from_b
        skew = (error[:3, :3] - error[:3, :3].T) / 2
        errors.append([skew[2, 1], skew[0, 2], skew[1, 0], *error[:3, 3]])
    sampled = np.cov(np.array(errors).T)
    expected = factors.tangent_covariance(a_from_b, np.diag(sigmas**2), center_a)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs((sampled - expected) / scale).max() < 0.08


def edge(before, after):
    return factors.OdometryEdge(before=before, after=after, before_from_after=np.eye(4), covariance=np.eye(6))


def test_an_edge_that_is_none_is_refused():
    with pytest.raises(ValueError, match="earlier node to a later"):
        edge(2, 1)
    with pytest.raises(ValueError, match="positive definite"):
        factors.OdometryEdge(before=0, after=1, before_from_after=np.eye(4), covariance=np.zeros((6, 6)))
    with pytest.raises(ValueError, match="not rigid"):
        factors.OdometryEdge(before=0, after=1, before_from_after=2 * np.eye(4), covariance=np.eye(6))


def test_a_graph_whose_nodes_hang_on_nothing_is_refused():
    poses = np.array([np.eye(4)] * 3)
    with pytest.raises(ValueError, match="one odometry edge"):
        factors.PoseGraph(world_from_node=poses, odometry=(edge(0, 1),), loops=(), gravity_sigma_rad=0.02)
    with pytest.raises(ValueError, match="not finite"):
        factors.PoseGraph(world_from_node=np.full((1, 4, 4), np.nan), odometry=(), loops=(), gravity_sigma_rad=0.02)
    loop = factors.LoopEdge(
        id=0, earlier=0, later=3, earlier_from_later=np.eye(4), covariance=np.eye(6), method="surface", score=1.0,
        stamp_ns=0,
    )  # fmt: skip
    with pytest.raises(ValueError, match="not there"):
        factors.PoseGraph(
            world_from_node=poses, odometry=(edge(0, 1), edge(1, 2)), loops=(loop,), gravity_sigma_rad=0.02
        )


LIMIT = 16.0
CHI2 = np.array([0.0, 1.0, 15.0, 17.0, 400.0, 1e5])


def test_weights_go_from_all_a_little_to_those_of_the_limit():
    weights = weights_of(CHI2, LIMIT, smoothest(CHI2, LIMIT))
    assert (weights > 0).all()
    assert (np.diff(weights) <= 0).all()
    assert weights[-1] < 1e-3
    sharpness = smoothest(CHI2, LIMIT)
    for _ in range(60):
        sharpness = sharper(sharpness)
    assert weights_of(CHI2, LIMIT, sharpness).tolist() == [1, 1, 1, 0, 0, 0]


def test_residuals_within_half_the_limit_count_fully():
    chi2 = np.array([0.0, 3.0, 7.9])
    assert weights_of(chi2, LIMIT, smoothest(chi2, LIMIT)).tolist() == [1, 1, 1]
    assert weights_of(np.empty(0), LIMIT, smoothest(np.empty(0), LIMIT)).tolist() == []


def test_a_record_says_which_loops_are_believed_with_residuals():
    loops = solved_graph().loops
    wrong = walk().wrong
    assert [loop.status == "accepted" for loop in loops] == [loop.id not in wrong for loop in walk().graph.loops]
    assert loops[min(wrong)].status == "withdrawn"
    assert all((loop.reason == "") == (loop.status == "accepted") for loop in loops)
    assert max(loop.residual_m for loop in loops if loop.status == "accepted") < 0.2
    assert min(loop.residual_m + loop.residual_rad for loop in loops if loop.status != "accepted") > 0.5


def test_a_node_has_both_places_and_its_uncertainty():
    nodes = solved_graph().nodes
    assert (nodes[0].place == nodes[0].uncorrected).all()
    assert nodes[0].sigma_m < 1e-3 < nodes[1].sigma_m < nodes[9].sigma_m
    assert nodes[9].covariance_xy.trace() < nodes[9].sigma_m ** 2
    answer = solve(walk().graph)
    assert (nodes[20].place == answer.world_from_node[20]).all()
    assert [edge.later for edge in solved_graph().edges if edge.kind == "odometry"] == list(range(1, 60))
