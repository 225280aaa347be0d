from dataclasses import replace
import cv2
import numpy as np
import pytest
from hickory_stream.errors import CalibrationError, InputError, RecordingError
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import from_rotation_translation
from players import SourceOptions, open_source
from tests import player_scenes as scenes

MS = 1_000_000
M = scenes.Messages(ros=2)
TRUTH = scenes.make_scene()
LOG = scenes.scene_messages(M, TRUTH, scenes.png_images)
RAW_LOG = scenes.scene_messages(M, TRUTH, scenes.raw_images)
COLOR_INFO = "/cam/color/camera_info"
DEPTH_INFO = "/cam/aligned_depth/camera_info"
WIDE = Camera(width=1280, height=720, fx=700, fy=700, cx=640, cy=360)


def _open(path, messages, options=None, **settings):
    log = scenes.write_mcap(path / "log.mcap", M, sorted(messages, key=lambda m: m.stamp_ns), **settings)
    return open_source(log, options)


def _changed(topic, change, messages=LOG):
    """Return the log with the messages of a topic changed, or removed where the change is None."""
    out = [change(message) if message.topic == topic else message for message in messages]
    return [message for message in out if message is not None]


def _without(*topics):
    return [message for message in LOG if message.topic not in topics]


def _only(index, change):
    """Apply a change to one image only."""
    stamps = (TRUTH[index].stamp_ns, TRUTH[index].stamp_ns + 9 * MS)
    return lambda message: change(message) if message.stamp_ns in stamps else message


def _with_info(topic, info, messages=LOG):
    return _changed(topic, lambda message: replace(message, message=info), messages)


def _setting(**fields):
    """Return the change of a message that sets fields of its content."""
    return lambda message: replace(message, message=replace(message.message, **fields))


def _delayed(delay_ns, frame):
    """Return the change of a message that delays its header."""
    return lambda message: _setting(header=M.header(message.stamp_ns + delay_ns, frame))(message)


def _in_frame(frame):
    return lambda message: _setting(header=replace(message.message.header, frame_id=frame))(message)


def _cut_to(size):
    return lambda message: _setting(data=message.message.data[:size])(message)


@pytest.mark.parametrize(("topics", "told"), [
    ((scenes.PNG_DEPTH,), r"no depth topic.*/cam/color/image_rect/compressed \(sensor_msgs.*--depth-topic"),
    ((scenes.PNG_COLOR,), r"no colour topic.*compressedDepth \(sensor_msgs.*--color-topic"),
    (("/odom", "/tf_static"), r"no poses.*nav_msgs/msg/Odometry.*/cam/color/camera_info"),
    ((COLOR_INFO, DEPTH_INFO), r"no intrinsics for .*/cam/color/camera_info.*none.*--color-info-topic"),
    (("/tf_static",), r"no transform from base_link to the camera's frame cam_optical.*--pose-frame"),
])  # fmt: skip
def test_what_a_log_lacks_is_named_with_the_option(tmp_path, topics, told):
    with pytest.raises(InputError, match=told):
        _open(tmp_path, _without(*topics), SourceOptions(odometry="topic"))


@pytest.mark.parametrize(("topic", "change", "told"), [
    (COLOR_INFO, _setting(k=np.zeros(9), p=np.zeros(12)), r"/cam/color/camera_info holds no intrinsics \(K = \[0"),
    (scenes.PNG_DEPTH, _in_frame("depth_optical"), r"depth's frame depth_optical to the colour's cam_optical"),
    ("/odom", lambda m: _delayed(0, "odom")(replace(m, stamp_ns=m.stamp_ns + 3_600_000 * MS)),
     r"images from 1700000000\.123 s.*poses of /odom from 1700003600\."),
    (scenes.PNG_DEPTH, _delayed(40_000 * MS, scenes.OPTICAL),
     r"within 50\.0 ms: .*from 1700000000\.123 s.*from 1700000040\.132 s"),
    (scenes.PNG_DEPTH, _setting(format="32FC1; compressedDepth png"),
     r"none of the first 6 images.*inverse depth without parameters"),
    (COLOR_INFO, lambda m: replace(m, message=M.camera_info(m.stamp_ns, scenes.OPTICAL, WIDE)),
     r"for 1280x720 and 80x60 pixels; no pair"),
])  # fmt: skip
def test_topics_that_do_not_fit_together_are_refused(tmp_path, topic, change, told):
    with pytest.raises(InputError, match=told):
        _open(tmp_path, _changed(topic, change))


