import asyncio
from dataclasses import replace
from pathlib import Path
import numpy as np
import pytest
from hickory_stream.box_scene import SceneSource
from hickory_stream.engine.mapper import Mapper
from hickory_stream.errors import CalibrationError, NoPosesError, RecordingError
from hickory_stream.evaluation.trajectory_error import trajectory_error
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.geometry.rigid import compose, from_rotation_translation, invert, yaw_rotation
from hickory_stream.perception.perceive import PerceptionConfig, perceive
from hickory_stream.ports import SourceAround
from hickory_stream.testing import InstanceSegmenter, MeanColorExtractor
from players import SourceOptions, open_source
from players.first_frames import FirstFrames
from players.poses.odometry_source import OdometrySource
from tests import player_scenes as scenes
from tests.cli.test_cli import answer, said
from tests.engine.run_fixtures import NO_SHAPES, scene_config
from tools.worlds.corridor import CorridorConfig, scan_from

DEMO = Path(__file__).resolve().parents[2] / "recordings" / "demo.mcap"
UNPOSED = SourceOptions(pose_topic="none")
BODY_FROM_LIDAR = from_rotation_translation(yaw_rotation(0.4), np.array([-0.1, 0.05, 0.5]))
HALL = CorridorConfig(length_m=9.0, width_m=6.0, beams=16, columns=360, sigma_m=0.01)
NUM_SWEPT = 12


def poses_of(source):
    frames = list(source.frames())
    return [frame.stamp_ns for frame in frames], np.array([frame.world_from_camera for frame in frames])


def test_a_log_without_poses_is_estimated_in_an_upright_world():
    found = poses_of(FirstFrames(open_source(DEMO, UNPOSED), 40))
    true = poses_of(FirstFrames(open_source(DEMO), 40))
    assert found[0] == true[0]
    error = trajectory_error(*found, *true)
    assert error.ate_m < 0.01 * error.way_m
    for mine, theirs in zip(found[1], true[1], strict=True):
        assert np.degrees(np.arccos(min(1.0, mine[2, :3] @ theirs[2, :3]))) < 1.0, "up is up"


def test_decoded_frames_are_at_the_estimated_poses_of_every_pass():
    source = FirstFrames(open_source(DEMO, UNPOSED), 15)
    found = poses_of(source)[1]
    assert found.tobytes() == poses_of(source)[1].tobytes()
    for raw, pose in zip(source.frames(), found[:3], strict=False):
        frame = raw.decode()
        assert (frame.index, frame.stamp_ns, raw.is_posed) == (raw.index, raw.stamp_ns, True)
        np.testing.assert_array_equal(frame.world_from_camera, raw.world_from_camera)
        np.testing.assert_array_equal(frame.world_from_camera, pose)
    assert dict(source.info.streams)["pose"] == "odometry: small_gicp on depth"


def test_with_poses_in_the_log_the_world_is_theirs():
    found = poses_of(FirstFrames(open_source(DEMO, SourceOptions(odometry="depth")), 15))
    true = poses_of(FirstFrames(open_source(DEMO), 15))
    np.testing.assert_array_equal(found[1][0], true[1][0])
    assert np.linalg.norm(found[1][-1][:3, 3] - true[1][-1][:3, 3]) < 0.03


@pytest.mark.parametrize("layout", ["seven_scenes", "tum"])
def test_a_folder_without_poses_uses_odometry_by_default(tmp_path, layout):
    frames = scenes.make_scene()
    folder = tmp_path / "log"
    if layout == "tum":
        scenes.write_tum(folder, frames)
        (folder / "groundtruth.txt").unlink()
    else:
        scenes.write_seven_scenes(folder, frames)
        for file in folder.glob("*.pose.txt"):
            file.unlink()
    options = SourceOptions(profile=layout if layout == "tum" else "registered")
    source = open_source(folder, options)
    assert isinstance(source, OdometrySource)
    with pytest.raises(NoPosesError, match=r"--odometry depth|no_pose"):
        open_source(folder, replace(options, odometry="topic"))
    first = next(iter(source.frames()))
    up = frames[0].world_from_camera[2, :3]
    assert np.degrees(np.arccos(min(1.0, first.world_from_camera[2, :3] @ up))) < 2.0


def test_an_unregistered_frame_is_left_out_and_counted(caplog):
    class Carried(SourceAround):
        """In the middle somebody holds the camera before a wall elsewhere."""

        def frames(self):
            for raw in super().frames():
                frame = raw.decode()
                if raw.index in (5, 6):
                    frame = replace(frame, depth_m=np.full_like(frame.depth_m, 0.4))
                yield replace(raw, decode=lambda frame=frame: frame)

    source = OdometrySource(FirstFrames(Carried(open_source(DEMO)), 10), "depth")
    assert [frame.index for frame in list(source.frames())] == list(range(8))
    assert source.ledger()["odometry_lost"] == 2
    assert caplog.text.count("is lost at") == 1
    assert caplog.text.count("goes on at") == 1


