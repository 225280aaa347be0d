import base64
import json
import struct
from types import SimpleNamespace
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from hickory_stream.errors import RecordingError
from players import SourceOptions, open_source
from players.messages.image_decoding import (
    COLOR_ENCODINGS,
    color_of_pixels,
    decode_color,
    decode_compressed_depth,
    raw_pixels,
)
from players.messages.rvl import decode_rvl
from tests import player_scenes as scenes

RED = (200, 30, 40)
DEPTH_MM = np.arange(1, 40 * 60 + 1, dtype=np.uint16).reshape(40, 60) % 4000


def _message(encoding, rows, height, width):
    data = np.ascontiguousarray(rows).view(np.uint8)
    return SimpleNamespace(
        encoding=encoding, is_bigendian=0, height=height, width=width, step=data.shape[1], data=data.ravel()
    )


def _yuv(rgb):
    """Return Y, U, V by the formula of BT.601 in the studio range."""
    r, g, b = rgb
    y = 16 + (65.738 * r + 129.057 * g + 25.064 * b) / 256
    u = 128 + (-37.945 * r - 74.494 * g + 112.439 * b) / 256
    v = 128 + (112.439 * r - 94.154 * g - 18.285 * b) / 256
    return round(y), round(u), round(v)


Y, U, V = _yuv(RED)
PIXELS = {
    **dict.fromkeys(("yuv422", "uyvy", "UYVY"), np.tile([U, Y, V, Y], (4, 3))),
    **dict.fromkeys(("yuv422_yuy2", "yuyv"), np.tile([Y, U, Y, V], (4, 3))),
    # Colour has rows of its own.
    "nv12": np.vstack([np.full((4, 6), Y), np.tile([U, V], (2, 3))]),
    "nv21": np.vstack([np.full((4, 6), Y), np.tile([V, U], (2, 3))]),
}


@pytest.mark.parametrize("encoding", PIXELS)
def test_yuv_of_every_order_is_the_colour(encoding):
    message = _message(encoding, PIXELS[encoding].astype(np.uint8), 4, 6)
    np.testing.assert_allclose(color_of_pixels(raw_pixels(message, "image"), encoding), np.full((4, 6, 3), RED), atol=4)


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_of_every_pattern_is_the_colour(pattern, bits):
    encoding = f"bayer_{pattern}{bits}"
    tile = np.array([RED["rgb".index(letter)] for letter in pattern]).reshape(2, 2)
    mosaic = np.tile(tile, (8, 8)).astype(np.uint8)
    wide = (mosaic.astype(np.uint16) << 8) if bits == 16 else mosaic
    rgb = color_of_pixels(raw_pixels(_message(encoding, wide, 16, 16), "image"), encoding)
    np.testing.assert_array_equal(rgb[4:-4, 4:-4], np.full((8, 8, 3), RED))


def test_every_encoding_that_is_promised_is_decoded():
    for encoding in COLOR_ENCODINGS:
        rows = np.zeros((12 if encoding in ("nv12", "nv21") else 8, 8 * 8), dtype=np.uint8)
        assert color_of_pixels(raw_pixels(_message(encoding, rows, 8, 8), encoding), encoding).shape == (8, 8, 3)


def encode_rvl(pixels):
    flat = [int(pixel) for pixel in pixels.ravel()]
    nibbles = []

    def put(number):
        while True:
            low, number = number & 7, number >> 3
            nibbles.append(low | (8 if number else 0))
            if not number:
                return

    at, previous = 0, 0
    while at < len(flat):
        zeros = next((i for i in range(at, len(flat)) if flat[i]), len(flat))
        end = next((i for i in range(zeros, len(flat)) if not flat[i]), len(flat))
        put(zeros - at)
        put(end - zeros)
        for pixel in flat[zeros:end]:
            delta, previous = pixel - previous, pixel
            put((delta << 1) ^ (delta >> 31))
        at = end
    nibbles += [0] * (-len(nibbles) % 8)
    words = [nibbles[i : i + 8] for i in range(0, len(nibbles), 8)]
    return b"".join(sum(part << (28 - 4 * i) for i, part in enumerate(w)).to_bytes(4, "little") for w in words)


HEADER = struct.pack("<iff", 0, 0.0, 0.0)


