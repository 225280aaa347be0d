import re
from functools import cache
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation
from players import SourceOptions, open_source
from players.doctor.diagnosis import SOUND, UNUSABLE, WITH_LOSSES, examine
from players.doctor.motion_mends import motion_warnings
from players.profile import load_profile, mended_profile
from tests import player_scenes as scenes
from tests.cli.test_cli import answer, refusal

DEMO = Path(__file__).parents[2] / "recordings" / "demo.mcap"
M = scenes.Messages(ros=2)
COLOR, DEPTH, ODOM = "/front/image/compressed", "/front/depth/image/compressedDepth", "/odom"
# Neutral names, so that no profile of a robot answers for what the log lacks.
NAMES = {
    "/zed/zed_node/rgb/color/rect/image/compressed": COLOR,
    "/zed/zed_node/rgb/color/rect/camera_info": "/front/camera_info",
    "/zed/zed_node/depth/depth_registered/compressedDepth": DEPTH,
    "/zed/zed_node/depth/camera_info": "/front/depth/camera_info",
    "/zed/zed_node/odom": ODOM,
}
Row = SimpleNamespace


@cache
def demo():
    with DEMO.open("rb") as stream:
        messages = make_reader(stream).iter_messages()
        return [(s.name, NAMES.get(c.topic, c.topic), m.log_time, m.data) for s, c, m in messages]


def cut(path, change=lambda rows: None, seconds=4.0, start=0.0):
    """Write some seconds of the recording, with the messages as a change leaves them."""
    first = demo()[0][2] + start * 1e9
    chosen = [r for r in demo() if first <= r[2] <= first + seconds * 1e9 or r[1] == "/tf_static"]
    rows = [Row(kind=k, topic=t, log_ns=n, message=M.store.deserialize_cdr(d, k)) for k, t, n, d in chosen]
    change(rows)
    messages = [scenes.Message(topic=row.topic, stamp_ns=row.log_ns, message=row.message) for row in rows]
    return scenes.write_mcap(path, M, messages)


def of(rows, *topics):
    return [row for row in rows if row.topic in topics]


def unit(per_mm):
    def change(rows):
        for row in of(rows, DEPTH):
            depth = cv2.imdecode(np.asarray(row.message.data[12:]), cv2.IMREAD_UNCHANGED) * per_mm
            depth = np.where(depth > 65534, 0, np.rint(depth)).astype(np.uint16)
            row.message.data = np.concatenate([row.message.data[:12], cv2.imencode(".png", depth)[1]])

    return change


def in_frame(name):
    def change(rows):
        for row in rows:
            if row.topic.startswith("/front"):
                row.message.header.frame_id = name

    return change


def stamped(seconds, *topics):
    def change(rows):
        for row in of(rows, *topics):
            stamped = row.message.transforms if row.topic == "/tf" else [row.message]
            for header in (one.header for one in stamped):
                ns = header.stamp.sec * 10**9 + header.stamp.nanosec + round(seconds * 1e9)
                header.stamp.sec, header.stamp.nanosec = divmod(ns, 10**9)

    return change


def another_robot(rows):
    rows[:] = [row for row in rows if row.topic != "/tf"]
    for i, row in enumerate(of(rows, ODOM)):
        pose = row.message.pose.pose
        angle = 0.03 * i
        pose.position.x, pose.position.y = 3 * np.cos(angle), 3 * np.sin(angle)
        pose.orientation.x = pose.orientation.y = 0.0
        pose.orientation.z, pose.orientation.w = np.sin(-angle), np.cos(angle)


def late_depth(rows):
    for image, after in pairwise(of(rows, DEPTH)):
        image.message.data = after.message.data


def mirrored(rows):
    for row in of(rows, COLOR, DEPTH):
        skip = 12 * (row.topic == DEPTH)
        flipped = cv2.imdecode(np.asarray(row.message.data[skip:]), cv2.IMREAD_UNCHANGED)[:, ::-1]
        image = cv2.imencode(".png" if skip else ".jpg", flipped)[1]
        row.message.data = np.concatenate([row.message.data[:skip], image])


def examined(log, **options):
    return examine([log], SourceOptions(**options))