def test_depth_in_the_colour_frame_needs_no_calibration(tmp_path):
    source = _open(tmp_path, _without(DEPTH_INFO))
    assert len(list(source.frames())) == len(TRUTH)
    streams = dict(source.info.streams)
    assert (streams["depth_info"], streams["frames"]) == (COLOR_INFO, "odom <- base_link <- cam_link <- cam_optical")


@pytest.mark.parametrize(("messages", "options", "told"), [
    (LOG, SourceOptions(color_topic="/left"), r"no topic /left for --color-topic; it has: /cam/aligned"),
    ([], None, r"\(MCAP\) holds no messages"),
])  # fmt: skip
def test_a_missing_topic_and_an_empty_log_are_refused(tmp_path, messages, options, told):
    with pytest.raises(RecordingError, match=told):
        _open(tmp_path, messages, options)


@pytest.mark.parametrize(
    ("topic", "encoding"), [(scenes.RAW_COLOR, "jpeg2000"), (scenes.RAW_DEPTH, "64FC1"), (scenes.RAW_DEPTH, "rgb8")]
)
def test_an_encoding_that_is_not_known_is_refused_at_once(tmp_path, topic, encoding):
    with pytest.raises(RecordingError, match=rf"{topic} is encoded as '{encoding}'; .* must be one of"):
        _open(tmp_path, _changed(topic, _setting(encoding=encoding), RAW_LOG))


@pytest.mark.parametrize(("topic", "index", "size"), [
    *((topic, 2, size) for topic in (scenes.PNG_COLOR, scenes.PNG_DEPTH) for size in (0, 60)),
    (scenes.PNG_COLOR, 0, 0),
])  # fmt: skip
def test_a_torn_image_fails_when_it_is_decoded_and_only_then(tmp_path, topic, index, size):
    source = _open(tmp_path, _changed(topic, _only(index, _cut_to(size))))
    frames = list(source.frames())
    assert len(frames) == len(TRUTH)
    with pytest.raises(RecordingError, match=topic):
        frames[index].decode()
    frames[3].decode()
    assert source.ledger() == {"frames": len(TRUTH), "unreadable_image": 1}


def _spoilt(message):
    """Return an odometry without a place."""
    pose = M.pose(np.eye(4))
    nan = replace(pose, position=replace(pose.position, x=float("nan")))
    return _setting(pose=replace(message.message.pose, pose=nan))(message)


def _shrunk(message):
    small = scenes.png_bytes(np.zeros((30, 40, 3), dtype=np.uint8))
    return replace(message, message=M.compressed(message.stamp_ns, scenes.OPTICAL, "png", small))


FIRST_POSE = next(message for message in LOG if message.topic == "/odom")
GAP_NS = (TRUTH[2].stamp_ns - 50 * MS, TRUTH[3].stamp_ns + 50 * MS)
LONELY = _changed(scenes.PNG_DEPTH, _only(1, lambda message: None))


@pytest.mark.parametrize(("messages", "missing", "fates"), [
    (_changed(scenes.PNG_COLOR, _only(2, _shrunk)), (2,), {"frame_of_other_size": 1}),
    (_changed("/odom", lambda m: _spoilt(m) if m is FIRST_POSE else m), (), {"bad_pose": 1}),
    (_changed("/odom", lambda m: None if GAP_NS[0] < m.stamp_ns < GAP_NS[1] else m), (2, 3), {"no_pose": 2}),
    (_changed(scenes.PNG_COLOR, _only(3, lambda message: None), LONELY), (1, 3),
     {"color_without_depth": 1, "depth_without_color": 1}),
], ids=["size", "pose", "gap", "partner"])  # fmt: skip
def test_what_cannot_be_a_frame_is_counted_and_the_rest_played(tmp_path, messages, missing, fates):
    source = _open(tmp_path, messages, SourceOptions(max_pose_gap_ns=100 * MS))
    played = [frame.stamp_ns for frame in source.frames()]
    assert played == [frame.stamp_ns for i, frame in enumerate(TRUTH) if i not in missing]
    assert source.ledger() == {"frames": len(played), **fates}


