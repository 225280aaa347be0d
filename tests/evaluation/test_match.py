import json
from dataclasses import replace
from itertools import permutations
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hickory_stream.errors import RecordingError
from hickory_stream.evaluation.labels import LABELS_FILE, load_labels, score_labels
from hickory_stream.evaluation.match import box_ious, match_boxes, score_map
from hickory_stream.evaluation.truth import Truth, TruthObject
from hickory_stream.geometry.boxes import OrientedBox, box_iou
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.mesh import write_glb
from hickory_stream.geometry.rigid import from_rotation_translation, yaw_rotation
from hickory_stream.records import MapSnapshot, ObjectKind, Phase
from tests.engine.snapshot_fixtures import box_mesh, make_object, make_shape, make_view, placed

SIDES = (0.5, 0.4, 0.6)


def unit_box(x):
    return OrientedBox(world_from_box=placed(x, 0.0, 0.0), half_extents_m=[0.5, 0.5, 0.5])


def true_object(folder, object_id, x, seen=0.9):
    (folder / "meshes").mkdir(exist_ok=True)
    write_glb(box_mesh(SIDES, (90, 90, 90)), folder / f"meshes/{object_id}.glb")
    return TruthObject(
        id=object_id, kind="box", mesh=f"meshes/{object_id}.glb", world_from_object=placed(x, 0.0, 0.3),
        seen_fraction=seen, frames=(0,),
    )  # fmt: skip


def truth_of(folder, *objects):
    camera = Camera(width=4, height=3, fx=4.0, fy=4.0, cx=1.5, cy=1.0)
    return Truth(folder=folder, camera=camera, objects=objects, structure=(), frames=())


def found(object_id, x, keep=slice(None)):
    """Return an object whose layer 1 lies on a true object at `x`, or on the part of it that `keep` chooses along x."""
    tracked = make_object(object_id, box_mesh(SIDES, (90, 90, 90)), placed(x, 0.0, 0.3))
    order = np.argsort(tracked.points_world[:, 0])[keep]
    return replace(tracked, points_world=tracked.points_world[order], colors=tracked.colors[order])


def snapshot_of(*objects):
    return MapSnapshot(revision=1, stamp_ns=0, submaps=(), objects=objects)


@given(
    truth=st.lists(st.floats(0, 2), max_size=3),
    objects=st.lists(st.floats(0, 2), max_size=3),
    min_iou=st.sampled_from([0.25, 0.5]),
)
@example(truth=[0.0, 0.4], objects=[0.15, -0.3], min_iou=0.25)  # the best pair first would leave one without any
def test_the_sum_of_ious_is_that_of_the_best_of_all_assignments(truth, objects, min_iou):
    truth_boxes, map_boxes = [unit_box(x) for x in truth], [unit_box(x) for x in objects]
    matches = match_boxes(truth_boxes, map_boxes, min_iou)
    assert len({match.map_index for match in matches}) == len({match.truth_index for match in matches}) == len(matches)
    assert all(match.iou >= min_iou for match in matches)

    def value(i, j):
        iou = box_iou(truth_boxes[i], map_boxes[j]) if j < len(map_boxes) else 0.0
        return iou if iou >= min_iou else 0.0

    places = range(len(map_boxes) + len(truth_boxes))
    best = max(sum(value(i, j) for i, j in enumerate(order)) for order in permutations(places, len(truth_boxes)))
    assert sum(match.iou for match in matches) == pytest.approx(best)


@given(seed=st.integers(0, 1000), turned=st.booleans())
def test_no_overlap_is_missed_by_comparing_bounds_first(seed, turned):
    rng = np.random.default_rng(seed)
    boxes = [
        OrientedBox(
            world_from_box=from_rotation_translation(yaw_rotation(turned * rng.uniform(0, 3)), rng.uniform(0, 3, 3)),
            half_extents_m=rng.uniform(0.1, 1.0, 3),
        )
        for _ in range(10)
    ]
    ours, theirs = boxes[:5], boxes[5:]
    assert np.array_equal(box_ious(ours, theirs), [[box_iou(a, b) for b in theirs] for a in ours])


def test_a_perfect_map_scores_one_and_an_empty_one_zero(tmp_path):
    truth = truth_of(tmp_path, true_object(tmp_path, 1, 0.0), true_object(tmp_path, 2, 1.0))
    score = score_map(snapshot_of(found(7, 0.0), found(8, 1.0)), {}, truth)
    assert (score.recall_25, score.recall_50, score.precision_25, score.precision_50) == (1.0, 1.0, 1.0, 1.0)
    assert score.tracks_per_object == 1.0
    assert [(row.truth_id, row.map_id, row.track_ids) for row in score.truth] == [(1, 7, (7,)), (2, 8, (8,))]
    score = score_map(snapshot_of(), {}, truth_of(tmp_path, true_object(tmp_path, 1, 0.0)))
    assert (score.recall_25, score.precision_25, score.tracks_per_object, score.num_truth) == (0.0, 0.0, 0.0, 1)


