import json
from dataclasses import replace
from typing import Any, cast
import cv2
import numpy as np
import pytest
from hickory_stream.cli import main
from hickory_stream.errors import RecordingError
from hickory_stream.evaluation.evaluate import evaluate
from hickory_stream.evaluation.explain import format_evaluation
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
from hickory_stream.records import MapSnapshot, View
from tests.engine.snapshot_fixtures import box_mesh, make_object, make_shape, placed

CAMERA = Camera(width=64, height=48, fx=60.0, fy=60.0, cx=31.5, cy=23.5)
SIDES = (0.4, 0.3, 0.5)
LOOKING_ALONG_X = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
NUM_POSES = 9
MOVED = from_rotation_translation(yaw_rotation(1.1), np.array([7.0, -3.0, 0.4]))
BOX_PX = (20, 10, 44, 38)


def pose(i):
    """A camera that walks past the box and turns."""
    return from_rotation_translation(
        yaw_rotation(0.06 * (i - 4)) @ LOOKING_ALONG_X, np.array([-2.0 + 0.02 * i, 0.15 * (i - 4), 0.3])
    )


def truth_in(folder):
    for part in ("meshes", "instances"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    write_glb(box_mesh(SIDES, (90, 120, 90)), folder / "meshes/1.glb")
    write_glb(box_mesh((6.0, 6.0, 0.1), (90, 120, 90)), folder / "meshes/floor.glb")
    instances = np.zeros((48, 64), dtype=np.uint16)
    instances[10:38, 20:44] = 1
    cv2.imwrite(str(folder / "instances/0.png"), instances)
    item = TruthObject(
        id=1, kind="cube", mesh="meshes/1.glb", world_from_object=placed(0.0, 0.0, 0.3), seen_fraction=0.5,
        frames=tuple(range(NUM_POSES)),
    )  # fmt: skip
    frames = tuple(
        TruthFrame(index=i, stamp_ns=10**9 * (i + 1), world_from_camera=pose(i), instances="instances/0.png")
        for i in range(NUM_POSES)
    )
    truth = Truth(folder=folder, camera=CAMERA, objects=(item,), structure=("meshes/floor.glb",), frames=frames)
    (folder / "truth.json").write_text(json.dumps(truth_record(truth)))
    return load_truth(folder)


def views(map_from_world, numbers=range(NUM_POSES), drift_m=0.0):
    """The kept views of a map whose odometry has its own world, and drifts by `drift_m` a frame along x."""
    found = []
    for i in numbers:
        there = map_from_world @ pose(i)
        there[0, 3] += drift_m * i
        found.append(
            View(
                object_id=1,
                frame_index=i,
                stamp_ns=10**9 * (i + 1),
                box_px=BOX_PX,
                world_from_camera=there,
                r_area=0.05,
                r_depth=0.9,
                box_volume_m3=0.06,
                score=0.1,
                variance=0.1,
                feature=None,
            )
        )
    return found


def map_in(folder, map_from_world):
    """The box as a map has it that is exact in its own world."""
    made = create_map_folder(folder, config={}, source={}, overwrite=False)
    mesh, there = box_mesh(SIDES, (90, 120, 90)), map_from_world @ placed(0.0, 0.0, 0.3)
    kept = views(map_from_world)
    for view in kept:
        x0, y0, x1, y1 = BOX_PX
        crop = Crop(
            rgb=np.full((y1 - y0, x1 - x0, 3), 90, dtype=np.uint8),
            depth_m=np.full((y1 - y0, x1 - x0), 1.8, dtype=np.float32),
            mask=np.ones((y1 - y0, x1 - x0), dtype=bool),
            camera=CAMERA.cropped(*BOX_PX),
            world_from_camera=view.world_from_camera,
        )
        write_crop(made.views, view.name, crop)
    shape = make_shape(mesh, there, (0.2, 0.2, 0.2), revision=1)
    write_glb(mesh, made.shapes / shape.mesh_name)
    tracked = make_object(3, mesh, there, shape=shape, views=tuple(kept))
    made.save(MapSnapshot(revision=1, stamp_ns=1, submaps=(), objects=(tracked,)))
    made.finish(finished_cleanly=True)
    return open_map(folder)


def place(tmp_path, kept):
    tracked = make_object(3, box_mesh(SIDES, (90, 120, 90)), placed(0.0, 0.0, 0.3), views=tuple(kept))
    saved = _Map(MapSnapshot(revision=1, stamp_ns=1, submaps=(), objects=(tracked,)), tmp_path / "map")
    return placed_truth(cast("Any", saved), truth_in(tmp_path / "truth"))


class _Map:
    def __init__(self, snapshot, folder):
        self.snapshot = snapshot
        self.folder = folder


def test_a_map_in_its_own_world_scores_as_in_the_truths(tmp_path):
    truth = truth_in(tmp_path / "truth")
    same = evaluate(map_in(tmp_path / "same", np.eye(4)), truth)
    saved = map_in(tmp_path / "moved", MOVED)
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
    map_in(tmp_path / "map", MOVED)
    truth_in(tmp_path / "truth")
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
    np.testing.assert_array_equal(found.truth.objects[0].world_from_object, placed(0.0, 0.0, 0.3))
    assert 0.005 < place(tmp_path, views(MOVED, drift_m=0.01)).placement.rest_m < 0.05


def _other_walk(i):
    return from_rotation_translation(
        yaw_rotation(0.4 * i) @ LOOKING_ALONG_X, np.array([5.0 + np.sin(2.0 * i), 3.0 * np.cos(1.3 * i), 0.3])
    )


def test_another_walk_at_the_same_stamps_is_refused(tmp_path):
    kept = [replace(view, world_from_camera=_other_walk(i)) for i, view in enumerate(views(np.eye(4)))]
    with pytest.raises(RecordingError, match="no rigid transform explains it"):
        place(tmp_path, kept)


def test_a_camera_with_another_heading_is_refused(tmp_path):
    pitched = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6], [0.0, 0.6, 0.8]])
    kept = [
        replace(view, world_from_camera=pose(i) @ from_rotation_translation(pitched, np.zeros(3)))
        for i, view in enumerate(views(np.eye(4)))
    ]
    with pytest.raises(RecordingError, match="37 deg"):
        place(tmp_path, kept)


def test_too_few_poses_tell_no_transform(tmp_path):
    with pytest.raises(RecordingError, match="of another world"):
        place(tmp_path, views(MOVED, range(3)))


def test_a_tilted_world_is_refused_for_its_boxes_are_upright(tmp_path):
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6], [0.0, 0.6, 0.8]])
    with pytest.raises(RecordingError, match="tilted by 37 deg"):
        place(tmp_path, views(from_rotation_translation(tilt, np.array([5.0, 0.0, 0.0]))))
