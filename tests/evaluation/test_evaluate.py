import json
from dataclasses import replace
from typing import Any, cast
import cv2
import numpy as np
import pytest
from hickory_stream.cli import main
from hickory_stream.errors import RecordingError
from hickory_stream.evaluation.evaluate import evaluate
from hickory_stream.evaluation.explain import format_evaluation, verdict, worst_first
from hickory_stream.evaluation.page import write_page
from hickory_stream.evaluation.placement import placed_truth
from hickory_stream.evaluation.truth import Truth, TruthFrame, TruthObject, load_truth, structure_meshes, truth_record
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.mesh import write_glb
from hickory_stream.geometry.rigid import from_rotation_translation, yaw_rotation
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.map_folder.views import write_crop
from hickory_stream.map_folder.writer import create_map_folder
from hickory_stream.ports import Crop
from hickory_stream.records import MapSnapshot
from tests.engine.snapshot_fixtures import box_mesh, make_object, make_shape, placed
from tests.mapping.mapping_fixtures import view

CAMERA = Camera(width=64, height=48, fx=60.0, fy=60.0, cx=31.5, cy=23.5)
STAMP_NS = 1_000_000_000
SIDES = (0.4, 0.4, 0.4)
# From x = -2, looking along +x: camera x is -y of the world, camera y is down.
LOOKING_ALONG_X = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
EYE = np.array([-2.0, 0.0, 0.2])
POSE = from_rotation_translation(LOOKING_ALONG_X, EYE)


