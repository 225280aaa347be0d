import base64
import json
import sys
from fractions import Fraction
import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg
from hickory_stream.errors import RecordingError
from players import SourceOptions, open_source
from players.doctor.diagnosis import SOUND, WITH_LOSSES, examine
from players.live import open_live
from tests import player_scenes as scenes

M = scenes.Messages(ros=2)
FRAMES = scenes.make_scene(num_frames=12)
VIDEO, FFMPEG = "foxglove_msgs/msg/CompressedVideo", "ffmpeg_image_transport_msgs/msg/FFMPEGPacket"
for name, fields in {
    VIDEO: "builtin_interfaces/Time timestamp,string frame_id,uint8[] data,string format",
    FFMPEG: "std_msgs/Header header,int32 width,int32 height,string encoding,uint64 pts,uint8 flags,"
    "bool is_bigendian,uint8[] data",
}.items():
    M.store.register(get_types_from_msg(fields.replace(",", "\n"), name))


def _coded(images, codec, pixels, **options):
    """Return the packets of images, in the order in which the encoder gives them, each with the number of its image."""
    av = pytest.importorskip("av")
    encoder = av.CodecContext.create(codec, "w")
    encoder.height, encoder.width = images[0].shape[:2]
    encoder.pix_fmt, encoder.time_base, encoder.options = pixels, Fraction(1, 10), options
    packets = []
    for i, image in enumerate([*images, None]):
        frame = None
        if image is not None:
            given = "rgb24" if image.ndim == 3 else pixels
            frame = av.VideoFrame(image.shape[1], image.shape[0], given)
            rows = np.frombuffer(frame.planes[0], dtype=image.dtype).reshape(image.shape[0], -1)
            rows[:, : image[0].size] = image.reshape(image.shape[0], -1)
            frame = frame if given == pixels else frame.reformat(format=pixels)
            frame.pts = i
        packets += [(packet.pts, bytes(packet)) for packet in encoder.encode(frame)]
    return packets


LIVE = {"tune": "zerolatency", "crf": "4"}
CODECS = {
    "h264": ("libx264", LIVE), "h264 with delayed pictures": ("libx264", {"bf": "2", "crf": "4"}),
    "h265": ("libx265", {**LIVE, "x265-params": "log-level=none"}),
    "av1": ("libsvtav1", {"crf": "10", "preset": "10"}),
    "vp9": ("libvpx-vp9", {"crf": "4", "deadline": "realtime", "lag-in-frames": "0"}),
}  # fmt: skip


def _packets(name):
    codec, options = CODECS[name]
    return _coded([frame.rgb for frame in FRAMES], codec, "yuv420p", **options)


