from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.errors import CalibrationError
from hickory_stream.geometry.rigid import from_rotation_translation, invert, yaw_rotation
from players import SourceOptions, open_source
from players.doctor.diagnosis import examine
from tests import player_scenes as scenes

MS, S = 1_000_000, 1_000_000_000
M = scenes.Messages(ros=2)
TRUTH = scenes.make_scene(num_frames=25)
BY_TF = scenes.scene_messages(M, TRUTH, scenes.png_images, with_odometry=False)
BY_ODOMETRY = scenes.scene_messages(M, TRUTH, scenes.png_images)
POSED = ("/tf", "/tf_static", "/odom")
MIDDLE = TRUTH[12].stamp_ns


def _source(path, messages, **options):
    return open_source(scenes.write_mcap(path / "log.mcap", M, messages), SourceOptions(**options))


def _errors(source):
    frames = list(source.frames())
    true = {frame.stamp_ns: frame.world_from_camera for frame in TRUTH}
    return [float(np.abs(frame.world_from_camera - true[frame.stamp_ns]).max()) for frame in frames]


def _is_right(source, number=25):
    errors = _errors(source)
    return len(errors) == number and max(errors) < 2e-3


def _drives(stamp_ns):
    """Return odom_from_base of another robot, which drives a circle elsewhere."""
    angle = 0.5 * (stamp_ns - scenes.START_NS) / 1e9
    return from_rotation_translation(yaw_rotation(angle), np.array([4 + np.sin(angle), np.cos(angle), 0.5]))


def _of_robots(log, own, other, camera, late_ns=MS):
    """Return the log of two robots with equal frames; the camera's images are under `camera`."""
    messages = []
    for m in log:
        messages.append(replace(m, topic=(own if m.topic in POSED else camera) + m.topic))
        if m.topic in POSED:
            message = m.message
            if m.topic == "/tf":
                message = M.tf(m.stamp_ns, ("odom", "base_link", _drives(m.stamp_ns)))
            elif m.topic == "/odom":
                message = M.odometry(m.stamp_ns, "odom", "base_link", _drives(m.stamp_ns))
            messages.append(replace(m, topic=other + m.topic, stamp_ns=m.stamp_ns + late_ns, message=message))
    return sorted(messages, key=lambda m: m.stamp_ns)


@pytest.mark.parametrize("late_ms", [1, -2])
@pytest.mark.parametrize("log", [BY_TF, BY_ODOMETRY], ids=["tf", "odometry"])
@pytest.mark.parametrize(("own", "other"), [("/robot1", "/robot2"), ("/r/b", "/r/a"), ("/alpha", ""), ("", "/zulu")])
def test_the_poses_are_those_of_the_cameras_own_robot(tmp_path, log, own, other, late_ms):
    assert _is_right(_source(tmp_path, _of_robots(log, own, other, own, late_ms * MS)))


def _moved(log, *moves):
    return [replace(m, topic=dict(moves).get(m.topic, m.topic)) for m in log]


def _one_robot():
    wheels = [replace(m, topic="/wheel/odom") for m in BY_ODOMETRY if m.topic == "/odom"]
    spot = _moved([replace(m, topic=f"/spot{m.topic}") for m in BY_TF], ("/spot/tf_static", "/spot/arm/tf_static"))
    arm = [_link("base_link", "arm", AHEAD, m.stamp_ns, "/spot/arm/tf") for m in BY_TF if m.topic == "/tf"]
    unlinked = [m for m in _of_robots(BY_ODOMETRY, "/r1", "/r2", "/r1") if "tf_static" not in m.topic]
    return {
        "two odometries": _with(_moved(BY_ODOMETRY, ("/odom", "/vio/odom")), *wheels), "a part": _with(spot, *arm),
        "the only tf": _moved(BY_TF, ("/tf", "/husky/tf")), "no tf of their own": [BY_TF[0], *unlinked],
    }  # fmt: skip


