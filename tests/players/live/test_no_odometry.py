import pytest
from hickory_stream.errors import RecordingError
from players import SourceOptions
from players.live.opening import open_live


@pytest.mark.parametrize("options", [SourceOptions(odometry="depth"), SourceOptions(extrinsics="estimate")])
def test_odometry_of_a_live_route_is_refused_with_what_to_do(options):
    with pytest.raises(RecordingError, match=r"for zenoh://127\.0\.0\.1.*record the robot \(--record\) and play that"):
        open_live("zenoh://127.0.0.1", options)
