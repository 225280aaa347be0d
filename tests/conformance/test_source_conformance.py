import shutil
import cv2
import numpy as np
import pytest
from hickory_stream.errors import InputError
from hickory_stream.geometry.rigid import invert, rotation_angle_rad
from players import SourceOptions, open_source
from tests import player_scenes as scenes
from tests.examples.npz_source import NpzSource

REGISTERED = SourceOptions(profile="registered")


def _ros1(path, frames):
    m = scenes.Messages(ros=1)
    return scenes.write_ros1(path.with_suffix(".bag"), m, scenes.scene_messages(m, frames, scenes.raw_images))


def _ros2_sqlite(path, frames):
    m = scenes.Messages(ros=2)
    return scenes.write_ros2(path, m, scenes.scene_messages(m, frames, scenes.raw_images))


def _ros2_database(path, frames):
    return next(_ros2_sqlite(path, frames).glob("*.db3"))


def _ros2_mcap(path, frames):
    m = scenes.Messages(ros=2)
    messages = scenes.scene_messages(m, frames, scenes.png_images, with_odometry=False)
    return scenes.write_ros2(path, m, messages, storage="mcap")


def _mcap(path, frames):
    m = scenes.Messages(ros=2)
    return scenes.write_mcap(path.with_suffix(".mcap"), m, scenes.scene_messages(m, frames, scenes.png_images))


def _mcap_without_index(path, frames):
    from mcap.writer import IndexType

    m = scenes.Messages(ros=2)
    messages = scenes.scene_messages(m, frames, scenes.png_images)
    bare = {"index_types": IndexType.NONE, "use_statistics": False, "use_chunking": False, "use_summary_offsets": False}
    return scenes.write_mcap(
        path.with_suffix(".mcap"), m, messages, **bare, repeat_channels=False, repeat_schemas=False
    )


def _npz(path, frames):
    path.parent.mkdir(parents=True, exist_ok=True)
    camera = scenes.CAMERA
    np.savez(
        path.with_suffix(".npz"),
        rgb=np.stack([frame.rgb for frame in frames]),
        depth_m=np.stack([frame.depth_m for frame in frames]),
        stamps_ns=np.array([frame.stamp_ns for frame in frames], np.int64),
        world_from_camera=np.stack([frame.world_from_camera for frame in frames]),
        intrinsics=np.array([camera.fx, camera.fy, camera.cx, camera.cy]),
    )
    return path.with_suffix(".npz")


def _open_registered(path):
    return open_source(path, REGISTERED)


# How the scene is written in a format, and how what was written is opened. A source of one's own adds its line here.
FORMATS = {
    "7scenes": (scenes.write_seven_scenes, _open_registered), "tum": (scenes.write_tum, open_source),
    "posed": (scenes.write_posed_folder, open_source), "ros1": (_ros1, open_source),
    "ros2_sqlite": (_ros2_sqlite, open_source), "ros2_database": (_ros2_database, open_source),
    "ros2_mcap": (_ros2_mcap, open_source), "mcap": (_mcap, open_source),
    "mcap_without_index": (_mcap_without_index, open_source), "example": (_npz, NpzSource),
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


def test_every_frame_of_the_log_is_yielded_in_order(source):
    frames = list(source.frames())
    assert [frame.index for frame in frames] == list(range(len(TRUTH)))
    stamps = [frame.stamp_ns for frame in frames]
    assert stamps == sorted(set(stamps))


def test_stamps_are_those_of_the_colour_images_to_the_nanosecond(source, recording):
    if recording[0] in HAS_NO_STAMPS:
        pytest.skip("the layout has no stamps")
    assert [frame.stamp_ns for frame in source.frames()] == [frame.stamp_ns for frame in TRUTH]


def test_colour_is_the_scene(source):
    for frame, truth in zip(source.frames(), TRUTH, strict=True):
        np.testing.assert_array_equal(frame.decode().rgb, truth.rgb)


def test_depth_is_in_metres_with_nan_where_nothing_returned(source):
    for frame, truth in zip(source.frames(), TRUTH, strict=True):
        np.testing.assert_allclose(frame.decode().depth_m, truth.depth_m, atol=1e-6)


def test_poses_are_right_to_a_millimetre_and_a_twentieth_degree(source):
    for frame, truth in zip(source.frames(), TRUTH, strict=True):
        error = invert(truth.world_from_camera) @ frame.world_from_camera
        assert np.linalg.norm(error[:3, 3]) < 1e-3
        assert rotation_angle_rad(error[:3, :3]) < np.radians(0.05)


def test_the_camera_is_the_scenes(source):
    assert source.info.camera == scenes.CAMERA
    assert all(frame.camera == scenes.CAMERA for frame in source.frames())


def test_a_second_pass_yields_the_same_frames(source):
    assert [_fields(frame) for frame in source.frames()] == [_fields(frame) for frame in source.frames()]


def test_a_pass_that_was_left_early_does_not_disturb_the_next(source):
    abandoned = source.frames()
    next(abandoned)
    assert len(list(source.frames())) == len(TRUTH)
    assert len(list(abandoned)) == len(TRUTH) - 1


def test_decoding_repeats_what_the_raw_frame_says(source):
    raw = next(source.frames())
    frame, again = raw.decode(), raw.decode()
    assert (frame.index, frame.stamp_ns, frame.camera) == (raw.index, raw.stamp_ns, raw.camera)
    np.testing.assert_array_equal(frame.world_from_camera, raw.world_from_camera)
    np.testing.assert_array_equal(frame.depth_m, again.depth_m)
    np.testing.assert_array_equal(frame.rgb, again.rgb)


def test_a_frame_can_be_decoded_after_the_source_was_closed(source):
    frames = list(source.frames())
    source.close()
    np.testing.assert_array_equal(frames[-1].decode().rgb, TRUTH[-1].rgb)


def test_compressed_colour_is_passed_on_as_it_was_recorded(source):
    for frame, truth in zip(source.frames(), TRUTH, strict=True):
        if frame.color_bytes is not None:
            bgr = cv2.imdecode(np.frombuffer(frame.color_bytes, dtype=np.uint8), cv2.IMREAD_COLOR)
            np.testing.assert_array_equal(np.asarray(bgr)[..., ::-1], truth.rgb)


def test_the_ledger_counts_every_frame_and_nothing_else(source):
    assert len(list(source.frames())) == source.ledger()["frames"] == len(TRUTH)
    assert set(source.ledger()) == {"frames"}


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
    if path.is_dir():
        broken = tmp_path / path.name
        shutil.copytree(path, broken)
        for file in broken.rglob("*"):
            if file.suffix in (".png", ".mcap", ".db3"):
                file.unlink()
    else:
        broken = tmp_path / path.name
        broken.write_bytes(path.read_bytes()[:700])
    with pytest.raises(InputError, match=r"log"):
        list(FORMATS[name][1](broken).frames())


def _copy_file(source, target):
    target.parent.mkdir(parents=True)
    shutil.copy(source, target)