@pytest.mark.parametrize("encoding", ["16UC1; compressedDepth", "16UC1; compressedDepth png", "png", "16UC1", ""])
@pytest.mark.parametrize("header", [HEADER, b""])
def test_millimetres_are_found_whatever_the_format_string_says(encoding, header):
    depth_m = decode_compressed_depth(header + scenes.png_bytes(DEPTH_MM), encoding, 1000.0, "depth")
    np.testing.assert_allclose(depth_m[DEPTH_MM > 0], DEPTH_MM[DEPTH_MM > 0] / 1000.0, rtol=1e-6)
    assert np.isnan(depth_m[DEPTH_MM == 0]).all()


@pytest.mark.parametrize("codec", ["png", "rvl"])
def test_inverse_depth_is_metres_again(codec):
    # The parameters that compressed_depth_image_transport writes for 10 m and quantisation 100.
    a, b = 100.0 * 101.0, 1.0 - 100.0 * 101.0 / 10.0
    true_m = np.linspace(0.5, 9.5, 64 * 48).reshape(48, 64).astype(np.float32)
    numbers = np.round(a / true_m + b).astype(np.uint16)
    numbers[0, :5] = 0
    packed = scenes.png_bytes(numbers) if codec == "png" else struct.pack("<ii", 64, 48) + encode_rvl(numbers)
    data = struct.pack("<iff", 0, a, b) + packed
    depth_m = decode_compressed_depth(data, f"32FC1; compressedDepth {codec}", 1000.0, "depth")
    assert np.isnan(depth_m[0, :5]).all()
    np.testing.assert_allclose(depth_m[1:], true_m[1:], rtol=0.01)


@pytest.mark.parametrize("parameters", [(0, 0.0, 0.0), (1, 5.0, 0.0), (0, float("nan"), 0.0)])
def test_inverse_depth_without_its_parameters_is_refused(parameters):
    data = struct.pack("<iff", *parameters) + scenes.png_bytes(DEPTH_MM)
    with pytest.raises(RecordingError, match="inverse depth without parameters"):
        decode_compressed_depth(data, "32FC1; compressedDepth png", 1000.0, "depth")


@given(arrays(np.uint16, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=st.integers(0, 65535)))
def test_rvl_is_lossless(pixels):
    np.testing.assert_array_equal(decode_rvl(encode_rvl(pixels), pixels.size), pixels.ravel())


def test_rvl_of_three_pixels_is_what_the_paper_says():
    # No zeros, three values: +5 (zigzag 10 = nibbles 2|8, 1), 0 (0), -1 (1); runs 0 and 3.
    word = int("03A10100"[:8], 16)
    assert decode_rvl(struct.pack("<I", word), 3).tolist() == [5, 5, 4]


@given(st.binary(max_size=80))
def test_noise_is_never_rvl_without_end(data):
    assert decode_rvl(data, 64) is None or len(data) >= 4


@given(st.binary(max_size=200), st.sampled_from(["16UC1; compressedDepth rvl", "32FC1; compressedDepth", "png"]))
def test_noise_is_refused_or_an_image_and_never_crashes(data, encoding):
    try:
        depth = decode_compressed_depth(data, encoding, 1000.0, "depth")
    except RecordingError:
        return
    assert depth.ndim == 2


def test_an_image_that_claims_to_be_huge_is_refused_early():
    bomb = bytearray(scenes.png_bytes(DEPTH_MM))
    bomb[16:24] = struct.pack(">II", 60_000, 60_000)
    with pytest.raises(RecordingError, match="60000x60000 pixels, over the limit"):
        decode_color(bytes(bomb), "image")
    with pytest.raises(RecordingError, match="60000x60000 pixels, over the limit"):
        decode_compressed_depth(bytes(bomb), "", 1.0, "image")


STAMP = "timestamp 1 Stamp,"
FOXGLOVE = {
    "Stamp": "seconds 1 int64,nanos 2 int32",
    "CompressedImage": STAMP + "frame_id 4 string,data 2 bytes,format 3 string", "RawImage": STAMP
    + "frame_id 7 string,width 2 fixed32,height 3 fixed32,encoding 4 string,step 5 fixed32,data 6 bytes",
    "CameraCalibration": STAMP + "frame_id 9 string,width 2 fixed32,height 3 fixed32,distortion_model 4 string,"
    "D 5 double[],K 6 double[],P 8 double[]", "Vector3": "x 1 double,y 2 double,z 3 double",
    "Quaternion": "x 1 double,y 2 double,z 3 double,w 4 double", "Pose": "position 1 Vector3,orientation 2 Quaternion",
    "PoseInFrame": STAMP + "frame_id 2 string,pose 3 Pose",
}  # fmt: skip


