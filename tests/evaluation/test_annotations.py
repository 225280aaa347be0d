import json
import numpy as np
import pytest
from hickory_stream.errors import RecordingError
from hickory_stream.evaluation.data_sets import open_boxes, open_truth
from hickory_stream.evaluation.match import box_ious
from hickory_stream.evaluation.truth import instances_of, mesh_of, moved_mesh
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.rigid import invert
from hickory_stream.worlds.recording import make_recording
from tools.worlds.image_folders import annotate
from tools.worlds.recording_config import RecordingConfig

pytestmark = pytest.mark.timeout(90)


@pytest.fixture(scope="module", params=["bop", "scannet"])
def annotated(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp(request.param)
    config = RecordingConfig(layout=request.param, seconds=1.0, rate_hz=4.0, width=160, height=120)
    true = make_recording(config, folder, "log")
    annotate(request.param, folder / "log", true)
    return request.param, folder / "log", true


def middles(truth):
    meshes = [moved_mesh(mesh_of(truth, item), item.world_from_object) for item in truth.objects]
    return np.array([mesh.vertices.mean(axis=0) for mesh in meshes])


def test_objects_stand_where_they_are(annotated):
    layout, folder, true = annotated
    found = open_truth(folder)
    found_from_true = found.frames[0].world_from_camera @ invert(true.frames[0].world_from_camera)
    expected = middles(true)
    if layout == "bop":
        # Objects that no image shows have no pose there.
        expected = expected[[i for i, item in enumerate(true.objects) if item.frames]]
    expected = expected @ found_from_true[:3, :3].T + found_from_true[:3, 3]
    apart_m = np.linalg.norm(middles(found)[:, None] - expected, axis=2)
    assert len(found.objects) == len(expected)
    assert apart_m.min(axis=0).max() < 1e-3


def test_pixels_show_the_objects_that_they_show(annotated):
    layout, folder, true = annotated
    found = open_truth(folder)
    names = {}
    for frame, true_frame in zip(found.frames[:2], true.frames[:2], strict=True):
        shown, expected = instances_of(found, frame), instances_of(true, true_frame)
        assert (frame.camera.width, frame.camera.height) == (160, 120)
        both = (shown > 0) & (expected > 0)
        assert both.sum() > (0.999 if layout == "bop" else 0.8) * (expected > 0).sum() > 200
        for i in np.unique(shown[both]):
            ids, counts = np.unique(expected[both & (shown == i)], return_counts=True)
            assert counts.max() > 0.9 * counts.sum()
            assert names.setdefault(i, ids[counts.argmax()]) == ids[counts.argmax()]


def test_seen_fractions_are_about_those_of_the_recording(annotated):
    layout, folder, true = annotated
    found = open_truth(folder)
    fractions = sorted(item.seen_fraction for item in found.objects)[-8:]
    expected = sorted(item.seen_fraction for item in true.objects)[-8:]
    np.testing.assert_allclose(fractions, expected, atol=0.1)
    if layout == "scannet":
        assert {item.kind for item in found.objects} == {item.kind for item in true.objects}
        assert "wall" not in {item.kind for item in found.objects}
        assert len(found.structure) == len(true.structure)


def test_masks_may_be_missing(annotated):
    layout, folder, _ = annotated
    if layout != "bop":
        pytest.skip("of BOP only")
    found = open_truth(folder)
    exact = instances_of(found, found.frames[1])
    masks = folder / "test/000001/mask_visib"
    masks.rename(masks.with_name("elsewhere"))
    cast = instances_of(open_truth(folder), found.frames[1])
    masks.with_name("elsewhere").rename(masks)
    assert (cast == exact)[exact > 0].mean() > 0.8


def damaged(file, content, folder, message):
    whole = file.read_bytes()
    if content is None:
        file.unlink()
    else:
        file.write_bytes(content)
    try:
        with pytest.raises(RecordingError, match=message) as refused:
            truth = open_truth(folder)
            instances_of(truth, truth.frames[0])
        assert "\n" not in str(refused.value)
    finally:
        file.write_bytes(whole)


@pytest.mark.parametrize(
    "content",
    [None, b"", b"ply\nformat ascii 1.0\nelement vertex 3\n", b"\x00\xff" * 40],
    ids=["gone", "empty", "cut", "bytes"],
)
def test_damaged_annotations_are_refused_in_one_line(annotated, content):
    layout, folder, _ = annotated
    if layout == "bop":
        model = next(iter(sorted((folder / "models").glob("*.ply"))))
        damaged(model, content, folder, "has no obj_000001" if content is None else "cannot be read as a mesh")
        damaged(folder / "test/000001/scene_gt.json", content, folder, r"scene_gt\.json")
        mask = folder / "test/000001/mask_visib/000000_000000.png"
        damaged(mask, content, folder, r"000000_000000\.png is no mask of 160x120 pixels")
    else:
        for ending in ("_vh_clean_2.ply", "_vh_clean_2.0.010000.segs.json", ".aggregation.json"):
            damaged(folder / f"scene0000_00{ending}", content, folder, ending.split("_")[-1].replace(".", r"\."))


@pytest.fixture(scope="module")
def boxed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arkit")
    config = RecordingConfig(layout="arkit_scenes", seconds=0.5, rate_hz=4.0, width=80, height=60)
    true = make_recording(config, folder, "log")
    annotate("arkit_scenes", folder / "log", true)
    return folder / "log", true


def test_boxes_of_arkit_are_those_of_the_objects(boxed):
    folder, true = boxed
    file = folder / "log_3dod_annotation.json"
    whole = file.read_text()
    record = json.loads(whole)
    # A left-handed triple of axes is of the same box.
    axes = record["data"][0]["segments"]["obbAligned"]["normalizedAxes"]
    axes[0:3] = [-value for value in axes[0:3]]
    file.write_text(json.dumps(record))
    labels = open_boxes(folder)
    file.write_text(whole)
    assert [label.kind for label in labels] == [item.kind for item in true.objects]
    meshes = [moved_mesh(mesh_of(true, item), item.world_from_object) for item in true.objects]
    expected = [gravity_aligned_box(mesh.vertices, 0.005) for mesh in meshes]
    ious = box_ious(expected, [label.boxes[0] for label in labels])
    np.testing.assert_allclose(np.diag(ious), 1.0, atol=1e-6)


@pytest.mark.parametrize("content", ["", "[]", '{"data": []}', '{"data": [{"label": "x"}]}', '{"data": 3}'])
def test_damaged_boxes_of_arkit_are_refused_in_one_line(boxed, content):
    folder, _ = boxed
    file = folder / "log_3dod_annotation.json"
    whole = file.read_text()
    file.write_text(content)
    with pytest.raises(RecordingError, match=r"log_3dod_annotation\.json: .*; expected data with label") as refused:
        open_boxes(folder)
    file.write_text(whole)
    assert "\n" not in str(refused.value)


def test_a_folder_without_known_annotations_is_refused(tmp_path):
    with pytest.raises(RecordingError, match=r"is no truth folder: it has no truth\.json"):
        open_truth(tmp_path)
    (tmp_path / "rgb.txt").write_text("")
    (tmp_path / "depth.txt").write_text("")
    with pytest.raises(RecordingError):
        open_truth(tmp_path)
