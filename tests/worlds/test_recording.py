import struct
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore
from hickory_stream.errors import ConfigError
from hickory_stream.evaluation.truth import instances_of, load_truth, mesh_of, structure_meshes
from hickory_stream.geometry.camera import backproject, project
from hickory_stream.geometry.mesh import sample_surface
from hickory_stream.geometry.rigid import apply, invert, rotation_from_quaternion
from hickory_stream.worlds import zed_log
from hickory_stream.worlds.depth_camera import DepthCameraConfig, sensed_depth
from hickory_stream.worlds.recording import make_recording
from hickory_stream.worlds.recording_config import RecordingConfig

ROOT = Path(__file__).resolve().parents[2]
SHORT = RecordingConfig(seed=3, seconds=1.5, rate_hz=4.0, width=160, height=90)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recording")
    make_recording(SHORT, folder, "short")
    return folder


@pytest.fixture(scope="module")
def messages(recording):
    store = get_typestore(Stores.ROS2_HUMBLE)
    by_topic = {}
    with (recording / "short.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        log_times = []
        for schema, channel, message in reader.iter_messages():
            assert schema.encoding == "ros2msg"
            log_times.append(message.log_time)
            by_topic.setdefault(channel.topic, []).append(store.deserialize_cdr(message.data, schema.name))
    assert all(a <= b for a, b in pairwise(log_times))
    return by_topic


def stamp_ns(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def matrix(translation, rotation):
    a_from_b = np.eye(4)
    a_from_b[:3, :3] = rotation_from_quaternion(rotation.x, rotation.y, rotation.z, rotation.w)
    a_from_b[:3, 3] = (translation.x, translation.y, translation.z)
    return a_from_b


def test_the_same_config_makes_the_same_bytes(recording, tmp_path):
    make_recording(SHORT, tmp_path, "short")
    ours = sorted(path.relative_to(recording) for path in recording.rglob("*") if path.is_file())
    assert ours == sorted(path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file())
    for path in ours:
        assert (recording / path).read_bytes() == (tmp_path / path).read_bytes(), path


def test_each_image_has_its_stamp_its_size_and_its_camera(recording, messages):
    truth = load_truth(recording / "short.truth")
    stamps = [frame.stamp_ns for frame in truth.frames]
    assert len(stamps) == 6
    for topic in (zed_log.COLOR_TOPIC, zed_log.DEPTH_TOPIC, zed_log.COLOR_INFO_TOPIC, zed_log.DEPTH_INFO_TOPIC):
        assert [stamp_ns(message) for message in messages[topic]] == stamps
        assert {message.header.frame_id for message in messages[topic]} == {"zed_left_camera_frame_optical"}
    info = messages[zed_log.DEPTH_INFO_TOPIC][0]
    assert (info.distortion_model, info.d.tolist()) == ("rational_polynomial", [0.0] * 8)
    assert info.k.reshape(3, 3) == pytest.approx(truth.camera.K)
    assert cv2.imdecode(messages[zed_log.COLOR_TOPIC][0].data, cv2.IMREAD_COLOR).shape == (90, 160, 3)


def test_odometry_and_static_frames_compose_to_the_true_poses(recording, messages):
    truth = load_truth(recording / "short.truth")
    link_from_optical = np.eye(4)
    frame = "zed_camera_link"
    for link in messages["/tf_static"][0].transforms:
        assert link.header.frame_id == frame
        frame = link.child_frame_id
        link_from_optical = link_from_optical @ matrix(link.transform.translation, link.transform.rotation)
    assert frame == "zed_left_camera_frame_optical"
    odometry = {stamp_ns(m): m for m in messages[zed_log.ODOM_TOPIC]}
    transforms = {stamp_ns(m.transforms[0]): m.transforms[0] for m in messages["/tf"]}
    assert np.diff(sorted(odometry)).max() <= 1e9 / 30 + 1
    for true in truth.frames:
        pose = odometry[true.stamp_ns].pose.pose
        odom_from_link = matrix(pose.position, pose.orientation)
        assert odom_from_link @ link_from_optical == pytest.approx(true.world_from_camera, abs=1e-9)
        transform = transforms[true.stamp_ns].transform
        assert matrix(transform.translation, transform.rotation) == pytest.approx(odom_from_link)


def test_sensed_depth_lies_on_the_true_objects(recording, messages):
    truth = load_truth(recording / "short.truth")
    for frame, message in zip(truth.frames, messages[zed_log.DEPTH_TOPIC], strict=True):
        assert message.format == "16UC1; compressedDepth png"
        assert struct.unpack("<iff", message.data[:12].tobytes()) == (0, 0.0, 0.0)
        millimetres = cv2.imdecode(message.data[12:], cv2.IMREAD_UNCHANGED)
        assert millimetres.dtype == np.uint16
        depth_m = np.where(millimetres > 0, millimetres / 1000.0, np.nan).astype(np.float32)
        assert 0.02 < np.isnan(depth_m).mean() < 0.35
        points = apply(frame.world_from_camera, backproject(depth_m, truth.camera))
        instances = instances_of(truth, frame)
        for item in truth.objects:
            mine = points[(instances == item.id) & np.isfinite(depth_m)]
            if len(mine) < 30:
                continue
            vertices = apply(item.world_from_object, mesh_of(truth, item).vertices)
            # A fifth of a pixel of disparity: three sigma of the camera's noise.
            distance_m = np.linalg.norm(mine - frame.world_from_camera[:3, 3], axis=1, keepdims=True)
            margin_m = 0.2 * distance_m**2 / (truth.camera.fx * SHORT.depth.baseline_m)
            inside = ((mine > vertices.min(axis=0) - margin_m) & (mine < vertices.max(axis=0) + margin_m)).all(axis=1)
            assert inside.mean() > 0.7, item.kind


def test_frames_lists_exactly_the_images_of_an_object(recording):
    truth = load_truth(recording / "short.truth")
    shown = {item.id: [] for item in truth.objects}
    for frame in truth.frames:
        for i in np.unique(instances_of(truth, frame)):
            if i:
                shown[int(i)].append(frame.index)
    for item in truth.objects:
        assert list(item.frames) == shown[item.id]
        assert 0.0 <= item.seen_fraction < 1.0
        assert item.seen_fraction == 0.0 or item.frames


def test_true_meshes_project_onto_their_instances(recording):
    truth = load_truth(recording / "short.truth")
    frame = truth.frames[0]
    instances = instances_of(truth, frame)
    counts = np.bincount(instances.ravel(), minlength=len(truth.objects) + 1)
    item = max(truth.objects, key=lambda item: counts[item.id])
    points, _ = sample_surface(mesh_of(truth, item), 60_000, np.random.default_rng(0))
    world = apply(item.world_from_object, points)
    u, v = np.round(project(apply(invert(frame.world_from_camera), world), truth.camera)).T
    drawn = np.zeros(instances.shape, dtype=bool)
    inside = (u >= 0) & (v >= 0) & (u < truth.camera.width) & (v < truth.camera.height)
    drawn[v[inside].astype(int), u[inside].astype(int)] = True
    assert (drawn & (instances == item.id)).sum() / (instances == item.id).sum() > 0.7


def test_the_structure_encloses_the_objects(recording):
    truth = load_truth(recording / "short.truth")
    walls = np.concatenate([mesh.vertices for mesh in structure_meshes(truth)])
    for item in truth.objects:
        vertices = apply(item.world_from_object, mesh_of(truth, item).vertices)
        assert (vertices.min(axis=0) > walls.min(axis=0)).all()
        assert (vertices.max(axis=0) < walls.max(axis=0)).all()


@pytest.mark.parametrize(
    "wrong", [{"seconds": 0.0}, {"rate_hz": -1.0}, {"seconds": 0.1, "rate_hz": 2.0}, {"width": 8}, {"seed": -1}]
)
def test_an_impossible_config_is_refused(wrong):
    with pytest.raises(ConfigError, match="expected"):
        RecordingConfig(**wrong)


def test_a_folder_that_is_no_truth_folder_is_not_replaced(tmp_path):
    (tmp_path / "mine.truth").mkdir()
    (tmp_path / "mine.truth" / "letter.txt").write_text("keep me")
    with pytest.raises(ConfigError, match=r"mine\.truth is there and has no truth\.json"):
        make_recording(SHORT, tmp_path, "mine")
    assert (tmp_path / "mine.truth" / "letter.txt").read_text() == "keep me"


def test_the_tool_refuses_a_size_it_cannot_read_with_status_2():
    command = [sys.executable, str(ROOT / "tools" / "make_recording"), "--size", "wide"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "--size 'wide'; expected WIDTHxHEIGHT" in done.stderr
    assert "Traceback" not in done.stderr


FOCAL_PX = 381.0
ONLY_NOISE = DepthCameraConfig(dropout_share=0.0, disparity_step_px=1 / 4096)


def plane(depth_m):
    return np.full((200, 300), depth_m, dtype=np.float32), np.ones((200, 300), dtype=np.float32)


def test_noise_grows_with_the_square_of_the_depth():
    spread = {}
    for depth_m in (1.0, 2.0, 4.0):
        spread[depth_m] = np.nanstd(sensed_depth(*plane(depth_m), FOCAL_PX, ONLY_NOISE, np.random.default_rng(0)))
        # Error propagation through z = f b / d.
        expected = depth_m**2 / (FOCAL_PX * ONLY_NOISE.baseline_m) * ONLY_NOISE.disparity_sigma_px
        assert spread[depth_m] == pytest.approx(expected, rel=0.1)
    assert spread[4.0] / spread[1.0] == pytest.approx(16, rel=0.05)


def test_disparities_are_multiples_of_their_step():
    config = DepthCameraConfig()
    sensed = sensed_depth(*plane(2.5), FOCAL_PX, config, np.random.default_rng(0))
    steps = FOCAL_PX * config.baseline_m / sensed[np.isfinite(sensed)] / config.disparity_step_px
    assert np.abs(steps - np.round(steps)).max() < 1e-3


def test_patches_alone_lose_their_share():
    config = DepthCameraConfig(dropout_share=0.1)
    sensed = sensed_depth(*plane(2.0), FOCAL_PX, config, np.random.default_rng(0))
    assert np.isnan(sensed).mean() == pytest.approx(0.1, abs=0.005)


def test_nothing_is_reported_out_of_range_or_at_a_grazing_angle():
    depth, cosine = plane(2.0)
    depth[:, :50], depth[:, 50:100] = 0.2, 9.0
    cosine[:, 150:200] = 0.0
    sensed = sensed_depth(depth, cosine, FOCAL_PX, ONLY_NOISE, np.random.default_rng(0))
    for lost in (slice(0, 49), slice(51, 99), slice(150, 200)):
        assert np.isnan(sensed[:, lost]).all()
    assert np.isfinite(sensed[:, 205:]).all()


def test_a_near_thing_throws_a_stereo_shadow_to_its_left():
    depth, cosine = plane(4.0)
    depth[:, 150:] = 1.0
    config = DepthCameraConfig(dropout_share=0.0, disparity_sigma_px=0.0, edge_loss=0.0, flying_share=0.0)
    sensed = sensed_depth(depth, cosine, FOCAL_PX, config, np.random.default_rng(0))
    # f b (1 / 1 m - 1 / 4 m) = 34.3 pixels.
    assert np.isnan(sensed).sum(axis=1) == pytest.approx(34, abs=1)
    assert np.isnan(sensed[:, 120:150]).all()


def test_flying_pixels_lie_between_the_two_depths_of_an_edge():
    depth, cosine = plane(3.0)
    depth[:, :150] = 2.0
    config = DepthCameraConfig(dropout_share=0.0, disparity_sigma_px=0.0, edge_loss=0.0, flying_share=1.0)
    sensed = sensed_depth(depth, cosine, FOCAL_PX, config, np.random.default_rng(0))
    at_edge = sensed[:, 149:151]
    assert ((at_edge > 2.05) & (at_edge < 2.95)).mean() > 0.7
    assert np.isfinite(sensed[:, :148]).all()


def test_the_generator_alone_decides():
    one, same, other = (
        sensed_depth(*plane(2.0), FOCAL_PX, DepthCameraConfig(), np.random.default_rng(seed)) for seed in (1, 1, 2)
    )
    assert np.array_equal(one, same, equal_nan=True)
    assert not np.array_equal(one, other, equal_nan=True)


@pytest.mark.parametrize("depth_m", [1.0, 2.5, 5.0])
def test_the_stated_sensor_has_its_noise_steps_and_range(depth_m):
    config = DepthCameraConfig(dropout_share=0.0)
    sensor = config.sensor(FOCAL_PX)
    sensed = sensed_depth(*plane(depth_m), FOCAL_PX, config, np.random.default_rng(0))
    sigma_m = float(sensor.sigma_m(np.array([depth_m], dtype=np.float32))[0])
    assert np.nanstd(sensed) == pytest.approx(sigma_m, rel=0.12)
    steps = 1 / sensed[np.isfinite(sensed)] / sensor.step_per_m
    assert np.abs(steps - np.round(steps)).max() < 1e-2
    ends = np.array([[sensor.min_m - 0.05, sensor.max_m + 1.0]], dtype=np.float32)
    assert np.isnan(sensed_depth(ends, np.ones_like(ends), FOCAL_PX, config, np.random.default_rng(0))).all()