def _descriptors():
    """Return the descriptor set of Foxglove's messages, and the pool that makes them."""
    from google.protobuf import descriptor_pb2, descriptor_pool

    files = descriptor_pb2.FileDescriptorSet()
    file = files.file.add(name="foxglove/all.proto", package="foxglove", syntax="proto3")
    kinds = descriptor_pb2.FieldDescriptorProto
    scalars = {
        name: getattr(kinds, f"TYPE_{name.upper()}") for name in "string bytes double fixed32 int64 int32".split()
    }
    for name, fields in FOXGLOVE.items():
        entry = file.message_type.add(name=name)
        for field, number, kind in (one.split() for one in fields.split(",")):
            scalar = scalars.get(kind.removesuffix("[]"))
            label = kinds.LABEL_REPEATED if kind.endswith("[]") else kinds.LABEL_OPTIONAL
            named = {"type": scalar} if scalar else {"type": kinds.TYPE_MESSAGE, "type_name": f".foxglove.{kind}"}
            entry.field.add(name=field, number=int(number), label=label, **named)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(files.file[0])
    return files.SerializeToString(), pool


def _foxglove_log(path, frames, encoding):
    """Write the scene as Foxglove's messages: the pose is the camera's own."""
    from google.protobuf import json_format, message_factory

    descriptors, pool = _descriptors()
    camera = scenes.CAMERA
    with scenes.mcap_writer(path, "") as writer:
        channels = {}

        def put(topic, name, stamp_ns, fields):
            if topic not in channels:
                kind = "protobuf" if encoding == "protobuf" else "jsonschema"
                schema = writer.register_schema(f"foxglove.{name}", kind, descriptors if kind == "protobuf" else b"{}")
                channels[topic] = writer.register_channel(topic, encoding, schema)
            seconds, nanoseconds = divmod(stamp_ns, 10**9)
            if encoding == "json":
                data = json.dumps({"timestamp": {"sec": seconds, "nsec": nanoseconds}, **fields}).encode()
            else:
                kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(f"foxglove.{name}"))
                whole = {"timestamp": {"seconds": seconds, "nanos": nanoseconds}, **fields}
                data = json_format.ParseDict(whole, kind()).SerializeToString()
            writer.add_message(channels[topic], stamp_ns, data, stamp_ns)

        for frame in frames:
            x, y, z, qx, qy, qz, qw = scenes.pose_row(frame.world_from_camera)
            pose = {"position": {"x": x, "y": y, "z": z}, "orientation": {"x": qx, "y": qy, "z": qz, "w": qw}}
            put("/pose", "PoseInFrame", frame.stamp_ns, {"frame_id": "world", "pose": pose})
            png = base64.b64encode(scenes.png_bytes(frame.rgb[..., ::-1])).decode()
            image = {"frame_id": "cam", "format": "png", "data": png}
            put("/camera/color/image", "CompressedImage", frame.stamp_ns, image)
            raw = {
                "frame_id": "cam", "width": camera.width, "height": camera.height, "encoding": "16UC1",
                "step": 2 * camera.width, "data": base64.b64encode(frame.depth_mm.tobytes()).decode(),
            }  # fmt: skip
            put("/camera/depth/image", "RawImage", frame.stamp_ns, raw)
            info = {
                "frame_id": "cam", "width": camera.width, "height": camera.height, "K": camera.K.ravel().tolist(),
                "P": np.hstack([camera.K, np.zeros((3, 1))]).ravel().tolist(),
            }  # fmt: skip
            put("/camera/color/camera_info", "CameraCalibration", frame.stamp_ns, info)
    return path


@pytest.mark.parametrize("encoding", ["protobuf", "json"])
def test_foxgloves_messages_are_the_same_frames(tmp_path, encoding):
    truth = scenes.make_scene()
    source = open_source(_foxglove_log(tmp_path / "fox.mcap", truth, encoding), SourceOptions(pose_frame="cam"))
    frames = list(source.frames())
    assert [frame.stamp_ns for frame in frames] == [frame.stamp_ns for frame in truth]
    for raw, true in zip(frames, truth, strict=True):
        frame = raw.decode()
        np.testing.assert_array_equal(frame.rgb, true.rgb)
        np.testing.assert_allclose(frame.depth_m, true.depth_m, atol=1e-6)
        np.testing.assert_allclose(frame.world_from_camera, true.world_from_camera, atol=1e-6)
