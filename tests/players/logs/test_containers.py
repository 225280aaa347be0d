import json
import logging
import random
import shutil
import struct
import sys
import zipfile
import numpy as np
import pytest
from hickory_stream.errors import CalibrationError, HickoryError, RecordingError
from players import SourceOptions, open_source
from players.doctor.diagnosis import examine
from tests import player_scenes as scenes
from tools.worlds.container_layouts import COLOR_FROM_DEPTH, CONTAINER_LOGS, Record3dLog, SensLog, ViewerBag

TRUTH = scenes.make_scene()
POSED = ("scannet_sens", "record3d", "record3d_exr")


def _written(layout, folder):
    kind = CONTAINER_LOGS[layout]
    path = folder / f"log{kind.ending}"
    with kind(path, scenes.CAMERA, 95) as log:
        log.write_static(TRUTH[0].stamp_ns)
        for frame in TRUTH:
            log.write_pose(frame.stamp_ns, frame.world_from_camera, np.zeros(6))
            view = log.depth_view
            depth = scenes.cast(view.camera, frame.world_from_camera @ view.color_from_depth)[1]
            log.write_images(frame.stamp_ns, frame.rgb, np.where(depth < 3.5, depth, np.nan).astype(np.float32))
    return path


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    return {layout: _written(layout, tmp_path_factory.mktemp(layout)) for layout in CONTAINER_LOGS}


@pytest.fixture
def copied(logs, tmp_path):
    def copy(layout, change):
        path = tmp_path / logs[layout].name
        path.write_bytes(change(bytearray(logs[layout].read_bytes())))
        return path

    return copy


def _truth_of(layout):
    return [frame for i, frame in enumerate(TRUTH) if layout != "scannet_sens" or i != SensLog.lost]


@pytest.mark.parametrize("layout", POSED)
def test_poses_and_stamps_are_those_written(logs, layout):
    source, truth = open_source(logs[layout]), _truth_of(layout)
    frames = list(source.frames())
    assert len(frames) == len(truth) == source.ledger()["frames"]
    assert source.ledger().get("no_pose", 0) == len(TRUTH) - len(truth)
    assert source.account().as_dict()["difference"] == 0
    for frame, true in zip(frames, truth, strict=True):
        np.testing.assert_allclose(frame.world_from_camera, true.world_from_camera, atol=1e-5)
        start_ns = 0 if layout == "scannet_sens" else TRUTH[0].stamp_ns
        assert abs(frame.stamp_ns + start_ns - true.stamp_ns) < 1000


@pytest.mark.parametrize("layout", CONTAINER_LOGS)
def test_depth_in_metres_lies_on_colour(logs, layout):
    source = open_source(logs[layout])
    camera, expected = source.info.camera, scenes.CAMERA
    assert (camera.width, camera.height) == (expected.width, expected.height)
    np.testing.assert_allclose(camera.K, expected.K, rtol=1e-6)
    for raw, true in zip(source.frames(), _truth_of(layout), strict=True):
        frame = raw.decode()
        assert np.abs(frame.rgb.astype(int) - true.rgb).mean() < 4
        both = np.isfinite(frame.depth_m) & np.isfinite(true.depth_m)
        assert both.sum() > 0.6 * np.isfinite(true.depth_m).sum()
        error_m = (frame.depth_m - true.depth_m)[both]
        assert np.median(np.abs(error_m)) < 0.02  # of pixels twice as large on slanted surfaces
        assert abs(np.median(error_m)) < 0.012
    if layout == "scannet_sens":
        registration = source.content.frames[0].view.registration
        np.testing.assert_allclose(registration.color_from_depth, COLOR_FROM_DEPTH, atol=1e-6)
        assert registration.depth_camera.fx == pytest.approx(0.97 * scenes.CAMERA.fx)