def truth_in(folder, *, stamp_ns=STAMP_NS, poses=(POSE,), structure=()):
    """A cube of 40 cm at the origin, seen by cameras whose images show its front face, and nothing else."""
    for part in ("meshes", "instances"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    write_glb(box_mesh(SIDES, (90, 120, 90)), folder / "meshes/1.glb")
    write_glb(box_mesh((6.0, 6.0, 0.1), (90, 120, 90)), folder / "meshes/floor.glb")
    instances = np.zeros((48, 64), dtype=np.uint16)
    # The front face is 1.8 m away: 40 cm are 13.3 pixels.
    instances[17:31, 25:39] = 1
    cv2.imwrite(str(folder / "instances/0.png"), instances)
    item = TruthObject(
        id=1, kind="cube", mesh="meshes/1.glb", world_from_object=placed(0.0, 0.0, 0.2), seen_fraction=0.5,
        frames=tuple(range(len(poses))),
    )  # fmt: skip
    frames = tuple(
        TruthFrame(index=i, stamp_ns=stamp_ns * (i + 1), world_from_camera=pose, instances="instances/0.png")
        for i, pose in enumerate(poses)
    )
    truth = Truth(folder=folder, camera=CAMERA, objects=(item,), structure=structure, frames=frames)
    (folder / "truth.json").write_text(json.dumps(truth_record(truth)))
    return load_truth(folder)


def kept_view(index, world_from_camera):
    """A kept view of the cube, taken with the truth's frame of that number."""
    known = replace(view(index, score=0.1), stamp_ns=STAMP_NS * (index + 1), box_px=(25, 17, 39, 31))
    return replace(known, world_from_camera=world_from_camera)


def map_in(folder, *, map_from_world=None, poses=(POSE,), with_shape=True, is_empty=False):
    """The cube as a map has it whose world is another one, with a kept view from each pose."""
    there = np.eye(4) if map_from_world is None else map_from_world
    made = create_map_folder(folder, config={}, source={}, overwrite=False)
    mesh, pose = box_mesh(SIDES, (90, 120, 90)), there @ placed(0.0, 0.0, 0.2)
    mask = np.zeros((18, 18), dtype=bool)
    mask[2:16, 2:16] = True
    views = [kept_view(i, there @ own) for i, own in enumerate(poses)]
    for kept in views:
        crop = Crop(
            rgb=np.full((18, 18, 3), 90, dtype=np.uint8), depth_m=np.full((18, 18), 1.8, dtype=np.float32), mask=mask,
            camera=CAMERA.cropped(23, 15, 41, 33), world_from_camera=kept.world_from_camera,
        )  # fmt: skip
        write_crop(made.views, kept.name, crop)
    shape = make_shape(mesh, pose, (0.2, 0.2, 0.2), revision=1)
    write_glb(mesh, made.shapes / shape.mesh_name)
    tracked = make_object(3, mesh, pose, shape=shape if with_shape else None, views=tuple(views))
    objects = () if is_empty else (tracked,)
    made.save(MapSnapshot(revision=1, stamp_ns=STAMP_NS, submaps=(), objects=objects))
    made.finish(finished_cleanly=True)
    return open_map(folder)


def test_a_true_map_scores_one_everywhere(tmp_path):
    found = evaluate(map_in(tmp_path / "map"), truth_in(tmp_path / "truth"))
    assert (found.recall_25, found.precision_50, found.tracks_per_object) == (1.0, 1.0, 1.0)
    assert (found.f1_5pct, found.f1_1cm, found.adds_05, found.containment) == (1.0, 1.0, 1.0, 1.0)
    assert found.mask_purity == 1.0
    assert found.poses.ate_m == pytest.approx(0.0, abs=1e-9)
    assert found.median_diameter_m == pytest.approx(0.4 * np.sqrt(3), rel=1e-5)


def test_only_samples_that_a_frame_shows_count_for_containment(tmp_path):
    # Layer 4 reaches 3 cm beyond the map's cube. Shifted by 5 cm away from the camera it leaves out the front face, and
    # that is all that was seen; shifted towards the camera it leaves out the back, which nobody saw.
    truth = truth_in(tmp_path / "truth")
    for name, shift_m, containment in (("away", 0.05, 0.0), ("towards", -0.05, 1.0)):
        shifted = map_in(tmp_path / name, map_from_world=placed(shift_m, 0.0, 0.0))
        found = evaluate(shifted, truth)
        assert found.containment == containment
        assert ("100.00% sticks out of layer 4" in verdict(found.objects[0])) == (containment == 0.0)


def test_a_map_without_layer_2_has_boxes_but_no_surfaces(tmp_path):
    found = evaluate(map_in(tmp_path / "map", with_shape=False), truth_in(tmp_path / "truth"))
    assert (found.recall_25, found.f1_5pct, found.adds_10, found.containment) == (1.0, 0.0, 0.0, None)
    assert "found, without a shape" not in format_evaluation(found)
    assert found.objects[0].add_s_m is None


def test_an_empty_map_scores_zero_rather_than_failing(tmp_path):
    found = evaluate(map_in(tmp_path / "map", is_empty=True), truth_in(tmp_path / "truth"))
    assert (found.recall_25, found.precision_25, found.f1_5pct, found.num_objects) == (0.0, 0.0, 0.0, 0)
    assert (found.poses, found.mask_purity, found.containment) == (None, None, None)


def test_the_page_shows_the_object_and_what_was_made_of_it(tmp_path):
    saved, truth = map_in(tmp_path / "map"), truth_in(tmp_path / "truth")
    write_page(tmp_path / "page.html", saved, truth, evaluate(saved, truth))
    page = (tmp_path / "page.html").read_text()
    for caption in ("best view", "true mesh", "2: mesh", "3: superquadrics", "4: inflated"):
        assert f"<figcaption>{caption}</figcaption>" in page
    assert "http" not in page  # it needs no network
    assert "No reasons for missed objects: " in page
    assert "the map keeps no history; play the log again" in page


def test_the_worst_comes_first(tmp_path):
    found = evaluate(map_in(tmp_path / "map"), truth_in(tmp_path / "truth"))
    good = found.objects[0]
    bad, missed = replace(good, truth_id=2, f1_5pct=0.4), replace(good, truth_id=3, f1_5pct=0.0, map_id=None)
    assert [row.truth_id for row in worst_first(replace(found, objects=(good, bad, missed)))] == [3, 2, 1]


def run(capsys, *arguments):
    return main(["evaluate", *map(str, arguments)]), capsys.readouterr().err


@pytest.mark.parametrize(("truth", "told"), [
    ({"stamp_ns": 77 * STAMP_NS}, "is not the truth of the log"),
    ({"poses": [placed(0.0, 9.0, 0.0) @ POSE]}, "the cameras are 9.0 m apart"),
])  # fmt: skip
def test_truth_of_another_log_is_refused(truth, told, tmp_path, capsys):
    map_in(tmp_path / "map")
    truth_in(tmp_path / "truth", **truth)
    status, message = run(capsys, tmp_path / "map", "--truth", tmp_path / "truth")
    assert status == 2
    assert told in message


@pytest.mark.parametrize("missing", ["meshes/1.glb", "instances/0.png", "truth.json"])
def test_truth_with_a_missing_file_is_named(missing, tmp_path, capsys):
    map_in(tmp_path / "map")
    truth_in(tmp_path / "truth")
    (tmp_path / "truth" / missing).unlink()
    status, message = run(capsys, tmp_path / "map", "--truth", tmp_path / "truth")
    assert status == 2
    assert missing in message


def test_the_definitions_need_no_map_and_a_comparison_needs_both(capsys):
    assert main(["evaluate", "--explain"]) == 0
    assert "at least 30 %" in capsys.readouterr().out
    status, message = run(capsys)
    assert status == 2
    assert "--truth" in message


def test_json_holds_the_figures_and_every_object(tmp_path, capsys):
    map_in(tmp_path / "map")
    truth_in(tmp_path / "truth")
    assert main(["evaluate", str(tmp_path / "map"), "--truth", str(tmp_path / "truth"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["recall_25"], found["objects"][0]["kind"], found["objects"][0]["map_id"]) == (1.0, "cube", 3)


NUM_POSES = 9
MOVED = from_rotation_translation(yaw_rotation(1.1), np.array([7.0, -3.0, 0.4]))


def pose(i):
    """A camera that walks past the box and turns."""
    return from_rotation_translation(
        yaw_rotation(0.06 * (i - 4)) @ LOOKING_ALONG_X, np.array([-2.0 + 0.02 * i, 0.15 * (i - 4), 0.2])
    )


POSES = [pose(i) for i in range(NUM_POSES)]


def views(map_from_world, numbers=range(NUM_POSES), drift_m=0.0):
    """The kept views of a map whose odometry has its own world, and drifts by `drift_m` a frame along x."""
    return [kept_view(i, placed(drift_m * i, 0.0, 0.0) @ map_from_world @ POSES[i]) for i in numbers]


def place(tmp_path, kept):
    tracked = make_object(3, box_mesh(SIDES, (90, 120, 90)), placed(0.0, 0.0, 0.2), views=tuple(kept))
    saved = _Map(MapSnapshot(revision=1, stamp_ns=1, submaps=(), objects=(tracked,)), tmp_path / "map")
    return placed_truth(cast("Any", saved), truth_in(tmp_path / "truth", poses=POSES, structure=("meshes/floor.glb",)))


class _Map:
    def __init__(self, snapshot, folder):
        self.snapshot = snapshot
        self.folder = folder


def test_a_map_in_its_own_world_scores_as_in_the_truths(tmp_path):
    truth = truth_in(tmp_path / "truth", poses=POSES, structure=("meshes/floor.glb",))
    same = evaluate(map_in(tmp_path / "same", poses=POSES), truth)
    saved = map_in(tmp_path / "moved", map_from_world=MOVED, poses=POSES)
    moved = evaluate(saved, truth)
    assert same.placement is None
    assert moved.placement.num_poses == NUM_POSES
    assert moved.placement.rest_m == pytest.approx(0.0, abs=1e-6)
    np.testing.assert_allclose(np.array(moved.placement.map_from_world), MOVED, atol=1e-6)
    for name in ("recall_50", "precision_50", "f1_5pct", "adds_05", "containment", "mask_purity"):
        assert getattr(moved, name) == pytest.approx(getattr(same, name), abs=0.01), name
    assert (moved.recall_50, moved.f1_5pct) == (1.0, 1.0)
    assert moved.poses.ate_m == pytest.approx(0.0, abs=1e-6)
    assert "truth was moved" in format_evaluation(moved)
    assert "by 7.63 m and 63.0 deg, from 9 poses" in format_evaluation(moved)
    assert "truth was moved" not in format_evaluation(same)
    write_page(tmp_path / "page.html", saved, truth, moved)
    assert "truth was moved" in (tmp_path / "page.html").read_text()


def test_the_command_says_it_as_json(tmp_path, capsys):
    map_in(tmp_path / "map", map_from_world=MOVED, poses=POSES)
    truth_in(tmp_path / "truth", poses=POSES, structure=("meshes/floor.glb",))
    assert main(["evaluate", str(tmp_path / "map"), "--truth", str(tmp_path / "truth"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["placement"]
    assert found["turned_deg"] == pytest.approx(np.rad2deg(1.1))
    assert len(found["map_from_world"]) == 4


def test_structure_moves_with_the_truth_despite_wrong_poses(tmp_path):
    kept = views(MOVED)
    for i in (1, 5):
        kept[i] = replace(kept[i], world_from_camera=placed(40.0, 2.0, 0.0))
    np.testing.assert_allclose(np.array(place(tmp_path, kept).placement.map_from_world), MOVED, atol=1e-6)
    found = place(tmp_path, views(MOVED))
    (floor,) = structure_meshes(found.truth)
    np.testing.assert_allclose(floor.vertices.mean(axis=0), MOVED[:3, 3], atol=1e-5)
    np.testing.assert_allclose(found.views[0].frame.world_from_camera, MOVED @ pose(0), atol=1e-6)


def test_drift_is_no_placement_and_is_left_in_a_moved_truth(tmp_path):
    found = place(tmp_path, views(np.eye(4), drift_m=0.03))
    assert found.placement is None
    np.testing.assert_array_equal(found.truth.objects[0].world_from_object, placed(0.0, 0.0, 0.2))
    assert 0.005 < place(tmp_path, views(MOVED, drift_m=0.01)).placement.rest_m < 0.05


def _other_walk(i):
    return from_rotation_translation(
        yaw_rotation(0.4 * i) @ LOOKING_ALONG_X, np.array([5.0 + np.sin(2.0 * i), 3.0 * np.cos(1.3 * i), 0.3])
    )


TILT = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6], [0.0, 0.6, 0.8]])


@pytest.mark.parametrize(
    ("poses", "complaint"),
    [
        ([_other_walk(i) for i in range(NUM_POSES)], "no rigid transform explains it"),
        ([pose(i) @ from_rotation_translation(TILT, np.zeros(3)) for i in range(NUM_POSES)], "37 deg"),  # of the camera
        ([MOVED @ pose(i) for i in range(3)], "of another world"),  # too few poses tell no transform
        (
            [from_rotation_translation(TILT, np.array([5.0, 0.0, 0.0])) @ pose(i) for i in range(NUM_POSES)],
            "tilted by 37 deg",
        ),  # its boxes would not be upright
    ],
)
def test_poses_that_no_placement_explains_are_refused(tmp_path, poses, complaint):
    kept = [replace(view, world_from_camera=there) for view, there in zip(views(np.eye(4)), poses, strict=False)]
    with pytest.raises(RecordingError, match=complaint):
        place(tmp_path, kept)
