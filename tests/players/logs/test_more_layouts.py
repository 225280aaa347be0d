import json
import numpy as np
import pytest
from hickory_stream.errors import CalibrationError, RecordingError
from hickory_stream.geometry.rigid import invert
from players import open_source
from players.poses.pose_file import read_pose_file
from tests import player_scenes as scenes

TRUTH = scenes.make_scene()
M = scenes.Messages(ros=2)
LOG = scenes.scene_messages(M, TRUTH, scenes.raw_images)


SHORT = {"w": "width", "h": "height", **{name: name for name in ("fx", "fy", "cx", "cy")}}


def _assert_scene(source):
    frames = [raw.decode() for raw in source.frames()]
    assert len(frames) == len(TRUTH)
    for frame, true in zip(frames, TRUTH, strict=True):
        np.testing.assert_array_equal(frame.rgb, true.rgb)
        np.testing.assert_allclose(frame.depth_m, true.depth_m, atol=1e-3)
        np.testing.assert_allclose(frame.world_from_camera, true.world_from_camera, atol=1e-3)


def _replica(folder):
    (folder / "results").mkdir(parents=True)
    values = {short: getattr(scenes.CAMERA, name) for short, name in SHORT.items()}
    (folder.parent / "cam_params.json").write_text(json.dumps({"camera": {**values, "scale": 6553.5}}))
    np.savetxt(folder / "traj.txt", [frame.world_from_camera.ravel() for frame in TRUTH])
    for i, frame in enumerate(TRUTH):
        scenes.write_png(folder / "results" / f"frame{i:06d}.png", frame.rgb[..., ::-1])
        units = np.round(frame.depth_mm * 6.5535).astype(np.uint16)
        scenes.write_png(folder / "results" / f"depth{i:06d}.png", units)
    return folder


def _hope(folder):
    folder.mkdir(parents=True)
    for i, frame in enumerate(TRUTH):
        camera_from_world = invert(frame.world_from_camera)
        camera = {"intrinsics": scenes.CAMERA.K.tolist(), "extrinsics": camera_from_world.tolist()}
        (folder / f"{i:04d}.json").write_text(json.dumps({"camera": camera, "objects": []}))
        scenes.write_png(folder / f"{i:04d}_rgb.png", frame.rgb[..., ::-1])
        scenes.write_png(folder / f"{i:04d}_depth.png", frame.depth_mm)
    return folder


@pytest.mark.parametrize(("write", "kind"), [(_replica, "Replica folder"), (_hope, "HOPE folder")])
def test_a_folder_of_a_data_set_is_the_scene(tmp_path, write, kind):
    source = open_source(write(tmp_path / "log"))
    assert source.info.kind == kind
    _assert_scene(source)


def test_a_hope_frame_without_its_json_or_camera_is_told(tmp_path):
    folder = _hope(tmp_path / "hope")
    (folder / "0002.json").unlink()
    source = open_source(folder)
    assert len(list(source.frames())) == len(TRUTH) - 1
    assert source.ledger()["no_pose"] == 1
    (folder / "0003.json").write_text("{}")
    with pytest.raises(CalibrationError, match=r"0003\.json: KeyError\('camera'\); expected camera\.intrinsics"):
        open_source(folder)


@pytest.mark.parametrize("mode", ["FILE", "MESSAGE"])
@pytest.mark.parametrize("has_metadata", [True, False])
def test_a_compressed_bag_is_the_scene(tmp_path, mode, has_metadata):
    scenes.write_ros2(tmp_path / "bag", M, LOG, compression=mode)
    if not has_metadata:
        (tmp_path / "bag" / "metadata.yaml").unlink()
    _assert_scene(open_source(tmp_path / "bag"))


def test_corrupt_metadata_does_no_harm(tmp_path):
    bag = scenes.write_ros2(tmp_path / "bag", M, LOG)
    for text in ("rosbag2_bagfile_inf", "rosbag2_bagfile_information:\n  relative_file_paths:\n    - gone_0.db3\n"):
        (bag / "metadata.yaml").write_text(text)
        _assert_scene(open_source(bag))


ROW = "0.5,-1,2,0,0,0.6,0.8"


@pytest.mark.parametrize(("text", "stamp_ns"), [
    ("1700000000.123456789 0.5 -1 2 0 0 0.6 0.8\n", 1_700_000_000_123_456_789),
    ("#timestamp_kf,x,y,z,qw,qx,qy,qz\n1700000000123456789,0.5,-1,2,0.8,0,0,0.6\n", 1_700_000_000_123_456_789),
    (f"timestamp [us],p_x,p_y,p_z,q_x,q_y,q_z,q_w\n1700000000123456,{ROW}\n", 1_700_000_000_123_456_000),
    (f"seq;t;tx;ty;tz;qx;qy;qz;qw\n7;12.5;{ROW.replace(',', ';')}\n", 12_500_000_000),
    ("x,y,z,qx,qy,qz,qw\n1,2,3,0,0,0,1\n", "t are missing"),
    ("nothing\n", "holds no pose"),
])  # fmt: skip
def test_pose_files_are_read_as_they_are_written_or_refused(tmp_path, text, stamp_ns):
    file = tmp_path / "poses.txt"
    file.write_text(text)
    if isinstance(stamp_ns, str):
        with pytest.raises(RecordingError, match=stamp_ns):
            read_pose_file(file, None)
    else:
        assert read_pose_file(file, None) == ([stamp_ns], [[0.5, -1.0, 2.0, 0.0, 0.0, 0.6, 0.8]])
