import pytest
from players import open_source
from players.first_frames import FirstFrames


def test_the_first_frames_of_a_log_are_those_of_the_log(demo_log):
    stamps = [raw.stamp_ns for raw in open_source(demo_log).frames()]
    source = FirstFrames(open_source(demo_log), 5)
    assert [raw.stamp_ns for raw in source.frames()] == stamps[:5]
    assert [raw.stamp_ns for raw in source.frames()] == stamps[:5], "each call starts anew"
    assert source.info.num_frames == 5
    source.close()


def test_no_frames_are_no_beginning(demo_log):
    with pytest.raises(ValueError, match="first 0"):
        FirstFrames(open_source(demo_log), 0)