@pytest.mark.parametrize("name", ["two odometries", "a part", "the only tf", "no tf of their own"])
def test_a_log_with_one_robot_of_the_camera_needs_no_choice(tmp_path, name):
    source = _source(tmp_path, _one_robot()[name])
    assert name != "two odometries" or dict(source.info.streams)["pose"] == "/vio/odom"
    assert _is_right(source)


@pytest.mark.parametrize("log", [BY_TF, BY_ODOMETRY], ids=["tf", "odometry"])
def test_a_camera_of_no_robot_asks_for_its_robot(tmp_path, log):
    messages = _of_robots(log, "/zulu", "/alpha", "")
    with pytest.raises(CalibrationError, match=r"(/zulu|/alpha)/(tf|odom) and .*robots.*--pose-topic"):
        _source(tmp_path, messages)
    assert _is_right(_source(tmp_path, messages, pose_topic="/zulu/tf" if log is BY_TF else "/zulu/odom"))


def _link(parent, child, at, stamp_ns=scenes.START_NS, topic="/tf_static"):
    return scenes.Message(topic=topic, stamp_ns=stamp_ns, message=M.tf(stamp_ns, (parent, child, at)))


def _with(log, *more):
    return sorted([*log, *more], key=lambda m: m.stamp_ns)


AHEAD = from_rotation_translation(np.eye(3), np.array([0.1, 0.0, 0.0]))
NOMINAL = _link("cam_link", scenes.OPTICAL, AHEAD @ scenes.BODY_FROM_CAMERA, BY_TF[0].stamp_ns + 1)


@pytest.mark.parametrize(
    ("parent", "said"), [("cam_link", "100 mm and 0.0 degrees from"), ("base_link", "in place of cam_link")]
)
@pytest.mark.parametrize("i", [4, 20])
@pytest.mark.parametrize("log", [BY_TF, BY_ODOMETRY], ids=["tf", "odometry"])
def test_a_static_link_published_again_is_used_from_then_on(tmp_path, log, i, parent, said):
    first = [replace(NOMINAL, stamp_ns=log[0].stamp_ns) if m is log[0] else m for m in log]
    base = _link("base_link", "cam_link", np.eye(4), log[0].stamp_ns)
    late = _link(parent, scenes.OPTICAL, scenes.BODY_FROM_CAMERA, TRUTH[i].stamp_ns)
    source = _source(tmp_path, _with(first, base, late))
    errors = np.array(_errors(source))
    assert (errors[: i - 2] > 0.05).all()
    assert (errors[i + 1 :] < 2e-3).all()
    (text,) = source.findings()
    assert text.startswith(f"/tf_static: cam_optical in {parent} was published again ({said}")
    assert text in examine([tmp_path / "log.mcap"], SourceOptions()).notes


def test_a_link_of_depth_published_again_is_used_from_then_on(tmp_path):
    def link(x, stamp_ns):
        return _link(scenes.OPTICAL, "depth", from_rotation_translation(np.eye(3), np.array([x, 0, 0])), stamp_ns)

    log = [
        replace(m, message=replace(m.message, header=M.header(m.stamp_ns, "depth")))
        if m.topic in ("/cam/aligned_depth/camera_info", scenes.PNG_DEPTH) else m for m in BY_TF
    ]  # fmt: skip
    source = _source(tmp_path, _with(log, link(0.1, BY_TF[0].stamp_ns), link(0.0, TRUTH[20].stamp_ns)))
    frames = [frame.decode() for frame in source.frames()]
    same = [np.array_equal(f.depth_m, true.depth_m, equal_nan=True) for f, true in zip(frames, TRUTH, strict=True)]
    assert not any(same[:18])
    assert all(same[21:])


def test_a_static_link_that_is_repeated_is_no_fault(tmp_path):
    again = [replace(BY_TF[0], stamp_ns=MIDDLE + i * MS) for i in range(3)]
    source = _source(tmp_path, _with(BY_TF, *again))
    assert _is_right(source)
    assert source.findings() == {}


def _scaled(factor):
    def scaled(rotation):
        return replace(rotation, **{axis: factor * getattr(rotation, axis) for axis in "xyzw"})

    return scaled