def swept_log(folder, *, lidar_frame="lidar", with_odometry=False, hall=HALL):
    """A log with a LiDAR that sees a bare hall, while the camera sees its own scene: only the motion is one."""
    m, frames = scenes.Messages(2), scenes.make_scene(num_frames=NUM_SWEPT)
    messages = scenes.scene_messages(m, frames, scenes.raw_images, with_odometry=with_odometry)
    messages = [each for each in messages if with_odometry or each.topic != "/tf"]
    mount = m.tf(0, ("base_link", "lidar", BODY_FROM_LIDAR))
    messages.append(scenes.Message(topic="/tf_static", stamp_ns=scenes.START_NS - 190_000_000, message=mount))
    rng = np.random.default_rng(5)
    axes = ({"name": name, "offset": 4 * i, "datatype": 7, "count": 1} for i, name in enumerate("xyz"))
    fields = [m.make("sensor_msgs/msg/PointField", **axis) for axis in axes]
    for frame in frames:
        # Between the images: poses have to be interpolated.
        stamp_ns = frame.stamp_ns - 30_000_000
        hall_from_world = from_rotation_translation(np.eye(3), np.array([0.5 * hall.length_m - 0.5, 0.0, -0.3]))
        world_from_lidar = scenes.pose_at(stamp_ns) @ invert(scenes.BODY_FROM_CAMERA) @ BODY_FROM_LIDAR
        points = scan_from(hall_from_world @ world_from_lidar, hall, rng)
        message = m.make(
            "sensor_msgs/msg/PointCloud2", header=m.header(stamp_ns, lidar_frame), height=1, width=len(points),
            fields=fields, is_bigendian=False, point_step=12, row_step=12 * len(points),
            data=points.view(np.uint8).ravel(), is_dense=True,
        )  # fmt: skip
        messages.append(scenes.Message(topic="/points", stamp_ns=stamp_ns, message=message))
    return scenes.write_ros2(folder / "log", m, sorted(messages, key=lambda each: each.stamp_ns))


def test_a_log_without_poses_is_played_by_its_lidar(tmp_path):
    source = open_source(swept_log(tmp_path))
    assert dict(source.info.streams)["pose"] == "odometry: small_gicp on lidar"
    assert dict(source.info.streams)["lidar_to_camera"].startswith("TF of the log")
    stamps_ns, poses = poses_of(source)
    # The first image lies after the first sweep, the last one after the last: beyond the last nothing is known.
    assert len(poses) == NUM_SWEPT - 1
    true = np.array([scenes.pose_at(stamp_ns) for stamp_ns in stamps_ns])
    assert trajectory_error(stamps_ns, poses, stamps_ns, true).ate_m < 0.01
    moved, truly = compose(invert(poses[0]), poses[-1]), compose(invert(true[0]), true[-1])
    np.testing.assert_allclose(moved[:3, 3], truly[:3, 3], atol=0.02)


def test_a_pose_topic_predicts_how_the_lidar_moved(tmp_path):
    source = open_source(swept_log(tmp_path, with_odometry=True), SourceOptions(odometry="lidar"))
    stamps_ns, poses = poses_of(source)
    true = np.array([scenes.pose_at(stamp_ns) for stamp_ns in stamps_ns])
    np.testing.assert_allclose(poses[0], true[0], atol=1e-6)
    np.testing.assert_allclose(poses[-1][:3, 3], true[-1][:3, 3], atol=0.02)


def test_camera_axes_turn_the_link_to_the_lidar_too(tmp_path):
    profile, log = tmp_path / "axes.toml", swept_log(tmp_path, with_odometry=True)
    profile.write_text('camera_axes = "-y -z x"\n')
    _, plain = poses_of(open_source(log, SourceOptions(odometry="lidar")))
    _, turned = poses_of(open_source(log, SourceOptions(odometry="lidar", profile=str(profile))))
    axes = from_rotation_translation(np.array([[0, 0, 1.0], [-1, 0, 0], [0, -1, 0]]), np.zeros(3))
    for before, after in zip(plain, turned, strict=True):
        np.testing.assert_allclose(after, before @ axes, atol=1e-3)
    with pytest.raises(CalibrationError, match="found camera_axes in the profile with --extrinsics estimate"):
        open_source(DEMO, SourceOptions(extrinsics="estimate", profile=str(profile)))


