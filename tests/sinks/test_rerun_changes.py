from dataclasses import replace
import numpy as np
from rerun.components import MeshFaceRendering
from hickory_stream.geometry.lazy_arrays import give_up
from hickory_stream.geometry.voxels import keys_of_cells
from hickory_stream.records import ObservedSpace, RejectedMask, SpaceObservation, Submap
from hickory_stream.sinks.rerun.frame import FeatureColors, rejected_items
from hickory_stream.sinks.rerun.graph import GRAPH, GraphLines
from hickory_stream.sinks.rerun.objects import ObjectLayers
from hickory_stream.sinks.rerun.structure import FLOOR, WALLS, Structure
from tests.engine.snapshot_fixtures import make_snapshot
from tests.graph.graph_fixtures import solved_graph
from tests.sinks.report_fixtures import KEYFRAME_EVERY, bare_report, reports
from tests.sinks.test_rerun_sink import play

SECOND_NS = 1_000_000_000


def unreadable(name):
    raise AssertionError(f"{name} was read")


def shown(folder, snapshot):
    layers = ObjectLayers(folder=folder, max_points=100, cloud_period_ns=SECOND_NS, texture_px=0)
    assert layers.update(snapshot.objects, 0)
    return layers


def test_objects_that_stay_the_same_are_not_looked_at(tmp_path):
    snapshot = make_snapshot()
    layers = shown(tmp_path, snapshot)
    for tracked in snapshot.objects:
        give_up(tracked, unreadable, "points_world", "colors")
    assert layers.update(snapshot.objects, 5 * SECOND_NS) == []
    assert layers.finish() == []


def test_a_cloud_that_grew_is_shown_once_its_time_has_come(tmp_path):
    snapshot = make_snapshot()
    layers = shown(tmp_path, snapshot)
    first, *others = snapshot.objects
    grown = replace(
        first,
        points_world=np.concatenate([first.points_world, first.points_world[:1]]),
        colors=np.concatenate([first.colors, first.colors[:1]]),
    )
    assert layers.update((grown, *others), SECOND_NS // 2) == []
    (item,) = layers.update((grown, *others), 2 * SECOND_NS)
    assert item.path.endswith(f"/{first.id}/points")
    # Another record with the same points is compared once, and then known.
    again = replace(grown)
    assert layers.update((again, *others), 4 * SECOND_NS) == []
    give_up(again, unreadable, "points_world", "colors")
    assert layers.update((again, *others), 6 * SECOND_NS) == []


def test_whoever_comes_late_is_shown_the_whole(tmp_path):
    snapshot = make_snapshot()
    paths = {item.path for item in shown(tmp_path, snapshot).update((), SECOND_NS)}
    assert {path.rpartition("/")[2] for path in paths} == {str(tracked.id) for tracked in snapshot.objects}


def test_structure_is_made_anew_of_submaps_that_changed_alone():
    snapshot = make_snapshot()
    structure = Structure()
    before = structure.items(snapshot)
    for submap in snapshot.submaps:
        give_up(submap.observed_space, unreadable, "free", "structure")
    assert not structure.grown(snapshot, None)
    (floor,) = structure.items(snapshot)
    assert [item.path for item in before] == [FLOOR, f"{WALLS}/0"]
    assert before[0].archetypes[0].positions.as_arrow_array() == floor.archetypes[0].positions.as_arrow_array()


def test_an_ended_submap_is_drawn_again_once_it_rests():
    snapshot = make_snapshot()
    ended, last = snapshot.submaps[0], replace(snapshot.submaps[0], id=1)
    structure = Structure()
    structure.items(replace(snapshot, submaps=(ended, last)))
    changed = replace(snapshot, submaps=(replace(ended, observed_space=replace(ended.observed_space)), last))
    drawn = [[item.path for item in structure.grown(changed, None)] for _ in range(60)]
    assert [(i, paths) for i, paths in enumerate(drawn, 1) if paths] == [
        (20, [FLOOR]), (40, [FLOOR, f"{WALLS}/0"]), (60, [FLOOR]),
    ]  # fmt: skip


def test_walls_and_floor_are_there_from_the_first_keyframe_on():
    wall = [(50, y, z) for y in range(20) for z in range(6, 30)]
    keys = np.sort(keys_of_cells(np.array(wall + [(x, y, 0) for x in range(50) for y in range(20)])))
    free = np.sort(keys_of_cells(np.array(wall) - (1, 0, 0)))
    seen = SpaceObservation(free_keys=free, structure_keys=keys, floor_z_m=0.02)
    nothing = ObservedSpace(voxel_m=0.05, free=np.empty(0, np.int64), structure=np.empty(0, np.int64), floor_z_m=None)
    first = make_snapshot()
    first = replace(first, submaps=(replace(first.submaps[0], observed_space=nothing),))
    known = replace(nothing, free=free, structure=keys, floor_z_m=0.02)
    second = replace(first, submaps=(replace(first.submaps[0], observed_space=known),))
    structure = Structure()
    for snapshot in (first, second):
        floor, walls = structure.grown(snapshot, seen)
        assert len(floor.archetypes[0].positions.as_arrow_array()) == 50 * 20
        (mesh,) = walls.archetypes
        # Only from where it was seen.
        assert set(map(tuple, mesh.vertex_normals.as_arrow_array().to_pylist())) == {(-1.0, 0.0, 0.0)}
        assert mesh.face_rendering.as_arrow_array().to_pylist() == [MeshFaceRendering.Front.value]
    assert not structure.grown(second, seen)
    few = replace(second, submaps=(replace(second.submaps[0], observed_space=replace(known, structure=keys[:-9])),))
    assert [bool(structure.grown(few, seen)) for _ in range(20)].index(True) == 17


REPORT = bare_report(keyframe_index=0)


def test_rejected_masks_are_shown_in_place_with_reasons():
    masked = RejectedMask(box_px=(2, 3, 6, 5), reason="too small", mask=np.array([[1, 0, 0, 1], [0, 0, 0, 1]], bool))
    boxed = RejectedMask(box_px=(10, 10, 20, 20), reason="3.2 m long: structure")
    image, boxes = rejected_items(replace(REPORT, rejected=(masked, boxed)))
    pixels = np.frombuffer(image.archetypes[0].buffer.as_arrow_array().flatten().to_numpy(), np.uint16).reshape(30, 40)
    assert sorted(zip(*np.nonzero(pixels), strict=True)) == [(3, 2), (3, 5), (4, 5)]
    assert boxes.archetypes[0].labels.as_arrow_array().to_pylist() == ["too small", "3.2 m long: structure"]


def test_a_keyframe_without_rejected_masks_empties_the_last_ones():
    _, boxes = rejected_items(REPORT)
    assert len(boxes.archetypes[0].centers.as_arrow_array()) == 0


def test_features_show_only_where_computed_and_keep_colors():
    colors, rng = FeatureColors(), np.random.default_rng(0)
    patches = rng.normal(0, 1, (3, 4, 8)).astype(np.float32)
    assert colors.items(REPORT) == []
    (first,) = colors.items(replace(REPORT, patches=patches))
    colors.items(replace(REPORT, patches=rng.normal(3, 1, (3, 4, 8)).astype(np.float32)))
    (again,) = colors.items(replace(REPORT, patches=patches))
    blobs = [item.archetypes[0].blob.as_arrow_array().to_pylist() for item in (first, again)]
    assert blobs[0] == blobs[1]


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