def test_an_object_in_two_pieces_counts_two_tracks_and_one_match(tmp_path):
    truth = truth_of(tmp_path, true_object(tmp_path, 1, 0.0), true_object(tmp_path, 2, 1.0))
    snapshot = snapshot_of(found(3, 0.0), found(4, 0.0, slice(300)), found(5, 1.0))
    score = score_map(snapshot, {}, truth)
    assert score.truth[0].track_ids == (3, 4)
    assert score.tracks_per_object == 1.5
    assert score.precision_25 == pytest.approx(2 / 3)


def test_truth_that_was_hardly_seen_is_ignored_on_both_sides(tmp_path):
    seen, hidden = true_object(tmp_path, 1, 0.0), true_object(tmp_path, 2, 1.0, seen=0.29)
    truth = truth_of(tmp_path, seen, hidden)
    for objects in ([found(3, 0.0)], [found(3, 0.0), found(4, 1.0)], [found(3, 0.0), found(4, 1.0, slice(200))]):
        score = score_map(snapshot_of(*objects), {}, truth)
        assert (score.num_truth, score.recall_25, score.precision_25) == (1, 1.0, 1.0)
        assert not score.truth[1].counts


def test_noise_of_far_views_leaves_an_object_on_its_thing(tmp_path):
    truth = truth_of(tmp_path, true_object(tmp_path, 1, 0.0), true_object(tmp_path, 2, 3.0, seen=0.1))
    noisy = found(4, 3.0, slice(200))
    noisy = replace(noisy, points_world=noisy.points_world - np.float32([0.1, 0, 0]))
    view = replace(make_view(4, 0, 0.0), world_from_camera=placed(-5.0, 0.0, 0.3))
    for views, on_it in (((), ()), ((view,), (4,))):
        score = score_map(snapshot_of(found(3, 0.0), replace(noisy, views=views)), {}, truth)
        assert score.truth[1].track_ids == on_it


def test_an_object_on_nothing_is_stray_unless_tentative(tmp_path):
    truth = truth_of(tmp_path, true_object(tmp_path, 1, 0.0))
    wrong = replace(found(5, 7.0), phase=Phase.DORMANT)
    early = replace(found(6, 9.0), phase=Phase.TENTATIVE)
    score = score_map(snapshot_of(found(3, 0.0), wrong, early), {}, truth)
    assert score.stray_ids == (5,)
    assert (score.num_objects, score.precision_25) == (2, 0.5)


def as_fixture(tracked):
    return replace(tracked, kind=ObjectKind.FIXTURE)


def test_a_fixture_is_a_thing_or_structure_or_false(tmp_path):
    truth = truth_of(tmp_path, true_object(tmp_path, 1, 0.0))
    write_glb(box_mesh((20.0, 0.1, 3.0), (90, 90, 90)), tmp_path / "wall.glb")
    truth = replace(truth, structure=("wall.glb",))
    thing, away = as_fixture(found(3, 0.0)), as_fixture(found(5, 7.0))
    # All of it within 3 cm of the wall's faces, which are 10 cm apart.
    beam = make_object(4, box_mesh((2.0, 0.1, 0.3), (90, 90, 90)), placed(5.0, 0.0, 1.0))
    score = score_map(snapshot_of(thing, as_fixture(beam), away), {}, truth)
    assert (score.recall_25, score.fixture_share, score.truth[0].is_fixture) == (1.0, 1.0, True)
    assert (score.structure_ids, score.precision_25, score.num_objects) == ((4,), 0.5, 3)
    as_object = score_map(snapshot_of(thing, beam, away), {}, truth)
    assert (as_object.structure_ids, as_object.precision_25) == ((), pytest.approx(1 / 3))


def test_what_is_out_of_reach_lowers_no_reachable_recall(tmp_path):
    truth = truth_of(tmp_path, true_object(tmp_path, 1, 0.0), true_object(tmp_path, 2, 2.0))
    score = score_map(snapshot_of(found(3, 0.0)), {}, truth, {1: 3, 2: 2})
    assert (score.recall_25, score.num_reachable, score.reachable_recall_25) == (0.5, 1, 1.0)
    unknown = score_map(snapshot_of(found(3, 0.0)), {}, truth)
    assert (unknown.num_reachable, unknown.reachable_recall_25, unknown.truth[0].is_reachable) == (None, None, None)
    assert score_map(snapshot_of(found(3, 0.0)), {}, truth, {}).reachable_recall_50 is None


def test_the_box_is_that_of_the_mesh_where_there_is_one(tmp_path):
    truth = truth_of(tmp_path, true_object(tmp_path, 1, 0.0))
    mesh = box_mesh(SIDES, (90, 90, 90))
    half = found(3, 0.0, slice(400))
    assert score_map(snapshot_of(half), {}, truth).recall_50 == 1.0  # its box is still the whole one
    shape = make_shape(mesh, placed(0.0, 0.0, 0.9), (0.25, 0.2, 0.3), revision=1)
    score = score_map(snapshot_of(replace(half, shape=shape)), {3: mesh}, truth)
    assert (score.recall_25, score.truth[0].map_id, score.truth[0].track_ids) == (0.0, None, (3,))


