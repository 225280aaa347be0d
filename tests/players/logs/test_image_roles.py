import re
import struct
from dataclasses import replace
import cv2
import numpy as np
import pytest
from hickory_stream.errors import RecordingError
from players import SourceOptions, open_source
from players.doctor.diagnosis import UNUSABLE, examine
from players.live import open_live
from tests import player_scenes as scenes
from tests.players.messages.test_encodings import encode_rvl

M = scenes.Messages(ros=2)
FRAMES = scenes.make_scene(num_frames=12)


def _log(path, images, names=str):
    """Write a log with other images, and with the names of its calibrations changed."""

    def of_frame(m, frame):
        return [scenes.Message(topic=t, stamp_ns=frame.stamp_ns, message=message) for t, message in images(frame)]

    messages = [replace(m, topic=names(m.topic)) for m in scenes.scene_messages(M, FRAMES, of_frame)]
    return scenes.write_mcap(path / "log.mcap", M, messages)


def _color(frame, link=scenes.OPTICAL):
    return M.compressed(frame.stamp_ns, link, "jpeg", scenes.jpeg_bytes(frame.rgb[..., ::-1]))


def _depth(frame):
    return M.image(frame.stamp_ns, scenes.OPTICAL, "16UC1", frame.depth_mm)


def _colored_depth(frame):
    pixels = cv2.applyColorMap((frame.depth_mm // 16).astype(np.uint8), cv2.COLORMAP_JET)
    return M.image(frame.stamp_ns, scenes.OPTICAL, "bgr8", pixels)


def _rvl(frame):
    data = struct.pack("<iffii", 0, 0.0, 0.0, *frame.depth_mm.shape[::-1]) + encode_rvl(frame.depth_mm)
    return M.compressed(frame.stamp_ns, scenes.OPTICAL, "", data)


def _thermal(frame):
    return M.image(frame.stamp_ns, "thermal", "16UC1", np.full((60, 80), 29_800, dtype=np.uint16))


DEPTH_CAMERA = {"/depth_camera/image/compressed": _color, "/depth_camera/depth/image": _depth}


@pytest.mark.parametrize(("topics", "color", "depth"), [
    (DEPTH_CAMERA, 0, 1),
    ({**DEPTH_CAMERA, "/usb_cam/image_raw/compressed": lambda frame: _color(frame, "webcam")}, 0, 1),
    ({"/rgbd/depth/view": _colored_depth, "/rgbd/depth/image": _depth, "/rgbd/rgb/image": _color}, 2, 1),
    ({"/right_hand_camera/image": _color, "/right_hand_camera/depth": _depth}, 0, 1),
    ({"/color_camera/range/image": _depth, "/color_camera/image": _color}, 1, 0),
    ({"/lepton/image": _thermal, "/cam/z/image": _depth, "/cam/image": _color}, 2, 1),
    ({"/front/depth": _color, "/front/color": _depth}, 0, 1),
    ({"/eye/a": _color, "/eye/b": _rvl}, 0, 1),
    ({"/eye/a": _depth, "/eye/b": _color}, 1, 0),
])  # fmt: skip
def test_roles_follow_from_content_and_the_camera(tmp_path, topics, color, depth):
    names = list(topics)

    def named(topic):
        return topic if not topic.endswith("camera_info") else topic.replace("/cam/", "/calibration/")

    log = _log(tmp_path, lambda frame: [(name, make(frame)) for name, make in topics.items()], named)
    infos = (f"/calibration/{name}/camera_info" for name in ("color", "aligned_depth"))
    options = SourceOptions(color_info_topic=next(infos), depth_info_topic=next(infos))
    live = open_live(f"mcap:{log}", options)
    for source in (open_source(log, options), live):
        streams = dict(source.info.streams)
        assert (streams["color"], streams["depth"]) == (names[color], names[depth])
    assert len(list(live.frames())) == len(FRAMES)
    live.close()


def test_a_topic_named_for_one_role_is_not_taken_for_the_other(tmp_path):
    log = _log(tmp_path, lambda frame: [("/cam/depth/image", _depth(frame)), ("/cam/image", _color(frame))])
    for options, missing in (
        (SourceOptions(color_topic="/cam/depth/image"), "depth"),
        (SourceOptions(depth_topic="/cam/image"), "colour"),
    ):
        with pytest.raises(RecordingError, match=f"has no {missing} topic"):
            open_source(log, options)


@pytest.mark.parametrize(("make", "told"), [
    (lambda f: M.compressed(f.stamp_ns, "cam", "16UC1; jpeg", scenes.jpeg_bytes(f.depth_mm // 16)), "16UC1; jpeg"),
    (lambda f: M.compressed(f.stamp_ns, "cam", "png", scenes.png_bytes((f.depth_mm // 16).astype("u1"))), "8 bits"),
    (lambda f: M.image(f.stamp_ns, "cam", "mono8", (f.depth_mm // 16).astype("u1")), "encoded as 'mono8'"),
    (lambda f: M.compressed(f.stamp_ns, "cam", "webp", b"RIFF\x00\x01\x00\x00WEBPVP8 "), "'webp'.*holds neither"),
    (lambda f: M.image(f.stamp_ns, "cam", "16UC1", f.depth_mm // 1000), "ends at 0.00[23] m.*whole metres"),
    (lambda f: M.image(f.stamp_ns, scenes.OPTICAL, "16UC1", f.depth_mm // 100), "ends at 0.0[34]"),
    (lambda f: M.image(f.stamp_ns, scenes.OPTICAL, "32FC1", np.floor(f.depth_m * 2) / 2), "in steps of 0.5 m"),
    (lambda f: M.image(f.stamp_ns, scenes.OPTICAL, "16UC1", f.depth_mm // 500 * 500), "in steps of 0.5 m"),
    (lambda f: M.image(f.stamp_ns, scenes.OPTICAL, "32FC1", f.depth_m * np.nan), "none of 12 sampled depth images"),
    (lambda f: M.image(f.stamp_ns, scenes.OPTICAL, "16UC1", f.depth_mm * 0), "none of 12 sampled depth images"),
])  # fmt: skip
def test_depth_that_is_none_makes_a_log_unusable(tmp_path, make, told):
    log = _log(tmp_path, lambda frame: [("/cam/aligned_depth/image", make(frame)), ("/cam/color/image", _color(frame))])
    found = examine([log], SourceOptions())
    assert found.status == UNUSABLE
    assert re.search(told, found.refusal), found.refusal


@pytest.mark.parametrize("num_torn", [3, 100])
def test_only_a_log_without_one_whole_image_is_refused(tmp_path, num_torn):
    numbers = iter(range(100))

    def torn(frame):
        message = _color(frame)
        return replace(message, data=message.data[: 300 if next(numbers) < num_torn else None])

    log = _log(tmp_path, lambda f: [("/cam/aligned_depth/image", _depth(f)), ("/cam/color/image", torn(f))])
    if num_torn == 3:
        assert open_source(log).info.num_frames == 12
    else:
        with pytest.raises(RecordingError, match="none of the first 12 images of /cam/color/image can be decoded"):
            open_source(log)
