import inspect
from types import SimpleNamespace
import numpy as np
import pytest
from hickory_stream.errors import RecordingError
from players.doctor.diagnosis import examine
from players.live import open_live
from players.live.routes import is_live, is_recording, route_of
from players.live.zed_messages import COLOR, ODOM
from players.live.zed_route import USED, ZedRoute, check_sdk, load_sdk
from players.options import SourceOptions
from tests.player_scenes import make_scene, mcap_writer
from tests.players.live.fake_zed import PUBLISHED, fake_sl


@pytest.fixture
def svo(tmp_path):
    path = tmp_path / "desk.svo2"
    path.write_bytes(b"svo")
    return f"zed:{path}"


def test_the_fake_module_and_our_use_have_only_names_of_the_sdk():
    for owner, made in vars(fake_sl()).items():
        if owner == "opened":
            continue
        published = PUBLISHED[owner]
        members = made.__members__ if owner.isupper() else {n: v for n, v in vars(made).items() if n[0] != "_"}
        assert set(members) <= set(published), owner
        for name, member in members.items():
            wanted = published[name]
            if wanted is not None:
                found = [p for p in inspect.signature(member).parameters if p != "self"]
                assert tuple(found) == wanted, f"{owner}.{name}"
    assert {owner: set(names) - set(PUBLISHED[owner]) for owner, names in USED.items() if owner in PUBLISHED} == {
        owner: set() for owner in USED
    }


def test_every_frame_of_a_recording_is_the_scene_with_z_up(svo):
    sl, scene = fake_sl(), make_scene(num_frames=6)
    source = open_live(svo, route=ZedRoute(svo, sl), attempt_s=0.3, patience_s=20.0)
    frames = list(source.frames())
    assert [frame.stamp_ns for frame in frames] == [item.stamp_ns for item in scene]
    for raw, item in zip(frames, scene, strict=True):
        frame = raw.decode()
        assert np.array_equal(frame.rgb, item.rgb)
        assert np.array_equal(frame.depth_m, item.depth_m, equal_nan=True)
        assert np.allclose(frame.world_from_camera, item.world_from_camera, atol=1e-6)
    assert dict(source.info.streams)["profile"].startswith("zed")
    assert source.account().as_dict()["difference"] == 0
    (opened,) = sl.opened
    assert opened._input == ("svo", svo.removeprefix("zed:"))
    assert opened.svo_real_time_mode is False
    assert opened.coordinate_units is sl.UNIT.METER
    assert next(entry.lost for entry in source.status().topics if entry.topic == COLOR) == 3
    source.close()


def test_only_tracked_frames_are_mapped_and_corrupt_ones_counted(svo):
    sl = fake_sl(lost_at=(9, 10, 11, 12, 13, 14, 15), corrupted_at=2, num_frames=16)
    source = open_live(svo, route=ZedRoute(svo, sl), attempt_s=0.3, patience_s=20.0)
    stamps = [frame.stamp_ns for frame in source.frames()]
    scene = [item.stamp_ns for item in make_scene(num_frames=16)]
    assert stamps == scene[:2] + scene[3:9]
    account = {entry.topic: entry for entry in source.account().topics}
    assert account[COLOR].rejected["corrupted"] == 1
    assert account[ODOM].total == 8
    source.close()


@pytest.mark.parametrize(("uri", "asked"), [
    ("zed://", ()),
    ("zed://31234567", ("serial", 31234567)),
    ("zed://192.168.1.20:30010", ("stream", "192.168.1.20", 30010)),
    ("zed://jetson", ("stream", "jetson", 30000)),
])  # fmt: skip
def test_a_camera_is_opened_by_its_name_and_tried_again(uri, asked, monkeypatch):
    monkeypatch.setattr("players.live.zed_route._AGAIN_S", 0.01)
    sl = fake_sl(open_fails=2)
    told = []
    source = open_live(uri, route=ZedRoute(uri, sl), attempt_s=0.3, patience_s=20.0, report=told.append)
    assert sl.opened[0]._input == asked
    source.close()


def test_a_camera_that_is_not_there_is_named_with_the_reason(monkeypatch):
    sl = fake_sl(open_fails=1000)
    with pytest.raises(RecordingError, match=r"the ZED SDK cannot open it \(CAMERA_NOT_DETECTED\)"):
        open_live("zed://", route=ZedRoute("zed://", sl), attempt_s=0.1, patience_s=0.3)


def test_a_missing_sdk_is_one_line_that_says_how_to_get_it(svo):
    with pytest.raises(RecordingError, match=r"the ZED SDK is missing[^\n]*stereolabs.com/developers[^\n]*$"):
        route_of(svo)
    with pytest.raises(RecordingError, match="the package `pyzed` of the package index is something else"):
        load_sdk()


@pytest.mark.parametrize(
    ("name", "lacks"), [("Transform", r"Transform, expected version 5"), ("Mat", r"Mat\.get_data")]
)
def test_an_sdk_of_another_version_is_told_by_what_it_lacks(name, lacks):
    sl = fake_sl()
    delattr(sl, name) if name == "Transform" else setattr(sl, name, SimpleNamespace())
    with pytest.raises(RecordingError, match=f"lacks {lacks}"):
        check_sdk(sl)


def test_only_a_file_is_a_recording(svo):
    assert is_live("zed://") and is_live("zed://31234567")
    assert is_recording(svo) and not is_recording("zed://")


def test_a_recording_that_is_read_without_the_sdk_is_named(tmp_path):
    path = tmp_path / "desk.svo2"
    with mcap_writer(path, "") as writer:
        for topic in ("svo_header", "Camera_SN31234567/side_by_side"):
            writer.add_message(writer.register_channel(topic, "", 0), 1, b"\0" * 8, 1)
    diagnosis = examine([path], SourceOptions())
    assert "is a recording of a ZED camera (SVO2)" in diagnosis.refusal
    assert f"hickory-stream live zed:{path}" in diagnosis.refusal