def test_truth_of_which_nothing_was_seen_is_refused(tmp_path):
    with pytest.raises(RecordingError, match="no object of which 30% was seen"):
        score_map(snapshot_of(), {}, truth_of(tmp_path, true_object(tmp_path, 1, 0.0, seen=0.1)))


# The poses' world has y down.
UPRIGHT_FROM_WORLD = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


def label(label_id, x, sides=SIDES, **more):
    center = UPRIGHT_FROM_WORLD.T @ [x, 0.0, 0.3]
    return {
        "id": label_id, "name": f"box {label_id}", "center": center.tolist(), "size": list(sides), "yaw": 0.0, **more,
    }  # fmt: skip


def record(*objects, **more):
    return {"format": 1, "upright_from_world": UPRIGHT_FROM_WORLD.tolist(), "objects": list(objects), **more}


def written(folder, content):
    (folder / LABELS_FILE).write_text(content if isinstance(content, str) else json.dumps(content))
    return folder


def scored(labels, *objects):
    return score_labels(snapshot_of(*objects), {}, labels)


def test_labels_give_recall_precision_and_what_is_ignored(tmp_path):
    content = record(label(1, 0.0), label(2, 2.0), label(3, 4.0, ignore=True), label(4, 6.0))
    early = replace(found(12, 6.0), phase=Phase.TENTATIVE)
    score = scored(load_labels(written(tmp_path, content)), found(9, 0.0), found(10, 4.0), found(11, 8.0), early)
    assert (score.num_truth, score.num_objects) == (3, 3)
    assert (score.recall_25, score.recall_50, score.precision_25) == pytest.approx((1 / 3, 1 / 3, 1 / 2))
    assert next((row.truth_id, row.kind, row.map_id) for row in score.truth if row.counts) == (1, "box 1", 9)
    assert (score.stray_ids, score.ignored_ids) == ((11,), (10,))


def test_the_whole_and_the_seen_part_are_both_right(tmp_path):
    half = {"seen_center": label(1, 0.0)["center"], "seen_size": list(SIDES)}
    content = record(label(1, 0.6, (1.7, *SIDES[1:]), **half))
    (row,) = scored(load_labels(written(tmp_path, content)), found(9, 0.0)).truth
    assert row.iou == pytest.approx(1.0, abs=0.05)


def test_what_stands_on_a_label_belongs_to_the_smaller_one(tmp_path):
    content = record(label(1, 0.0, (3.0, 3.0, 3.0)), label(2, 0.0))
    table, cup = scored(load_labels(written(tmp_path, content)), found(9, 0.0)).truth
    assert (table.track_ids, cup.track_ids) == ((), (9,))


def test_a_yaw_turns_from_the_x_axis_of_the_upright_world(tmp_path):
    content = record({**label(1, 0.0, (2.0, 1.0, 1.0)), "yaw": np.pi / 2})
    (made,) = load_labels(written(tmp_path, content) / LABELS_FILE)
    np.testing.assert_allclose(np.ptp(made.boxes[0].corners_world(), axis=0), (1.0, 2.0, 1.0), atol=1e-9)
    assert box_iou(made.boxes[0], unit_box(5.0)) == 0.0


@pytest.mark.parametrize(("content", "complaint"), [
    ("{", "is no file of labelled boxes: "), ({"format": 2, "objects": []}, "expected `format` 1 and a list `objects`"),
    ({"format": 1, "objects": []}, "found no `upright_from_world`, expected three rows of three numbers"),
    (record(label(1, 0.0), upright_from_world=[[2, 0, 0], [0, 1, 0], [0, 0, 1]]), "is no rotation"),
    (record(), "at least one of them without `ignore`"),
    (record(label(1, 0.0, ignore=True)), "at least one of them without `ignore`"),
    (record(label(1, 0.0), label(1, 2.0)), "needs objects of different `id`"),
    (record({"id": 1, "yaw": 0}), r"objects\[0\]: found no `center`, expected three numbers"),
    (record(label(1, 0.0), {**label(2, 0.0), "yaw": "left"}), r"objects\[1\]: found `yaw` left, expected a number"),
    (record({**label(1, 0.0), "size": [1, 2]}), r"objects\[0\]: found `size` \[1, 2\], expected three numbers"),
    (record({**label(1, 0.0), "size": [1, 0, 2]}), r"objects\[0\]: found `size` .*, expected lengths above 0"),
    (record({**label(1, 0.0), "seen_size": [1, 1, 1]}), "found no `seen_center`"),
    (record({**label(1, 0.0), "center": [1, 2, float("nan")]}), "found `center` "),
    (record({**label(1, 0.0), "id": "x"}), "`id`"), (record(3), r"objects\[0\]: expected keys and values"),
])  # fmt: skip
def test_a_damaged_file_of_labels_is_refused_in_a_line(tmp_path, content, complaint):
    with pytest.raises(RecordingError, match=complaint) as refused:
        load_labels(written(tmp_path, content))
    assert "\n" not in str(refused.value)


def test_labels_that_are_not_there_are_named(tmp_path):
    with pytest.raises(RecordingError, match=r"none\.json cannot be read"):
        load_labels(tmp_path / "none.json")