def _changed(log, topic, change):
    """Return the log with the first transform of each message of a topic turned by `change`."""

    def changed(message):
        first, *rest = message.transforms
        turned = replace(first.transform, rotation=change(first.transform.rotation))
        return replace(message, transforms=[replace(first, transform=turned), *rest])

    return [replace(m, message=changed(m.message)) if m.topic == topic else m for m in log]


LOOPS = [_link("base_link", "base_link", AHEAD, m.stamp_ns + 1, "/tf") for m in BY_TF if m.topic == "/tf"]


@pytest.mark.parametrize(("messages", "said"), [
    (_changed(BY_TF, "/tf", _scaled(0.5)), "/tf: base_link in odom has quaternions of another length than 1"),
    (_with(BY_TF, *LOOPS), "/tf: base_link in base_link is left out"),
], ids=["length", "own parent"])  # fmt: skip
def test_a_transform_that_is_odd_is_named(tmp_path, messages, said):
    source = _source(tmp_path, messages)
    assert _is_right(source)
    assert said in next(iter(source.findings()))


def test_a_quaternion_of_zero_is_named_with_its_link(tmp_path):
    told = r"/tf_static: cam_link in base_link is left out .* quaternion of length 0"
    with pytest.raises(CalibrationError, match=told):
        _source(tmp_path, _changed(BY_ODOMETRY, "/tf_static", _scaled(0.0)))


@pytest.mark.parametrize("frame", ["odom", "world", "/odom"])
def test_odometry_whose_child_is_its_parent_is_left_out_for_tf(tmp_path, frame):
    name = frame.strip("/")
    odometry = [
        replace(m, message=M.odometry(m.stamp_ns, frame, name, scenes.pose_at(m.stamp_ns)))
        for m in BY_ODOMETRY
        if m.topic == "/odom"
    ]
    source = _source(tmp_path, _with(BY_TF, *odometry))
    assert _is_right(source)
    assert list(source.findings()) == [
        f"/odom is left out: its child frame {name} is its parent, so that its body is not known; name that with "
        "--pose-frame"
    ]


def test_odometry_whose_child_is_its_parent_alone_is_refused(tmp_path):
    odometry = [
        replace(m, message=replace(m.message, child_frame_id="odom")) if m.topic == "/odom" else m for m in BY_ODOMETRY
    ]
    with pytest.raises(CalibrationError, match=r"/odom is left out: its child frame odom is its parent.*--pose-frame"):
        _source(tmp_path, odometry)
    assert _is_right(_source(tmp_path, odometry, pose_frame="base_link"))


@pytest.mark.parametrize("clock_ns", [12 * S, scenes.START_NS + 3600 * S])
def test_a_link_of_a_foreign_clock_harms_only_itself(tmp_path, clock_ns):
    wheels = []
    for i, m in enumerate(m for m in BY_TF if m.topic == "/tf"):
        turned = from_rotation_translation(yaw_rotation(0.1 * i), np.zeros(3))
        for step in range(2):  # two in a row, so that they look like a clock that was set
            message = M.tf(clock_ns + (2 * i + step) * 10 * MS, ("base_link", "wheel", turned))
            wheels.append(scenes.Message(topic="/tf", stamp_ns=m.stamp_ns + 1 + step, message=message))
    assert _is_right(_source(tmp_path, _with(BY_TF, *wheels)))


def test_two_publishers_of_one_link_are_reported(tmp_path):
    rivals = [_link("odom", "base_link", _drives(m.stamp_ns + 7 * MS), m.stamp_ns + 7 * MS, "/tf") for m in BY_TF[40:]]
    source = _source(tmp_path, _with(BY_TF, *rivals))
    list(source.frames())
    (text,) = [text for text, is_harmful in source.findings().items() if is_harmful]
    assert text.startswith("/tf: base_link in odom goes back and forth")
    assert text in examine([tmp_path / "log.mcap"], SourceOptions()).problems


