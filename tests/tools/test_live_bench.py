import numpy as np
from players.opening import open_source
from tools.benchmarks.live.camera_log import write_720p
from tools.benchmarks.live.robots import _unaccounted


def test_the_log_for_transport_is_720p_at_30_hz(demo_log, tmp_path):
    large = open_source(write_720p(demo_log, tmp_path / "720p.mcap", seconds=0.3))
    small = open_source(demo_log)
    frames = list(large.frames())
    assert len(frames) == 9
    assert set(np.diff([frame.stamp_ns for frame in frames]) // 1_000_000) == {33}
    assert (large.info.camera.width, large.info.camera.height) == (1280, 720)
    a, b = frames[0].decode(), next(iter(small.frames())).decode()
    assert np.array_equal(a.depth_m[::2, ::2], b.depth_m, equal_nan=True)
    assert np.abs(a.rgb[::2, ::2].astype(int) - b.rgb).mean() < 8
    # The ray of the middle of a pixel is the same in both cameras, to the half pixel that lies between them.
    for axis in (0, 1):
        focal = large.info.camera.K[axis, axis] / small.info.camera.K[axis, axis]
        assert focal == 2.0


def test_what_is_in_no_bucket_is_counted_whichever_side_it_is_on():
    sent = {"sent": {"/a": 10, "/b": 5}}
    assert _unaccounted(sent, {"totals": {"/a": 10, "/b": 5, "/c": 3}, "difference": 0}) == 0
    assert _unaccounted(sent, {"totals": {"/a": 9}, "difference": 0}) == 6
    assert _unaccounted(sent, {"totals": {"/a": 12, "/b": 5}, "difference": -1}) == 3
