from dataclasses import replace
import numpy as np
from hickory_stream.geometry.rigid import from_rotation_translation
from players import SourceOptions, open_source
from tests import player_scenes as scenes

LAG_NS = 40_000_000
COLOR_FROM_DEPTH = from_rotation_translation(np.eye(3), np.array([-0.03, 0.0, 0.0]))
OPTIONS = SourceOptions(sync_tolerance_ns=60_000_000)


def log(path, *, lag_ns=LAG_NS, depth_camera=None):
    """A log whose depth is seen from 3 cm to the side, `lag_ns` after colour, by a camera that turns all the time."""
    m = scenes.Messages(2)
    camera = depth_camera or replace(scenes.CAMERA, fx=scenes.CAMERA.fx * 1.1, fy=scenes.CAMERA.fy * 1.1)
    frames = scenes.make_scene()
    links = (
        ("base_link", scenes.OPTICAL, scenes.BODY_FROM_CAMERA),
        (scenes.OPTICAL, "depth_optical", COLOR_FROM_DEPTH),
    )
    messages = [
        entry
        for entry in scenes.scene_messages(m, frames, lambda m, frame: [scenes.raw_images(m, frame)[0]])
        if entry.topic not in ("/tf_static", "/cam/aligned_depth/camera_info")
    ]
    messages.append(scenes.Message(topic="/tf_static", stamp_ns=scenes.START_NS - 200_000_000, message=m.tf(0, *links)))
    for frame in frames:
        late_ns = frame.stamp_ns + lag_ns
        depth = scenes.cast(camera, scenes.pose_at(late_ns) @ COLOR_FROM_DEPTH)[1].astype(np.float32)
        image = m.image(late_ns, "depth_optical", "32FC1", depth)
        messages.append(scenes.Message(topic="/cam/depth/image_rect", stamp_ns=late_ns, message=image))
        info = m.camera_info(late_ns, "depth_optical", camera)
        messages.append(scenes.Message(topic="/cam/depth/camera_info", stamp_ns=late_ns, message=info))
    messages.sort(key=lambda entry: entry.stamp_ns)
    return open_source(scenes.write_ros2(path, m, messages), OPTIONS)


def errors_m(source):
    """How far the depth of every frame is off what colour's camera would have measured at colour's stamp."""
    found = []
    for raw in source.frames():
        frame = raw.decode()
        truth = scenes.cast(scenes.CAMERA, scenes.pose_at(raw.stamp_ns))[1]
        both = np.isfinite(frame.depth_m) & np.isfinite(truth)
        found.append(np.abs(frame.depth_m - truth)[both])
    return np.concatenate(found)


def test_late_depth_is_right_unless_by_the_recorders_clock(tmp_path):
    moved, same = errors_m(log(tmp_path / "log")), errors_m(log(tmp_path / "same", lag_ns=0))
    assert np.median(moved) < np.median(same) + 0.001
    assert (moved > 0.05).mean() < (same > 0.05).mean() + 0.01
    still = errors_m(open_source(tmp_path / "log", replace(OPTIONS, clock="log")))
    assert np.median(still) > 3 * np.median(moved)