def _stamp(stamp_ns):
    return M.make("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)


def _compressed_image(stamp_ns, data, codec):
    return M.compressed(stamp_ns, scenes.OPTICAL, codec, data)


def _compressed_video(stamp_ns, data, codec):
    pixels = np.frombuffer(data, dtype=np.uint8)
    return M.make(VIDEO, timestamp=_stamp(stamp_ns), frame_id=scenes.OPTICAL, data=pixels, format=codec)


def _packet(stamp_ns, data, codec):
    return M.make(
        FFMPEG, header=M.header(stamp_ns, scenes.OPTICAL), width=80, height=60, encoding=f"{codec};yuv420p;rgb8", pts=0,
        flags=0, is_bigendian=False, data=np.frombuffer(data, dtype=np.uint8),
    )  # fmt: skip


def _log(path, make, packets, codec, topic=scenes.RAW_COLOR):
    """Write the log with video in place of the images of a topic; a message has the stamp of its picture."""
    log = [m for m in scenes.scene_messages(M, FRAMES, scenes.raw_images) if m.topic != topic]
    for order, (number, data) in enumerate(packets):
        message = make(FRAMES[number].stamp_ns, data, codec)
        log.append(scenes.Message(topic=topic, stamp_ns=FRAMES[order].stamp_ns, message=message))
    return scenes.write_mcap(path / "log.mcap", M, sorted(log, key=lambda message: message.stamp_ns))


def _error(log):
    frames = [raw.decode() for raw in open_source(log).frames()]
    truth = {frame.stamp_ns: frame for frame in FRAMES}
    return [float(np.abs(f.rgb.astype(int) - truth[f.stamp_ns].rgb).mean()) for f in frames]


@pytest.mark.parametrize("name", CODECS)
@pytest.mark.parametrize("make", [_compressed_image, _compressed_video, _packet])
def test_video_is_the_colour_of_its_frames(tmp_path, name, make):
    log = _log(tmp_path, make, _packets(name), name.split()[0])
    errors = _error(log)
    # Consecutive frames differ by more.
    assert len(errors) == len(FRAMES)
    assert max(errors) < 6.0 < np.abs(FRAMES[0].rgb.astype(int) - FRAMES[3].rgb).mean()
    found = examine([log], SourceOptions())
    assert (found.status, found.problems) == (SOUND, [])
    live = open_live(f"mcap:{log}")
    assert len(list(live.frames())) == len(FRAMES)
    live.close()


def test_packets_before_the_first_key_frame_are_losses(tmp_path):
    packets = _coded([frame.rgb for frame in FRAMES], "libx264", "yuv420p", **LIVE, **{"g": "6", "forced-idr": "1"})
    log = _log(tmp_path, _compressed_image, packets[2:], "h264")
    assert len(_error(log)) == 6
    found = examine([log], SourceOptions())
    assert found.status == WITH_LOSSES
    assert "4 of 10 packets" in found.damage[0]["what"]


@pytest.mark.parametrize(("codec", "pixels", "options", "per_mm"), [
    ("libx265", "gray12le", {"tune": "zerolatency", "x265-params": "lossless=1:log-level=none"}, 1),
    ("libx264", "gray10le", {"tune": "zerolatency", "qp": "0"}, 8),
    ("ffv1", "gray16le", {"level": "1"}, 1),
    ("ffv1", "gray10le", {"level": "1"}, 8),
])  # fmt: skip
def test_lossless_depth_is_exact(tmp_path, codec, pixels, options, per_mm):
    packets = _coded([frame.depth_mm // per_mm for frame in FRAMES], codec, pixels, **options)
    log, profile = _log(tmp_path, _packet, packets, codec, scenes.RAW_DEPTH), tmp_path / "unit.toml"
    profile.write_text(f"depth_units_per_m = {1000 / per_mm}\n")
    for raw, truth in zip(open_source(log, SourceOptions(profile=str(profile))).frames(), FRAMES, strict=True):
        expected = np.where(np.isfinite(truth.depth_m), truth.depth_mm // per_mm * per_mm / 1000, np.nan)
        np.testing.assert_allclose(raw.decode().depth_m, expected, atol=1e-6)


@pytest.mark.parametrize("level", [{"level": "3"}, {}])
def test_ffv1_without_its_header_is_refused_by_name(tmp_path, level):
    packets = _coded([frame.depth_mm for frame in FRAMES], "ffv1", "gray16le", **level)
    with pytest.raises(RecordingError, match=r"12 of 12 packets of /\S+ \(ffv1\) give no picture"):
        open_source(_log(tmp_path, _packet, packets, "ffv1", scenes.RAW_DEPTH))


@pytest.mark.parametrize("make", [_compressed_video, _packet])
def test_an_unknown_codec_is_refused_by_name(tmp_path, make):
    packets = [(i, bytes([1, 2, 3, 4] * 20)) for i in range(len(FRAMES))]
    log = _log(tmp_path, make, packets, "vvc")
    for open_ in (open_source, lambda log: open_live(f"mcap:{log}")):
        with pytest.raises(RecordingError, match=r"is video \('vvc.*expected H.264"):
            open_(log)


def test_foxglove_s_json_holds_video_too(tmp_path):
    packets = _packets("h264")
    log = [m for m in scenes.scene_messages(M, FRAMES, scenes.raw_images) if m.topic != scenes.RAW_COLOR]
    path = tmp_path / "log.mcap"
    with scenes.mcap_writer(path, "") as writer:
        schema = writer.register_schema("foxglove.CompressedVideo", "jsonschema", b"{}")
        channel = writer.register_channel(scenes.RAW_COLOR, "json", schema)
        for frame, (_, data) in zip(FRAMES, packets, strict=True):
            stamp = {"sec": frame.stamp_ns // 10**9, "nsec": frame.stamp_ns % 10**9}
            content = base64.b64encode(data).decode()
            text = json.dumps({"timestamp": stamp, "frame_id": scenes.OPTICAL, "format": "h264", "data": content})
            writer.add_message(channel, frame.stamp_ns, text.encode(), frame.stamp_ns)
    rest = scenes.write_mcap(tmp_path / "rest.mcap", M, log)
    assert sum(1 for _ in open_source([path, rest]).frames()) == len(FRAMES)


@pytest.mark.parametrize("make", [_compressed_image, _compressed_video])
def test_without_pyav_the_extra_is_named(tmp_path, monkeypatch, make):
    packets = [(i, b"\0\0\0\1\x67 and so on") for i in range(len(FRAMES))]
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(RecordingError, match=r"video.*pip install 'hickory-stream\[video\]'"):
        open_source(_log(tmp_path, make, packets, "h264"))
