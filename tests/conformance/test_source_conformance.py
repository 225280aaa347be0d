import shutil
import cv2
import numpy as np
import pytest
from mcap.writer import IndexType
from hickory_stream.errors import InputError
from hickory_stream.geometry.rigid import invert, rotation_angle_rad
from players import SourceOptions, open_source
from tests import player_scenes as scenes
from tests.examples.npz_source import NpzSource

REGISTERED = SourceOptions(profile="registered")


def _log(write, suffix="", ros=2, images=scenes.png_images, *, by_tf=False, **settings):
    """Return what writes frames as a log of messages."""

    def written(path, frames):
        m = scenes.Messages(ros=ros)
        messages = scenes.scene_messages(m, frames, images, with_odometry=not by_tf)
        return write(path.with_suffix(suffix), m, messages, **settings)

    return written


_SQLITE = _log(scenes.write_ros2, images=scenes.raw_images)
_BARE = dict.fromkeys(
    ("use_statistics", "use_chunking", "use_summary_offsets", "repeat_channels", "repeat_schemas"), False
)


def _npz(path, frames):
    path.parent.mkdir(parents=True, exist_ok=True)
    camera = scenes.CAMERA
    np.savez(
        path.with_suffix(".npz"),
        stamps_ns=np.array([frame.stamp_ns for frame in frames], np.int64),
        **{name: np.stack([getattr(f, name) for f in frames]) for name in ("rgb", "depth_m", "world_from_camera")},
        intrinsics=np.array([camera.fx, camera.fy, camera.cx, camera.cy]),
    )
    return path.with_suffix(".npz")


def _open_registered(path):
    return open_source(path, REGISTERED)


# How the scene is written in a format, and how what was written is opened. A source of one's own adds its line here.
FORMATS = {
    "7scenes": (scenes.write_seven_scenes, _open_registered), "tum": (scenes.write_tum, open_source),
    "posed": (scenes.write_posed_folder, open_source), "example": (_npz, NpzSource),
    "ros1": (_log(scenes.write_ros1, ".bag", 1, scenes.raw_images), open_source), "ros2_sqlite": (_SQLITE, open_source),
    "ros2_database": (lambda path, frames: next(_SQLITE(path, frames).glob("*.db3")), open_source),
    "ros2_mcap": (_log(scenes.write_ros2, by_tf=True, storage="mcap"), open_source),
    "mcap": (_log(scenes.write_mcap, ".mcap"), open_source),
    "mcap_without_index": (_log(scenes.write_mcap, ".mcap", index_types=IndexType.NONE, **_BARE), open_source),
}  # fmt: skip
HAS_NO_STAMPS = ("7scenes", "posed")

TRUTH = scenes.make_scene()


@pytest.fixture(scope="module", params=sorted(FORMATS))
def recording(request, tmp_path_factory):
    write, _ = FORMATS[request.param]
    return request.param, write(tmp_path_factory.mktemp(request.param) / "log", TRUTH)


@pytest.fixture
def source(recording):
    name, path = recording
    return FORMATS[name][1](path)


def _fields(frame):
    return frame.index, frame.stamp_ns, frame.camera, frame.world_from_camera.tobytes(), frame.color_bytes


def test_every_frame_is_the_scene_even_after_the_source_closed(source, recording):
    frames = list(source.frames())
    source.close()
    assert [frame.index for frame in frames] == list(range(len(TRUTH)))
    stamps = [frame.stamp_ns for frame in frames]
    assert stamps == (sorted(set(stamps)) if recording[0] in HAS_NO_STAMPS else [frame.stamp_ns for frame in TRUTH])
    assert source.info.camera == scenes.CAMERA
    for raw, truth in zip(frames, TRUTH, strict=True):
        frame = raw.decode()
        assert raw.camera == scenes.CAMERA
        np.testing.assert_array_equal(frame.rgb, truth.rgb)
        np.testing.assert_allclose(frame.depth_m, truth.depth_m, atol=1e-6)
        error = invert(truth.world_from_camera) @ raw.world_from_camera
        assert np.linalg.norm(error[:3, 3]) < 1e-3
        assert rotation_angle_rad(error[:3, :3]) < np.radians(0.05)
        if raw.color_bytes is not None:
            bgr = cv2.imdecode(np.frombuffer(raw.color_bytes, dtype=np.uint8), cv2.IMREAD_COLOR)
            np.testing.assert_array_equal(np.asarray(bgr)[..., ::-1], truth.rgb)


def test_every_pass_is_the_same_even_after_one_was_left_early(source):
    abandoned = source.frames()
    next(abandoned)
    first, second = ([_fields(frame) for frame in source.frames()] for _ in range(2))
    assert first == second
    assert source.ledger() == {"frames": len(TRUTH)}
    assert len(first) == len(TRUTH)
    assert len(list(abandoned)) == len(TRUTH) - 1


def test_decoding_repeats_what_the_raw_frame_says(source):
    raw = next(source.frames())
    frame, again = raw.decode(), raw.decode()
    assert (frame.index, frame.stamp_ns, frame.camera) == (raw.index, raw.stamp_ns, raw.camera)
    np.testing.assert_array_equal(frame.world_from_camera, raw.world_from_camera)
    np.testing.assert_array_equal(frame.depth_m, again.depth_m)
    np.testing.assert_array_equal(frame.rgb, again.rgb)


def test_the_info_names_kind_streams_and_length(source, recording):
    info = source.info
    assert info.uri == str(recording[1])
    assert info.kind
    assert {"color", "depth", "pose"} <= {role for role, _ in info.streams}
    assert info.num_frames == len(TRUTH)
    assert info.start_ns == next(source.frames()).stamp_ns


def test_the_identity_moves_with_the_log_and_differs_from_others(source, recording, tmp_path):
    name, path = recording
    write, opened = FORMATS[name]
    copy = tmp_path / "elsewhere" / path.name
    (shutil.copytree if path.is_dir() else _copy_file)(path, copy)
    assert opened(copy).info.identity == source.info.identity
    assert opened(write(tmp_path / "log", TRUTH[:-1])).info.identity != source.info.identity


def test_a_log_without_the_files_it_needs_is_an_input_error(recording, tmp_path):
    name, path = recording
    broken = tmp_path / path.name
    if path.is_dir():
        shutil.copytree(path, broken)
        for file in broken.rglob("*"):
            if file.suffix in (".png", ".mcap", ".db3"):
                file.unlink()
    else:
        broken.write_bytes(path.read_bytes()[:700])
    with pytest.raises(InputError, match=r"log"):
        list(FORMATS[name][1](broken).frames())


def _copy_file(source, target):
    target.parent.mkdir(parents=True)
    shutil.copy(source, target)
