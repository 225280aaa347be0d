import json
from dataclasses import replace
import cv2
import numpy as np
import pytest
from hickory_stream.cli import main
from hickory_stream.evaluation.evaluate import evaluate
from hickory_stream.evaluation.explain import format_evaluation, worst_first
from hickory_stream.evaluation.page import write_page
from hickory_stream.evaluation.truth import Truth, TruthFrame, TruthObject, load_truth, truth_record
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.mesh import write_glb
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.map_folder.views import write_crop
from hickory_stream.map_folder.writer import create_map_folder
from hickory_stream.ports import Crop
from hickory_stream.records import MapSnapshot, View
from tests.engine.snapshot_fixtures import box_mesh, make_object, make_shape, placed

CAMERA = Camera(width=64, height=48, fx=60.0, fy=60.0, cx=31.5, cy=23.5)
STAMP_NS = 1_000_000_000
SIDES = (0.4, 0.4, 0.4)
# From x = -2, looking along +x: camera x is -y of the world, camera y is down.
LOOKING_ALONG_X = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
EYE = np.array([-2.0, 0.0, 0.2])


def truth_in(folder, *, stamp_ns=STAMP_NS, eye=EYE):
    """A cube of 40 cm at the origin, seen by one camera whose image shows its front face, and nothing else."""
    for part in ("meshes", "instances"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    write_glb(box_mesh(SIDES, (90, 120, 90)), folder / "meshes/1.glb")
    instances = np.zeros((48, 64), dtype=np.uint16)
    # The front face is 1.8 m away: 40 cm are 13.3 pixels.
    instances[17:31, 25:39] = 1
    cv2.imwrite(str(folder / "instances/0.png"), instances)
    item = TruthObject(
        id=1, kind="cube", mesh="meshes/1.glb", world_from_object=placed(0.0, 0.0, 0.2), seen_fraction=0.5, frames=(0,)
    )
    frame = TruthFrame(
        index=0,
        stamp_ns=stamp_ns,
        world_from_camera=from_rotation_translation(LOOKING_ALONG_X, eye),
        instances="instances/0.png",
    )
    truth = Truth(folder=folder, camera=CAMERA, objects=(item,), structure=(), frames=(frame,))
    (folder / "truth.json").write_text(json.dumps(truth_record(truth)))
    return load_truth(folder)


def map_in(folder, *, shift_m=0.0, with_shape=True, is_empty=False):
    """The cube as a map has it, `shift_m` along x, with one kept view."""
    made = create_map_folder(folder, config={}, source={}, overwrite=False)
    mesh, pose = box_mesh(SIDES, (90, 120, 90)), placed(shift_m, 0.0, 0.2)
    view = View(
        object_id=1, frame_index=0, stamp_ns=STAMP_NS, box_px=(25, 17, 39, 31),
        world_from_camera=from_rotation_translation(LOOKING_ALONG_X, EYE), r_area=0.05, r_depth=0.9, box_volume_m3=0.06,
        score=0.1, variance=0.1, feature=None,
    )  # fmt: skip
    mask = np.zeros((18, 18), dtype=bool)
    mask[2:16, 2:16] = True
    crop = Crop(
        rgb=np.full((18, 18, 3), 90, dtype=np.uint8), depth_m=np.full((18, 18), 1.8, dtype=np.float32), mask=mask,
        camera=CAMERA.cropped(23, 15, 41, 33), world_from_camera=view.world_from_camera,
    )  # fmt: skip
    write_crop(made.views, view.name, crop)
    shape = make_shape(mesh, pose, (0.2, 0.2, 0.2), revision=1)
    write_glb(mesh, made.shapes / shape.mesh_name)
    tracked = make_object(3, mesh, pose, shape=shape if with_shape else None, views=(view,))
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
    assert evaluate(map_in(tmp_path / "away", shift_m=0.05), truth).containment == 0.0
    assert evaluate(map_in(tmp_path / "towards", shift_m=-0.05), truth).containment == 1.0


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


@pytest.mark.parametrize(
    ("truth", "told"),
    [
        ({"stamp_ns": 77 * STAMP_NS}, "is not the truth of the log"),
        ({"eye": np.add(EYE, (0.0, 9.0, 0.0))}, "the cameras are 9.0 m apart"),
    ],
)
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