@pytest.mark.parametrize(("start", "seconds"), [(0.0, 2.0), (0.0, 3.0), (14.0, 2.0), (0.0, 8.0)])
def test_a_sound_cut_is_sound_and_its_intervals_hold(tmp_path, start, seconds):
    found = examined(cut(tmp_path / "log.mcap", seconds=seconds, start=start))
    assert (found.status, found.problems, found.fixes) == (SOUND, [], {})
    motion, bias = found.frames["motion"], found.frames["depth_bias"]
    assert abs(motion["scale"] - 1) <= motion["scale_error"]
    assert abs(motion["lag_s"]) <= motion["lag_error_s"]
    assert bias is None or abs(bias["bias_m"]) <= 3 * bias["error_m"]


@pytest.mark.parametrize(("change", "reason", "fixes"), [
    (unit(10), "9.\\d+ \\+- 0.6 times too far .* 0.1 mm", {"depth_units_per_m": 10000.0}),
    (unit(4), "times too far .* 0.25 mm", {"depth_units_per_m": 4000.0}),
    (unit(0.1), "times too near .* in centimetres", {"depth_units_per_m": 100.0}),
    (in_frame("zed_left_camera_frame"), "a body's axes", {"camera_axes": "-y -z x"}),
    (stamped(-0.5, "/tf", ODOM), "0.5\\d* \\+- 0.0\\d+ s too early", {"time": {"pose_offset_ms": 500}}),
    (stamped(0.3, "/tf", ODOM), "too late for the images", {"time": {"pose_offset_ms": -300}}),
    (mirrored, "mirrored", {}),
    (another_robot, "another robot's", {}),
])  # fmt: skip
def test_poses_that_do_not_fit_are_named_with_their_mend(tmp_path, change, reason, fixes):
    log = cut(tmp_path / "log.mcap", change)
    found = examined(log)
    assert found.status == (WITH_LOSSES if change is another_robot else UNUSABLE)
    assert re.search(reason, " ".join([found.refusal or "", *found.problems]))
    if "time" in fixes:
        ((key, value),) = fixes["time"].items()
        assert found.fixes["time"][key] == pytest.approx(value, abs=20)
    else:
        assert found.fixes == fixes
    if found.fixes:
        profile = tmp_path / "mended.toml"
        profile.write_text(mended_profile("", found.fixes))
        assert motion_warnings(open_source(log, SourceOptions(profile=str(profile)))) == ([], False)


@pytest.mark.parametrize(("per_mm", "units"), [(1, None), (10, 10000.0)])
def test_poses_beside_the_camera_do_not_change_the_unit_of_depth(tmp_path, per_mm, units):
    def change(rows):
        unit(per_mm)(rows)
        for row in of(rows, ODOM):
            place, turn = row.message.pose.pose.position, row.message.pose.pose.orientation
            beside = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).apply([-0.3, 0.1, -0.25])
            place.x, place.y, place.z = np.array([place.x, place.y, place.z]) + beside

    found = examined(cut(tmp_path / "log.mcap", change, seconds=10.0))
    assert found.fixes.get("depth_units_per_m") == units
    assert abs(found.frames["motion"]["scale"] / per_mm - 1) <= found.frames["motion"]["scale_error"] < 0.12


def test_depth_that_was_taken_later_is_told_with_its_sign(tmp_path):
    found = examined(cut(tmp_path / "log.mcap", late_depth))
    assert found.status == WITH_LOSSES
    assert found.fixes["time"]["depth_offset_ms"] == pytest.approx(167, abs=30)


def test_play_refuses_and_doctor_writes_a_profile(tmp_path):
    log, profile, out = cut(tmp_path / "log.mcap", unit(10)), tmp_path / "mended.toml", tmp_path / "out.map"
    assert "--anyway" in refusal("play", log, "--out", out, "--viewer", "none")
    assert not out.exists()
    answer("doctor", log, "--fix", profile, status=UNUSABLE)
    assert load_profile(str(profile)).depth_units_per_m == 10000.0
    answer("doctor", log, "--profile", profile, status=SOUND)


def test_a_mended_profile_keeps_what_its_base_says(tmp_path):
    first, second = tmp_path / "first.toml", tmp_path / "second.toml"
    first.write_text(mended_profile("zed", {"camera_axes": "-y -z x", "time": {"pose_offset_ms": 40}}))
    second.write_text(mended_profile(str(first), {"sensor": {"bias_m": 0.05}}))
    base, found = load_profile("zed"), load_profile(str(second))
    assert (found.topics, found.sensor.noise_per_m) == (base.topics, base.sensor.noise_per_m)
    assert (found.corrections.pose_offset_ns, found.sensor.bias_m) == (40_000_000, 0.05)
    np.testing.assert_allclose(found.corrections.frame_from_optical[:, 2], [1, 0, 0])
