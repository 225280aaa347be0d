from dataclasses import replace
import numpy as np
import pytest
from players import SourceOptions, open_source
from tests import player_scenes as scenes

MS = 1_000_000
S = 1_000 * MS
M = scenes.Messages(ros=2)
TRUTH = scenes.make_scene(num_frames=12)
LOG = scenes.scene_messages(M, TRUTH, scenes.png_images)
IMAGES = (scenes.PNG_COLOR, scenes.PNG_DEPTH)


def _open(path, messages, **options):
    return open_source(scenes.write_mcap(path / "log.mcap", M, messages), SourceOptions(**options))


def _played(source):
    """Return the frames, the counts and the account of a whole pass; the account has no unexplained difference."""
    frames = list(source.frames())
    account = source.account().as_dict()
    assert account["difference"] == 0
    return frames, dict(source.ledger()), account


def _restamped(message, stamp_ns):
    header = replace(message.message.header, stamp=M.header(stamp_ns, "").stamp)
    return replace(message, message=replace(message.message, header=header))


def _where(is_changed, stamp):
    return [_restamped(m, stamp(m.stamp_ns)) if is_changed(m) else m for m in LOG]


@pytest.mark.parametrize(("topics", "stamp", "clock", "said"), [
    (IMAGES, lambda _: 0, "auto", "log time: the header stamps of /cam/color"),
    (IMAGES[1:], lambda ns: ns + 3_600 * S, "auto", "3600 s apart"),
    ((), None, "log", "log time, as asked"),
], ids=["never set", "far off", "asked for"])  # fmt: skip
def test_stamps_are_replaced_by_log_time(tmp_path, topics, stamp, clock, said):
    source = _open(tmp_path, _where(lambda m: m.topic in topics, stamp), clock=clock)
    assert said in dict(source.info.streams)["stamps"]
    frames, ledger, _ = _played(source)
    assert (len(frames), ledger) == (len(TRUTH), {"frames": len(TRUTH)})


def test_one_image_with_a_stamp_of_zero_is_rejected(tmp_path):
    wrong = TRUTH[5].stamp_ns
    source = _open(tmp_path, _where(lambda m: m.topic == scenes.PNG_COLOR and m.stamp_ns == wrong, lambda _: 0))
    frames, ledger, account = _played(source)
    assert len(frames) == len(TRUTH) - 1
    assert ledger["color_stamp_off"] == 1
    assert account["rejected"] == {"color_stamp_off": 1, "depth_without_color": 1}


def test_a_log_that_was_played_in_a_loop_is_played_whole(tmp_path):
    """Each round has the same header stamps; the time of recording goes on."""
    again = [replace(m, stamp_ns=m.stamp_ns + 5 * S) for m in LOG if m.topic != "/tf_static"]
    shift = 4 * S  # the log must be longer than what counts as merely late
    first = _where(lambda m: m.topic in (*IMAGES, "/odom"), lambda ns: ns + shift)
    frames, ledger, _ = _played(_open(tmp_path, [*first, *again]))
    stamps = [frame.stamp_ns for frame in frames]
    assert len(frames) == 2 * len(TRUTH)
    assert stamps[: len(TRUTH)] == [t.stamp_ns + shift for t in TRUTH]
    assert stamps[len(TRUTH) :] == [t.stamp_ns for t in TRUTH]
    for raw, true in zip(frames[len(TRUTH) :], TRUTH, strict=True):
        np.testing.assert_allclose(raw.world_from_camera, true.world_from_camera, atol=1e-3)
    assert set(ledger) == {"frames"}


def test_doubled_images_are_rejected_once(tmp_path):
    doubled = [m for message in LOG for m in ([message] * 2 if message.topic == scenes.PNG_COLOR else [message])]
    frames, ledger, account = _played(_open(tmp_path, doubled))
    assert len(frames) == len(TRUTH)
    assert ledger["duplicate_color"] == len(TRUTH)
    assert account["rejected"] == {"duplicate_color": len(TRUTH)}


def test_overlapping_splits_are_one_log(tmp_path):
    middle = len(LOG) // 2
    first = scenes.write_mcap(tmp_path / "a_0.mcap", M, LOG[: middle + 20])
    second = scenes.write_mcap(tmp_path / "a_1.mcap", M, LOG[middle - 20 :])
    frames, ledger, _ = _played(open_source([first, second]))
    assert [f.stamp_ns for f in frames] == [t.stamp_ns for t in TRUTH]
    assert ledger["duplicate_color"] > 0


def test_a_pose_that_teleports_is_rejected(tmp_path):
    def far(message):
        away = np.eye(4)
        away[0, 3] = 50.0
        return replace(message, message=M.odometry(message.stamp_ns, "odom", "base_link", away))

    odometry = [m for m in LOG if m.topic == "/odom"]
    messages = [far(m) if m is odometry[20] else m for m in LOG]
    frames, ledger, account = _played(_open(tmp_path, messages))
    assert len(frames) == len(TRUTH)
    assert ledger["pose_teleport"] == 1
    assert account["rejected"] == {"bad_pose": 1}
    for raw, true in zip(frames, TRUTH, strict=True):
        np.testing.assert_allclose(raw.world_from_camera, true.world_from_camera, atol=2e-3)


@pytest.mark.parametrize("late", ["camera_info", "tf_static"])
def test_a_calibration_or_static_link_that_comes_late_is_found(tmp_path, late):
    last = [m for m in LOG if m.topic.endswith(late)]
    frames, _, _ = _played(_open(tmp_path, [*[m for m in LOG if not m.topic.endswith(late)], *last[-2:]]))
    assert len(frames) == len(TRUTH)


def test_a_changed_calibration_is_counted_and_the_first_is_kept(tmp_path):
    other = replace(scenes.CAMERA, fx=90.0)
    late = TRUTH[6].stamp_ns
    place = next(i for i, m in enumerate(LOG) if m.topic == "/cam/color/camera_info" and m.stamp_ns == late)
    changed = replace(LOG[place], message=M.camera_info(late, scenes.OPTICAL, other))
    messages = [*LOG[:place], changed, *LOG[place + 1 :]]
    frames, ledger, _ = _played(_open(tmp_path, messages))
    assert ledger["camera_info_changed"] >= 1
    assert {frame.camera for frame in frames} == {scenes.CAMERA}


@pytest.mark.parametrize("compression", [None, "lz4", "bz2"])
def test_two_bags_are_played_as_one_whatever_their_clocks(tmp_path, compression):
    """The odometry was recorded years later from a replay: only header stamps agree."""
    m, paths = scenes.Messages(ros=1), [tmp_path / "camera.bag", tmp_path / "vio.bag"]
    log = scenes.scene_messages(m, TRUTH, scenes.png_images)
    for path, is_odometry, late_ns in zip(paths, (False, True), (0, 90_000_000 * S), strict=True):
        messages = [entry for entry in log if (entry.topic == "/odom") == is_odometry]
        scenes.write_ros1(path, m, messages, late_ns=late_ns, compression=compression)
    frames, ledger, _ = _played(open_source(paths))
    assert [f.stamp_ns for f in frames] == [t.stamp_ns for t in TRUTH]
    assert ledger == {"frames": len(TRUTH)}
