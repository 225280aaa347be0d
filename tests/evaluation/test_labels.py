import json
from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.errors import RecordingError
from hickory_stream.evaluation.labels import LABELS_FILE, load_labels, score_labels
from hickory_stream.geometry.boxes import box_iou
from hickory_stream.records import Phase
from tests.evaluation.test_match import SIDES, found, snapshot_of, unit_box

# The poses' world has y down.
UPRIGHT_FROM_WORLD = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


def label(label_id, x, sides=SIDES, **more):
    center = UPRIGHT_FROM_WORLD.T @ [x, 0.0, 0.3]
    return {
        "id": label_id,
        "name": f"box {label_id}",
        "center": center.tolist(),
        "size": list(sides),
        "yaw": 0.0,
        **more,
    }


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


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ("{", "is no file of labelled boxes: "),
        ({"format": 2, "objects": []}, "expected `format` 1 and a list `objects`"),
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
        (record({**label(1, 0.0), "id": "x"}), "`id`"),
        (record(3), r"objects\[0\]: expected keys and values"),
    ],
)
def test_a_damaged_file_of_labels_is_refused_in_a_line(tmp_path, content, complaint):
    with pytest.raises(RecordingError, match=complaint) as refused:
        load_labels(written(tmp_path, content))
    assert "\n" not in str(refused.value)


def test_labels_that_are_not_there_are_named(tmp_path):
    with pytest.raises(RecordingError, match=r"none\.json cannot be read"):
        load_labels(tmp_path / "none.json")
