from hickory_stream.graph.solve import solve
from tests.graph.graph_fixtures import solved_graph, walk


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
