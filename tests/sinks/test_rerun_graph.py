from dataclasses import replace
import numpy as np
from hickory_stream.records import Submap
from hickory_stream.sinks.rerun.graph import GRAPH, GraphLines
from tests.graph.graph_fixtures import solved_graph
from tests.sinks.report_fixtures import KEYFRAME_EVERY, reports
from tests.sinks.test_rerun_sink import play

RECORD = solved_graph()


def keyframe(tmp_path):
    return next(report for report in reports(1, tmp_path, width=64) if report.snapshot is not None)


def with_graph(report, graph=RECORD, world_from_submap=None):
    if report.snapshot is None:
        return report
    first = report.snapshot.submaps[0]
    moved = Submap(
        id=0,
        world_from_submap=np.eye(4) if world_from_submap is None else world_from_submap,
        observed_space=first.observed_space,
    )
    return replace(report, snapshot=replace(report.snapshot, submaps=(moved,), graph=graph))


def archetypes(items, path):
    return next(item.archetypes[0] for item in items if item.path == path)


def test_a_graph_is_logged_only_when_there_is_a_new_one(tmp_path):
    lines, report = GraphLines(), keyframe(tmp_path)
    assert lines.items(with_graph(report, graph=None)) == []
    assert lines.items(with_graph(report))
    assert lines.items(with_graph(report)) == []


def test_believed_loops_have_scores_and_others_reasons(tmp_path):
    items = GraphLines().items(with_graph(keyframe(tmp_path)))
    believed = [loop for loop in RECORD.loops if loop.status == "accepted"]
    strips = archetypes(items, f"{GRAPH}/loops/accepted")
    assert strips.labels.as_arrow_array().to_pylist() == [f"{loop.score:.3g}" for loop in believed]
    refused = archetypes(items, f"{GRAPH}/loops/rejected").labels.as_arrow_array().to_pylist()
    rejected = [loop for loop in RECORD.loops if loop.status == "rejected"]
    assert [label for label in refused if label] == [f"{loop.score:.3g} {loop.reason}" for loop in rejected]
    assert len(refused) == 12 * len(rejected)


def test_many_loops_show_their_scores_on_hover_only(tmp_path):
    report = keyframe(tmp_path)
    one = next(loop for loop in RECORD.loops if loop.status == "accepted")
    for count, is_shown in ((1, True), (12, False)):
        graph = replace(RECORD, edges=(one,) * count)
        strips = archetypes(GraphLines().items(with_graph(report, graph=graph)), f"{GRAPH}/loops/accepted")
        assert strips.show_labels.as_arrow_array().to_pylist() == [is_shown]


def test_both_paths_are_drawn_odometry_and_corrected(tmp_path):
    shift = np.eye(4)
    shift[0, 3] = 2.0
    node = replace(RECORD.nodes[0], stamp_ns=0, place=shift, uncorrected=np.eye(4))
    graph = replace(RECORD, nodes=(node,), edges=())
    report = keyframe(tmp_path)
    # The engine hands out poses that are corrected as the open submap is.
    corrected = replace(report, world_from_camera=shift @ report.world_from_camera, frame=None)
    items = GraphLines().items(with_graph(corrected, graph=graph, world_from_submap=shift))
    ways = [
        np.array(archetypes(items, f"{GRAPH}/{name}").strips.as_arrow_array().to_pylist())[0, 0]
        for name in ("before", "after")
    ]
    assert np.allclose(ways[0], report.world_from_camera[:3, 3], atol=1e-6)
    assert np.allclose(ways[1] - ways[0], [2, 0, 0], atol=1e-6)


def test_a_recording_has_the_graph_and_its_numbers(tmp_path):
    from tests.sinks.test_rerun_sink import rows_of

    rows = rows_of(play(tmp_path, num_frames=2 * KEYFRAME_EVERY, change=with_graph))
    for name in ("before", "after", "submaps", "loops/accepted", "loops/rejected", "loops/withdrawn"):
        assert [row["keyframe"] for row in rows[f"/{GRAPH}/{name}"]] == [0]
    assert rows["/plots/graph/uncertainty_m"][0]["Scalars:scalars"] == [RECORD.nodes[-1].sigma_m]
    assert rows["/plots/graph/residual_m"][0]["Scalars:scalars"][0] < 0.2