def test_scannet_without_stamps_counts_frames(copied):
    def unset(data):
        at = data.index(struct.pack("<Q", TRUTH[2].stamp_ns // 1000))
        return data[:at] + bytes(16) + data[at + 16 :]

    frames = list(open_source(copied("scannet_sens", unset)).frames())
    assert [frame.stamp_ns for frame in frames[:3]] == [0, 33_333_333, 66_666_666]


def test_a_sens_that_is_cut_off_keeps_its_first_frames(copied):
    source = open_source(copied("scannet_sens", lambda data: data[: len(data) * 3 // 5]))
    assert 0 < len(list(source.frames())) < len(TRUTH) - 1
    account = source.account().as_dict()
    assert account["unreadable"] == 2 * source.ledger()["unreadable_frames"] > 0
    assert account["difference"] == 0
    assert "is cut off or damaged at byte" in account["damage"][0]


@pytest.mark.parametrize("count", [0, 2**63, 1_000_000])
def test_a_false_count_of_frames_costs_neither_frames_nor_memory(copied, count):
    at = 12 + len("StructureSensor") + 4 * 64 + 28
    path = copied("scannet_sens", lambda data: data[:at] + struct.pack("<Q", count) + data[at + 8 :])
    found = examine([path], SourceOptions())
    assert (found.frames["frames"], found.status) == (len(TRUTH) - 1, 3)
    if not count:
        source = open_source(path)
        assert len(list(source.frames())) == len(TRUTH) - 1
        assert source.account().as_dict()["damage"] == ["log.sens was not closed: it declares no frames, and has 6"]


def _flipped(place):
    def alter(data):
        data[place] ^= 0xFF
        return data

    return alter


def test_an_altered_image_of_any_container_is_unreadable(copied, logs, tmp_path):
    *_, last = open_source(copied("scannet_sens", _flipped(-20))).frames()  # within the last depth image
    with pytest.raises(RecordingError, match="depth of frame 5"):
        last.decode()
    with zipfile.ZipFile(logs["record3d"]) as archive:
        place = archive.getinfo("rgbd/2.depth").header_offset + 100
    source = open_source(copied("record3d", _flipped(place)))
    frames = list(source.frames())
    with pytest.raises(RecordingError, match=r"rgbd/2\.depth is damaged"):
        frames[2].decode()
    frames[3].decode()
    assert source.ledger() == {"frames": len(TRUTH), "unreadable_image": 1}
    folder = shutil.copytree(logs["record3d_exr"], tmp_path / "log")
    file = folder / "EXR_RGBD" / "depth" / "1.exr"
    file.write_bytes(file.read_bytes()[:-40])
    frames = list(open_source(folder).frames())
    with pytest.raises(RecordingError, match=r"1\.exr is no EXR image, or damaged"):
        frames[1].decode()
    frames[2].decode()


def test_depth_of_low_confidence_is_no_return(logs):
    depth_m = next(open_source(logs["record3d"]).frames()).decode().depth_m
    exported = next(open_source(logs["record3d_exr"]).frames()).decode().depth_m
    rows = 2 * Record3dLog.unsure_rows
    assert np.isnan(depth_m[: rows - 1]).all()
    assert np.isfinite(exported[: rows - 1]).any() or not np.isfinite(TRUTH[0].depth_m[: rows - 1]).any()
    np.testing.assert_array_equal(depth_m[rows + 1 :], exported[rows + 1 :])


def _with_metadata(path, to, **changes):
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(to, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            data = old.read(name)
            if name == "metadata":
                table = {**json.loads(data), **changes}
                data = json.dumps({key: value for key, value in table.items() if value is not None}).encode()
            new.writestr(name, data)
    return to


def test_metadata_of_an_r3d_may_lack_much_or_differ_by_frame(logs, tmp_path):
    def opened(options=None, **changes):
        return open_source(_with_metadata(logs["record3d"], tmp_path / "a.r3d", **changes), options)

    frames = list(opened(dw=None, dh=None, frameTimestamps=None, perFrameIntrinsicCoeffs=None).frames())
    whole = next(open_source(logs["record3d"]).frames())
    np.testing.assert_array_equal(frames[0].decode().depth_m, whole.decode().depth_m)
    assert frames[3].stamp_ns == 50_000_000
    source = opened(initPose=None)
    assert "level surfaces" in dict(source.info.streams)["up"]
    ups = [frame.world_from_camera[2, :3] for frame in source.frames()]
    np.testing.assert_allclose(ups, [frame.world_from_camera[2, :3] for frame in TRUTH], atol=0.02)
    coefficients = [[70 + i, 71 + i, 39.5, 29.5] for i in range(len(TRUTH))]
    frames = opened(perFrameIntrinsicCoeffs=coefficients).frames()
    assert [frame.camera.fx for frame in frames] == [70, 71, 72, 73, 74, 75]
    # A video of the front camera has no poses.
    with pytest.raises(RecordingError, match="found 6 no_pose"):
        opened(SourceOptions(odometry="topic"), poses=[[0, 0, 0, 1, 0, 0, 0]] * len(TRUTH))


def test_unpacked_r3d_and_png_depth_are_read_too(logs, tmp_path):
    with zipfile.ZipFile(logs["record3d"]) as archive:
        archive.extractall(tmp_path / "unpacked")
    packed, unpacked = (next(open_source(path).frames()) for path in (logs["record3d"], tmp_path / "unpacked"))
    np.testing.assert_array_equal(packed.decode().depth_m, unpacked.decode().depth_m)
    exported = tmp_path / "exported"
    for folder in ("rgb", "depth"):
        (exported / folder).mkdir(parents=True)
    source = logs["record3d_exr"] / "EXR_RGBD"
    (exported / "metadata.json").write_bytes((source / "metadata.json").read_bytes())
    (exported / "rgb" / "0.jpg").write_bytes((source / "rgb" / "0.jpg").read_bytes())
    scenes.write_png(exported / "depth" / "0.png", np.full((30, 40), 1500, dtype=np.uint16))
    assert np.nanmedian(next(open_source(exported).frames()).decode().depth_m) == pytest.approx(1.5)


@pytest.mark.parametrize(("changes", "message"), [
    ({"w": 10**9}, "images of 1000000000x60 pixels"),
    ({"dw": -4}, "images of -4x30 pixels"),
    ({"K": [1, 2]}, "IndexError"),
    ({"K": [0] * 9}, "fx is 0"),
    ({"poses": [[1, 2]]}, "expected JSON of Record3D"),
    ({"poses": "none"}, "expected JSON of Record3D"),
    ({"frameTimestamps": [float("inf")]}, "expected JSON of Record3D"),
    ({"fps": float("nan")}, "nan frames per second"),
])  # fmt: skip
def test_malformed_metadata_of_record3d_is_refused(logs, tmp_path, changes, message):
    path = _with_metadata(logs["record3d"], tmp_path / "a.r3d", **changes)
    with pytest.raises(CalibrationError, match=message):
        open_source(path)


def test_zips_r3d_without_an_end_and_without_lzfse_are_refused(logs, copied, tmp_path, monkeypatch):
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("notes.txt", "nothing")
    with pytest.raises(RecordingError, match=r"no metadata of Record3D; found notes\.txt"):
        open_source(tmp_path / "a.zip")
    with pytest.raises(RecordingError, match=r"without its directory.*copy it again"):
        open_source(copied("record3d", lambda data: data[: len(data) // 2]))
    monkeypatch.setitem(sys.modules, "lzfse", None)
    with pytest.raises(RecordingError, match=r"needs the package lzfse.*pip install lzfse, or export EXR \+ JPEG"):
        open_source(logs["record3d"])


def test_a_viewer_bag_brings_units_extrinsics_and_topics(logs, caplog):
    with caplog.at_level(logging.WARNING):
        source = open_source(logs["realsense_viewer"])
    assert "has no poses: odometry on its depth estimates them" in caplog.text
    setup = source.played.setup
    assert setup.depth_units_per_m == pytest.approx(1 / ViewerBag.unit_m)
    np.testing.assert_allclose(setup.registration.color_from_depth, COLOR_FROM_DEPTH, atol=1e-9)
    assert setup.registration.depth_camera.fx == pytest.approx(0.97 * scenes.CAMERA.fx)
    assert dict(source.info.streams)["depth_to_color"] == "profile realsense_viewer: Color <- reference <- Depth"


def test_older_viewer_bags_have_units_among_properties(tmp_path, monkeypatch):
    put = ViewerBag.put

    def put_property(self, topic, log_ns, message, more=b""):
        if "/option/" not in topic:
            put(self, topic, log_ns, message)
            return
        for key, value in (("Exposure", "8500.0"), ("Depth Units", "0.000100")):
            pair = self.messages.make("diagnostic_msgs/msg/KeyValue", key=key, value=value)
            put(self, "/device_0/sensor_0/property", log_ns, pair)

    monkeypatch.setattr(ViewerBag, "put", put_property)
    monkeypatch.setattr(ViewerBag, "version", "")
    source = open_source(_written("realsense_viewer", tmp_path))
    assert source.played.setup.depth_units_per_m == pytest.approx(10_000)
    depth_m = next(source.frames()).decode().depth_m
    assert np.nanmedian(depth_m) == pytest.approx(np.nanmedian(TRUTH[0].depth_m), abs=0.05)


def test_poses_of_a_file_serve_a_viewer_bag(logs, tmp_path):
    rows = [[f"{f.stamp_ns / 1e9:.9f}", *scenes.pose_row(f.world_from_camera)] for f in TRUTH]
    file = tmp_path / "poses.txt"
    file.write_text("\n".join(" ".join(map(str, row)) for row in rows))
    source = open_source(logs["realsense_viewer"], SourceOptions(pose_file=file, pose_frame="1"))
    for raw, true in zip(source.frames(), TRUTH, strict=True):
        np.testing.assert_allclose(raw.world_from_camera, true.world_from_camera, atol=1e-4)


@pytest.mark.timeout(120)
@pytest.mark.parametrize("layout", ["scannet_sens", "record3d", "realsense_viewer"])
def test_no_damage_crashes_a_reader(copied, layout):
    rng = random.Random(3)
    outcomes = {"played": 0, "refused": 0}
    for _ in range(60):

        def damage(data):
            for _ in range(rng.randint(1, 6)):
                limit = len(data) if rng.random() < 0.5 else min(len(data), 700)
                place = rng.randrange(limit) * rng.choice((1, -1))
                data[place] = rng.randrange(256)
            return data[: rng.randrange(len(data))] if rng.random() < 0.3 else data

        try:
            for raw in open_source(copied(layout, damage), SourceOptions(odometry="auto")).frames():
                try:
                    raw.decode()
                except RecordingError:
                    continue
            outcomes["played"] += 1
        except HickoryError as error:
            assert "\n" not in str(error)
            outcomes["refused"] += 1
    assert min(outcomes.values()) > 0


def test_the_doctor_says_what_a_folder_lacks_or_which_is_a_log(tmp_path, logs):
    for name in ("rgb/0.png", "rgb/1.png", "depth/0.png", "camera.yaml", "notes"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    found = examine([tmp_path], SourceOptions())
    assert found.status == 2
    assert "found 3 .png (such as depth/0.png), 1 .yaml (such as camera.yaml), 1 without an ending" in found.refusal
    assert any(note.startswith("BOP: found rgb/*.png, depth/*.png; missing scene_camera.json") for note in found.notes)
    with pytest.raises(RecordingError, match="missing scene_camera"):
        open_source(tmp_path)
    found = examine([logs["record3d_exr"].parent], SourceOptions())
    assert found.notes == [f"{logs['record3d_exr']} is of the layout Record3D export: name it"]


@pytest.mark.parametrize(
    ("name", "hint"), [("a.mp4", "neither depth nor poses"), ("0.png", "name its folder"), ("a.ply", "no images")]
)
def test_a_file_of_another_kind_gets_a_hint(tmp_path, name, hint):
    (tmp_path / name).write_bytes(b"something else")
    with pytest.raises(RecordingError, match=hint):
        open_source(tmp_path / name)