def test_a_calibration_of_the_sensor_is_fitted_to_the_images(tmp_path):
    k = np.array([[140.0, 0, 99], [0, 140, 79], [0, 0, 1]])  # doubled, with 20 columns and rows to the left and above
    region = M.make(
        "sensor_msgs/msg/RegionOfInterest", x_offset=20, y_offset=20, height=120, width=160, do_rectify=False
    )
    info = M.camera_info(scenes.START_NS, scenes.OPTICAL, Camera(width=200, height=160, fx=140, fy=140, cx=99, cy=79))
    info = replace(info, binning_x=2, binning_y=2, roi=region, k=k.ravel())
    source = _open(tmp_path, _with_info(COLOR_INFO, info))
    assert source.info.camera == replace(scenes.CAMERA, cx=39.5, cy=29.5)
    assert dict(source.info.streams)["color_info"] == f"{COLOR_INFO} (region 160x120 at 20, 20, binned to 80x60)"
    assert source.ledger()["frames"] == 1


@pytest.mark.parametrize("size", [(40, 30), (160, 120)])
def test_depth_of_another_size_uncalibrated_has_colour_s(tmp_path, size):
    def resize(message):
        i = (message.stamp_ns - scenes.START_NS) // scenes.PERIOD_NS
        depth_mm = cv2.resize(TRUTH[i].depth_mm, size, interpolation=cv2.INTER_NEAREST)
        return replace(message, message=M.image(message.stamp_ns, scenes.OPTICAL, "16UC1", depth_mm))

    log = [m for m in _changed(scenes.RAW_DEPTH, resize, RAW_LOG) if m.topic != "/cam/aligned_depth/camera_info"]
    frame = next(_open(tmp_path, log).frames()).decode()
    both = np.isfinite(frame.depth_m) & np.isfinite(TRUTH[0].depth_m)
    assert both.mean() > 0.9 * np.isfinite(TRUTH[0].depth_m).mean()
    assert np.median(np.abs(frame.depth_m - TRUTH[0].depth_m)[both]) < 0.02


def test_depth_without_a_single_return_is_a_frame_and_counted(tmp_path):
    def blind(message):
        nothing = np.full((60, 80), np.nan, dtype=np.float32)
        return replace(message, message=M.image(message.stamp_ns, scenes.OPTICAL, "32FC1", nothing))

    source = _open(tmp_path, _changed(scenes.RAW_DEPTH, blind, RAW_LOG))
    for raw in source.frames():
        assert np.isnan(raw.decode().depth_m).all()
    assert source.ledger()["depth_without_returns"] == len(TRUTH)


def test_a_message_that_cannot_be_read_is_counted(tmp_path):
    log = tmp_path / "log.mcap"
    scenes.write_mcap(log, M, LOG, use_chunking=False, enable_crcs=False)
    data = log.read_bytes()
    start = data.index(M.store.serialize_cdr(LOG[-1].message, LOG[-1].message.__msgtype__))
    torn = bytearray(data)
    # A length in the header of the last odometry message that reaches beyond its end.
    torn[start + 12 : start + 16] = b"\xff\xff\xff\x7f"
    log.write_bytes(bytes(torn))
    source = open_source(log)
    assert len(list(source.frames())) == len(TRUTH)
    assert source.ledger()["unreadable_message"] == 1


def test_a_flipped_byte_in_a_chunk_is_noticed(tmp_path):
    from mcap.writer import CompressionType

    log = scenes.write_mcap(tmp_path / "log.mcap", M, LOG, compression=CompressionType.NONE)
    data = bytearray(log.read_bytes())
    data[data.index(b"IDAT") + 40] ^= 0xFF
    log.write_bytes(bytes(data))
    with pytest.raises(RecordingError, match=r"holds no image.*1 places of the log are damaged.*fails its checksum"):
        open_source(log)