def test_a_frame_says_what_the_scans_left_open(tmp_path):
    endless = replace(HALL, length_m=60.0, width_m=3.0, range_m=10.0)
    source = open_source(swept_log(tmp_path, with_odometry=True, hall=endless), SourceOptions(odometry="lidar"))
    last = list(source.frames())[-1].decode()
    (direction,) = last.degenerate[np.abs(last.degenerate[:, 3:]).max(axis=1) > 0]
    assert abs((last.world_from_camera[:3, :3] @ direction[3:])[0]) > 0.99
    segmenter = InstanceSegmenter({last.stamp_ns: np.zeros(last.depth_m.shape, np.int32)})
    seen = perceive(last, None, None, segmenter, PerceptionConfig(), lattice=Lattice())
    assert np.array_equal(seen.event(last).degenerate, last.degenerate)


def test_an_unconnected_or_missing_lidar_is_not_used_for_poses(tmp_path):
    log = swept_log(tmp_path, lidar_frame="somewhere")
    with pytest.raises(CalibrationError, match="no static transform from the LiDAR's frame somewhere to the camera's"):
        open_source(log, SourceOptions(odometry="lidar"))
    assert dict(open_source(log).info.streams)["pose"] == "odometry: small_gicp on depth"
    with pytest.raises(RecordingError, match=r"has no LiDAR .*; choose --odometry depth"):
        open_source(DEMO, SourceOptions(odometry="lidar"))


def test_after_an_interruption_poses_go_on_from_the_journal():
    """On another kind of processor they may differ: what follows is moved along, by the same rigid motion."""
    plain = poses_of(FirstFrames(open_source(DEMO, UNPOSED), 8))
    moved = from_rotation_translation(yaw_rotation(0.1), np.array([0.05, -0.02, 0.01]))
    source = open_source(DEMO, UNPOSED)
    assert isinstance(source, OdometrySource)
    source.continue_from(plain[0][4], compose(moved, plain[1][4]))
    found = poses_of(FirstFrames(source, 8))
    np.testing.assert_array_equal(found[1][:4], plain[1][:4])
    np.testing.assert_allclose(found[1][4:], np.array([moved @ pose for pose in plain[1][4:]]), atol=1e-12)


def test_a_stopped_odometry_run_resumes_to_the_same_map(tmp_path):
    count = 16
    instances = SceneSource(count).instances

    async def run(name, *, stops_at=None, resumes=False):
        parts = {"segmenter": InstanceSegmenter(instances), "extractor": MeanColorExtractor()}
        mapper = (
            Mapper.resuming(tmp_path / name, **parts)
            if resumes
            else Mapper(scene_config(tmp_path / f"{name}-config", *NO_SHAPES), out=tmp_path / name, **parts)
        )
        async with mapper:
            snapshots = mapper.run(
                OdometrySource(SceneSource(count), "depth"),
                progress=lambda progress: mapper.stop() if progress.keyframes == stops_at else None,
            )
            async for _ in snapshots:
                pass
            return mapper.folder.manifest

    whole = asyncio.run(run("whole"))
    assert whole.processor, "odometry rounds as its processor does"
    assert not asyncio.run(run("stopped", stops_at=4)).finished_cleanly
    assert asyncio.run(run("stopped", resumes=True)).digest == whole.digest
    answer("replay", tmp_path / "stopped")


def test_the_command_writes_tum_and_the_errors(tmp_path):
    log, out = scenes.write_seven_scenes(tmp_path / "log", scenes.make_scene()), tmp_path / "poses.tum"
    asked = ("odometry", log, "--profile", "registered", "--pose-topic", "none", "-o", out)
    assert "have a true one within 10 ms" in answer(*asked, "--truth", DEMO, status=2)["message"]
    told = answer(*asked)
    assert (told["poses"], told["lost"], told["error"]) == (scenes.NUM_FRAMES, 0, None)
    rows = np.loadtxt(out)
    assert rows.shape == (scenes.NUM_FRAMES, 8)
    np.testing.assert_allclose(np.linalg.norm(rows[:, 4:], axis=1), 1.0, atol=1e-6)
    assert said(*asked, "--overwrite").count(out.name) == 1
    by_topic = ("odometry", log, "--profile", "registered", "--odometry", "topic", "--truth", out)
    assert "6 poses on a path of" in said(*by_topic)


def test_the_first_frames_of_a_log_are_those_of_the_log():
    stamps = [raw.stamp_ns for raw in open_source(DEMO).frames()]
    source = FirstFrames(open_source(DEMO), 5)
    for _ in range(2):
        assert [raw.stamp_ns for raw in source.frames()] == stamps[:5]
    assert source.info.num_frames == 5
    with pytest.raises(ValueError, match="first 0"):
        FirstFrames(open_source(DEMO), 0)
