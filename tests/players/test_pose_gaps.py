import numpy as np
import pytest
from players import open_source
from players.poses.pose_gaps import PoseGaps
from tests.players.test_motion_faults import COLOR, DEPTH, ODOM, cut, examined


def silent(start, end, *, stands=False):
    """Leave out the poses from `start` to `end` seconds; a camera that stands shows one image then."""

    def change(rows):
        first, held = rows[0].log_ns, {}
        for row in list(rows):
            seconds = (row.log_ns - first) / 1e9
            if row.topic in ("/tf", ODOM) and start <= seconds < end:
                rows.remove(row)
            elif stands and row.topic in (COLOR, DEPTH) and start <= seconds < end:
                row.message.data = held.setdefault(row.topic, row.message.data)

    return change


@pytest.mark.parametrize(("start", "end", "number"), [(2, 7, 30), (2, 9, 36), (0, 6, 36)])
def test_a_moving_camera_without_poses_is_a_warning(tmp_path, start, end, number):
    log = cut(tmp_path / "log.mcap", silent(start, end), 8.0)
    source = open_source(log)
    assert len(list(source.frames())) == 48 - number
    (finding,) = source.account().findings
    assert f"{number} of 48 frames ({number / 48:.0%}) have no pose while the camera moves" in finding
    assert finding in examined(log).problems


@pytest.mark.parametrize(("start", "end"), [(2, 9), (0, 6)])
def test_a_camera_that_stands_needs_no_poses(tmp_path, start, end):
    found = examined(cut(tmp_path / "log.mcap", silent(start, end, stands=True), 8.0))
    assert found.problems == []
    assert "36 of 48 frames have no pose while the camera stands" in found.notes


def test_noise_and_exposure_are_no_motion():
    rng, gaps = np.random.default_rng(0), PoseGaps()
    view = rng.integers(0, 255, (30, 40, 3)).repeat(8, 0).repeat(8, 1)
    for i in range(40):
        image = np.clip(view * (0.5 + 0.01 * i) + rng.normal(0, 5, view.shape), 0, 255).astype(np.uint8)
        gaps.unposed(lambda image=image: image)
    assert (gaps.num_moving, gaps.finding()) == (0, "")
    gaps.posed(np.eye(4))
    assert (gaps.num_moving, gaps.num_posed) == (0, 1)