def test_a_flipped_byte_costs_the_frames_of_its_chunk_only(tmp_path):
    log = scenes.write_mcap(tmp_path / "log.mcap", M, RAW_LOG, chunk_size=40_000)
    data = bytearray(log.read_bytes())
    data[len(data) // 2] ^= 0xFF
    log.write_bytes(bytes(data))
    frames = list(open_source(log).frames())
    assert len(TRUTH) - 2 <= len(frames) < len(TRUTH)
    for frame in frames:
        truth = next(t for t in TRUTH if t.stamp_ns == frame.stamp_ns)
        np.testing.assert_array_equal(frame.decode().rgb, truth.rgb)


def test_a_pose_without_a_child_frame_needs_one_named(tmp_path):
    stamped = {s.stamp_ns: M.pose_stamped(s.stamp_ns, "map", s.world_from_camera) for s in TRUTH}
    poses = [scenes.Message(topic="/slam_pose", stamp_ns=ns, message=message) for ns, message in stamped.items()]
    told = r"/slam_pose .* does not say .*--pose-frame \(the camera's is cam_optical"
    with pytest.raises(CalibrationError, match=told):
        _open(tmp_path, _without("/odom") + poses)
    source = _open(tmp_path, _without("/odom") + poses, SourceOptions(pose_frame=scenes.OPTICAL))
    for raw, truth in zip(source.frames(), TRUTH, strict=True):
        np.testing.assert_allclose(raw.world_from_camera, truth.world_from_camera, atol=1e-9)


def test_static_links_on_tf_and_messages_out_of_order_play(tmp_path):
    log = _changed("/tf_static", lambda message: replace(message, topic="/tf"))
    assert len(list(_open(tmp_path, log).frames())) == len(TRUTH)
    pairs = zip(LOG[1::2], LOG[::2], strict=False)
    log = scenes.write_mcap(tmp_path / "log.mcap", M, [message for pair in pairs for message in pair])
    assert [frame.stamp_ns for frame in open_source(log).frames()] == [frame.stamp_ns for frame in TRUTH]


COLOR_CAMERA = Camera(width=160, height=120, fx=130.0, fy=131.0, cx=80.0, cy=58.0)
DEPTH_CAMERA = Camera(width=160, height=120, fx=140.0, fy=140.0, cx=79.5, cy=59.5)
COLOR_FROM_DEPTH = from_rotation_translation(np.eye(3), np.array([-0.059, 0.0, 0.001]))


def _unregistered():
    """Return a RealSense-like log: depth with a camera, a frame and stamps of its own, raw in millimetres."""

    def images(m, frame):
        stamp_ns = frame.stamp_ns
        bgr = scenes.cast(COLOR_CAMERA, frame.world_from_camera)[0][..., ::-1]
        depth = scenes.cast(DEPTH_CAMERA, frame.world_from_camera @ COLOR_FROM_DEPTH)[1]
        depth_mm = np.round(np.where(depth < 6, depth, 0) * 1000).astype(np.uint16)
        messages = {
            "color/image_raw/compressed": m.compressed(stamp_ns, "color_optical", "jpeg", scenes.jpeg_bytes(bgr)),
            "depth/image_rect_raw": m.image(stamp_ns + 3 * MS, "depth_optical", "16UC1", depth_mm),
            "color/camera_info": m.camera_info(stamp_ns, "color_optical", COLOR_CAMERA),
            "depth/camera_info": m.camera_info(stamp_ns, "depth_optical", DEPTH_CAMERA),
        }
        return [scenes.Message(topic=f"/fwd/{name}", stamp_ns=stamp_ns, message=it) for name, it in messages.items()]

    places = {"color_optical": scenes.BODY_FROM_CAMERA, "depth_optical": scenes.BODY_FROM_CAMERA @ COLOR_FROM_DEPTH}
    statics = M.tf(0, *(("base_link", name, place) for name, place in places.items()))
    rest = [m for m in scenes.scene_messages(M, TRUTH, images) if not m.topic.startswith(("/cam", "/tf_static"))]
    return [scenes.Message(topic="/tf_static", stamp_ns=scenes.START_NS - 200 * MS, message=statics), *rest]


def test_depth_of_its_own_camera_is_registered_to_colour(tmp_path):
    source = _open(tmp_path, _unregistered())
    assert source.info.camera == COLOR_CAMERA
    for raw, truth in zip(source.frames(), TRUTH, strict=True):
        np.testing.assert_allclose(raw.world_from_camera, truth.world_from_camera, atol=1e-9)
        depth_m = raw.decode().depth_m
        expected = scenes.cast(COLOR_CAMERA, truth.world_from_camera)[1]
        both = np.isfinite(depth_m) & np.isfinite(expected)
        assert both.mean() > 0.6
        assert (np.abs(depth_m - expected)[both] < 0.05).mean() > 0.95


def test_a_distorted_image_is_rectified_to_a_pinhole(tmp_path):
    distortion = (-0.25, 0.05, 0.001, -0.001, 0.0)
    rgb = scenes.cast(COLOR_CAMERA, TRUTH[0].world_from_camera)[0]
    size = (COLOR_CAMERA.width, COLOR_CAMERA.height)
    # Where each distorted pixel looks in the pinhole image: the inverse of what the player does.
    grid = np.stack(np.meshgrid(np.arange(size[0]), np.arange(size[1])), -1).reshape(-1, 1, 2).astype(np.float64)
    source_px = cv2.undistortPoints(grid, COLOR_CAMERA.K, np.array(distortion), P=COLOR_CAMERA.K)
    source_px = np.asarray(source_px, dtype=np.float32).reshape(size[1], size[0], 2)
    distorted = cv2.remap(rgb, source_px[..., 0], source_px[..., 1], cv2.INTER_LINEAR)

    def swap(message):
        data = scenes.png_bytes(np.asarray(distorted)[..., ::-1])
        return replace(message, message=M.compressed(message.stamp_ns, "color_optical", "png", data))

    log = _changed("/fwd/color/image_raw/compressed", _only(0, swap), _unregistered())
    info = M.camera_info(scenes.START_NS, "color_optical", COLOR_CAMERA, distortion)
    raw = next(_open(tmp_path, _with_info("/fwd/color/camera_info", info, log)).frames())
    assert raw.color_bytes is None
    middle = (slice(20, -20), slice(20, -20))
    error = np.abs(raw.decode().rgb[middle].astype(int) - rgb[middle])
    assert np.median(error) <= 3
    assert np.median(np.abs(np.asarray(distorted)[middle].astype(int) - rgb[middle])) > np.median(error)


def test_a_topic_of_an_unknown_type_does_no_harm(tmp_path):
    log = tmp_path / "log.mcap"
    with scenes.mcap_writer(log) as writer:
        strange = writer.register_schema("unitree_go/msg/LowState", "ros2msg", b"not ( a definition")
        channel = writer.register_channel("/lowstate", "cdr", strange)
        writer.add_message(channel, scenes.START_NS, b"\x00\x01\x02", scenes.START_NS)
    known = scenes.write_mcap(tmp_path / "known.mcap", M, LOG)
    assert len(list(open_source([known, log]).frames())) == len(TRUTH)


STRAY = [
    scenes.Message(topic="/a_odom", stamp_ns=s, message=M.odometry(s, "odom", "trailer", np.eye(4)))
    for s in range(TRUTH[0].stamp_ns, TRUTH[-1].stamp_ns, 5 * MS)
]
BACK = [replace(m, topic=m.topic.replace("/cam/", "/back/")) for m in LOG if m.topic.startswith("/cam/")]
ELSEWHERE = _changed(
    DEPTH_INFO, lambda m: None, _changed(COLOR_INFO, lambda message: replace(message, topic="/calibration"))
)


@pytest.mark.parametrize(("messages", "options", "role", "topic"), [
    (LOG + STRAY, None, "pose", "/odom"),
    (LOG + BACK, SourceOptions(color_topic=scenes.PNG_COLOR), "depth", scenes.PNG_DEPTH),
    (ELSEWHERE, None, "color_info", "/calibration"),
], ids=["odometry that carries the camera", "depth of the same camera", "calibration by its frame"])  # fmt: skip
def test_of_several_topics_the_one_that_fits_is_taken(tmp_path, messages, options, role, topic):
    assert dict(_open(tmp_path, messages, options).info.streams)[role] == topic


def test_depth_of_half_size_is_scaled_to_the_colour_frame(tmp_path):
    half = scenes.CAMERA.scaled(0.5)

    def shrink(message):
        depth = scenes.cast(half, scenes.pose_at(message.stamp_ns))[1].astype(np.float32)
        return replace(message, message=M.image(message.stamp_ns, scenes.OPTICAL, "32FC1", depth))

    info = M.camera_info(scenes.START_NS, scenes.OPTICAL, half)
    log = _with_info(DEPTH_INFO, info, _changed(scenes.RAW_DEPTH, shrink, RAW_LOG))
    for raw, truth in zip(_open(tmp_path, log).frames(), TRUTH, strict=True):
        error = np.abs(raw.decode().depth_m - truth.depth_m)
        assert np.nanmedian(error) < 0.02
        assert np.isfinite(error[np.isfinite(truth.depth_m)]).mean() > 0.97
