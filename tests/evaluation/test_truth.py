import hashlib
import json
import tomllib
import numpy as np
import pytest
from hickory_stream.errors import RecordingError
from hickory_stream.evaluation.truth import instances_of, load_truth, mesh_of, truth_record

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


@pytest.mark.parametrize(
    ("record", "message"),
    [
        ("{", "cannot be read as JSON"),
        ("[]", "format None; expected 1"),
        ({**RECORD, "format": 2}, "format 2; expected 1"),
        ({key: value for key, value in RECORD.items() if key != "frames"}, r"damaged \(KeyError\('frames'\)\)"),
        ({**RECORD, "camera": {"width": 64, "height": 48, "K": [1.0]}}, "damaged .*K has shape"),
        ({**RECORD, "frames": [{**RECORD["frames"][0], "world_from_camera": [[1.0]]}]}, "no rigid"),
    ],
)
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