def _sim_time(log, topics, start_ns):
    def moved(m):
        stamp_ns = m.stamp_ns - scenes.START_NS + start_ns
        body = scenes.pose_at(m.stamp_ns) @ invert(scenes.BODY_FROM_CAMERA)
        if m.topic == "/tf":
            return replace(m, message=M.tf(stamp_ns, ("odom", "base_link", body)))
        return replace(m, message=replace(m.message, header=M.header(stamp_ns, m.message.header.frame_id)))

    return [moved(m) if m.topic in topics else m for m in log]


@pytest.mark.parametrize("start_ns", [5 * S, scenes.START_NS - 3600 * S, scenes.START_NS + 90 * S])
@pytest.mark.parametrize(
    ("log", "topics"),
    [(BY_TF, ("/tf",)), (BY_ODOMETRY, ("/odom",)), (BY_ODOMETRY, (scenes.PNG_COLOR, scenes.PNG_DEPTH))],
    ids=["tf", "odometry", "images"],
)
def test_poses_and_images_of_two_clocks_are_played_by_log_time(tmp_path, log, topics, start_ns):
    source = _source(tmp_path, _sim_time(log, topics, start_ns))
    assert dict(source.info.streams)["stamps"].startswith("log time: the header stamps of /cam/color")
    assert _is_right(source)


@pytest.mark.parametrize("stamp_ns", [0, 5 * S])
def test_a_constant_link_or_one_odd_stamp_sets_no_clock(tmp_path, stamp_ns):
    first = next(m for m in BY_TF if m.topic == "/tf")
    early = replace(first, stamp_ns=first.stamp_ns - 1, message=M.tf(stamp_ns, ("odom", "base_link", np.eye(4))))
    message = M.tf(stamp_ns, ("cam_link", scenes.OPTICAL, scenes.BODY_FROM_CAMERA))
    constant = [scenes.Message(topic="/tf", stamp_ns=m.stamp_ns, message=message) for m in BY_TF[::3]]
    base = _link("base_link", "cam_link", np.eye(4), BY_TF[0].stamp_ns)
    source = _source(tmp_path, _with(BY_TF[1:], base, early, *constant))
    assert dict(source.info.streams)["stamps"] == "header stamps"
    assert _is_right(source)


def test_a_clock_set_back_in_the_middle_keeps_every_pose(tmp_path):
    names = ("/odom", scenes.PNG_COLOR, scenes.PNG_DEPTH)
    back = _sim_time([m for m in BY_ODOMETRY if m.stamp_ns >= MIDDLE], names, scenes.START_NS - 400 * MS)
    source = _source(tmp_path, [*[m for m in BY_ODOMETRY if m.stamp_ns < MIDDLE], *back])
    frames = list(source.frames())
    assert [f.stamp_ns for f in frames] == [f.stamp_ns - 400 * MS * (f.stamp_ns >= MIDDLE) for f in TRUTH]
    for frame, true in zip(frames, TRUTH, strict=True):
        np.testing.assert_allclose(frame.world_from_camera, true.world_from_camera, atol=5e-3)
    assert source.ledger() == {"frames": len(TRUTH)}
    assert "the robot's clock was set back by 0.40 s" in next(iter(source.account().findings))


def test_poses_stamped_early_are_noted_or_name_the_clock(tmp_path):
    scenes.write_mcap(tmp_path / "log.mcap", M, _sim_time(BY_ODOMETRY, ("/odom",), scenes.START_NS - 500 * MS))
    notes = examine([tmp_path / "log.mcap"], SourceOptions()).notes
    assert any(note.startswith("/odom: by log time its stamps are 0.5 s behind the images'") for note in notes)
    messages = _sim_time(BY_ODOMETRY, ("/odom",), scenes.START_NS - 9 * S)
    told = r"no image has a pose.*by log time its stamps are 9\.0 s behind the images'.*--clock log"
    with pytest.raises(Exception, match=told):
        _source(tmp_path, messages)
    assert _is_right(_source(tmp_path, messages, clock="log"))
