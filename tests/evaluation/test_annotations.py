import hashlib
import json
import shutil
import tomllib
from collections import Counter
import numpy as np
import pytest
from hickory_stream.errors import RecordingError
from hickory_stream.evaluation.data_sets import open_boxes, open_truth
from hickory_stream.evaluation.evaluate import true_mesh_world
from hickory_stream.evaluation.match import TrueBox, box_ious
from hickory_stream.evaluation.reach import depth_on_labels, depth_on_objects
from hickory_stream.evaluation.truth import frame_at, instances_of, load_truth, mesh_of, moved_mesh, truth_record
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.rigid import invert
from hickory_stream.map_folder.history.recorded import frame_indices
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.worlds.recording import make_recording
from players import open_source
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


POSE = [[1.0, 0.0, 0.0, 0.5], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
RECORD = {
    "format": 1,
    "camera": {"width": 64, "height": 48, "K": [[50.0, 0.0, 31.5], [0.0, 50.0, 23.5], [0.0, 0.0, 1.0]]},
    "objects": [
        {"id": 1, "kind": "mug", "mesh": "meshes/1.glb", "world_from_object": POSE, "seen_fraction": 0.4, "frames": [0]}
    ],
    "structure": ["meshes/floor.glb"],
    "frames": [{"index": 0, "stamp_ns": 10**18, "world_from_camera": POSE, "instances": "instances/000000.png"}],
}


def written(folder, record):
    (folder / "truth.json").write_text(record if isinstance(record, str) else json.dumps(record))
    return folder


def test_what_is_read_is_what_was_written(tmp_path):
    truth = load_truth(written(tmp_path, RECORD))
    assert truth_record(truth) == RECORD
    assert (truth.camera.width, truth.camera.fx, truth.camera.cy) == (64, 50.0, 23.5)
    assert truth.objects[0].world_from_object[0, 3] == 0.5


def test_a_folder_without_truth_is_refused_by_name(tmp_path):
    with pytest.raises(RecordingError, match=r"is no truth folder: it has no truth\.json"):
        load_truth(tmp_path)
    with pytest.raises(RecordingError, match="is no truth folder"):
        load_truth(tmp_path / "absent")


@pytest.mark.parametrize(("record", "message"), [
    ("{", "cannot be read as JSON"), ("[]", "format None; expected 1"),
    ({**RECORD, "format": 2}, "format 2; expected 1"),
    ({key: value for key, value in RECORD.items() if key != "frames"}, r"damaged \(KeyError\('frames'\)\)"),
    ({**RECORD, "camera": {"width": 64, "height": 48, "K": [1.0]}}, "damaged .*K has shape"),
    ({**RECORD, "frames": [{**RECORD["frames"][0], "world_from_camera": [[1.0]]}]}, "no rigid"),
])  # fmt: skip
def test_a_damaged_truth_says_what_is_wrong(tmp_path, record, message):
    with pytest.raises(RecordingError, match=message):
        load_truth(written(tmp_path, record))


def test_missing_meshes_and_images_are_named(tmp_path):
    truth = load_truth(written(tmp_path, RECORD))
    with pytest.raises(RecordingError, match=r"1\.glb cannot be read as a mesh"):
        mesh_of(truth, truth.objects[0])
    with pytest.raises(RecordingError, match=r"000000\.png holds nothing readable"):
        instances_of(truth, truth.frames[0])


def test_the_demo_is_a_furnished_room_seen_well(demo_truth, demo_log):
    truth = load_truth(demo_truth)
    assert len(truth.objects) >= 15
    assert len({item.kind for item in truth.objects}) >= 8
    assert np.mean([item.seen_fraction >= 0.3 for item in truth.objects]) >= 0.9
    assert len(truth.frames) >= 100
    assert (truth.frames[-1].stamp_ns - truth.frames[0].stamp_ns) / 1e9 > 19
    assert truth.camera.width >= 640
    size = demo_log.stat().st_size + sum(path.stat().st_size for path in demo_truth.rglob("*") if path.is_file())
    assert size <= 20_000_000


def test_the_manifest_has_the_checksum_of_the_demo(demo_log):
    manifest = tomllib.loads((demo_log.parent / "manifest.toml").read_text())
    entry = next(entry for entry in manifest["recording"] if entry["name"] == "demo")
    assert entry["sha256"] == hashlib.sha256(demo_log.read_bytes()).hexdigest()


def test_keyframes_count_where_the_log_has_depth_on_a_thing(short_map, short_log, demo_truth):
    saved, truth = open_map(short_map), load_truth(demo_truth)
    stamps = np.array([frame.stamp_ns for frame in truth.frames])
    least, most = Counter(), Counter()
    for frame in (one.decode() for one in open_source(str(short_log)).frames()):
        if frame.index in frame_indices(short_map)[0]:
            shown = instances_of(truth, truth.frames[frame_at(stamps, frame.stamp_ns)])
            cells = Counter((shown[frame.depth_m > 0]).tolist())
            least.update(i for i, px in cells.items() if px >= 12 * (frame.camera.width // 160) ** 2)
            most.update(i for i, px in cells.items() if px >= (frame.camera.width // 160) ** 2)
    boxes = {item.id: (gravity_aligned_box(true_mesh_world(truth, item).vertices, 0.01),) for item in truth.objects}
    found = depth_on_objects(saved, truth)
    in_boxes = depth_on_labels(saved, [TrueBox(id=i, kind="", counts=True, boxes=box) for i, box in boxes.items()])
    assert all(least[i] <= found[i] <= most[i] and least[i] <= in_boxes[i] for i in boxes)
    assert 0 < sum(found[i] >= 3 for i in boxes) < len(boxes)


def test_a_map_without_a_journal_does_not_know(short_map, demo_truth, tmp_path):
    shutil.copytree(short_map, tmp_path / "map", ignore=shutil.ignore_patterns("journal.mcap"))
    assert depth_on_objects(open_map(tmp_path / "map"), load_truth(demo_truth)) is None
