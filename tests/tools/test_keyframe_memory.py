import pytest
from hickory_stream.errors import HickoryError
from tools.benchmarks.perception.frames import keyframe_memory


def test_the_count_exceeds_the_weights_and_does_not_grow(demo_log):
    memory = keyframe_memory(demo_log, keyframes=8, rounds=3)
    assert memory.keyframes == 8
    assert 10 < memory.layer1_mb < 1000
    assert 0 <= memory.keyframes_mb < memory.layer1_mb
    # Three frames with what perception makes of them would be more.
    assert 0 <= memory.rounds_mb < 20


def test_a_child_that_fails_says_why(tmp_path):
    with pytest.raises(HickoryError, match=r"no such file or folder: .*absent\.mcap"):
        keyframe_memory(tmp_path / "absent.mcap", keyframes=1, rounds=1)
