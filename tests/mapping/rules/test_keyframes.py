import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.mapping.rules.keyframes import Keyframe, KeyframeConfig, is_keyframe
from tests.strategies import rigid_transforms

CONFIG = KeyframeConfig(min_interval_s=0.25, min_distance_m=0.15, min_angle_deg=5.0, max_interval_s=2.0)
START = from_rotation_translation(Rotation.from_euler("xyz", [10, 20, 30], degrees=True).as_matrix(), np.ones(3))


def moved(distance_m, angle_deg):
    turn = Rotation.from_euler("y", angle_deg, degrees=True).as_matrix()
    return START @ from_rotation_translation(turn, np.array([distance_m, 0, 0]))


@pytest.mark.parametrize(
    ("elapsed_s", "distance_m", "angle_deg", "verdict"),
    [
        (0.10, 1.00, 90.0, False),
        (0.24, 1.00, 90.0, False),
        (0.2489, 1.00, 90.0, False),
        (0.2491, 0.16, 0.0, True),  # the stamps of a log of 20 Hz have jitter
        (0.25, 0.16, 0.0, True),
        (0.25, 0.14, 0.0, False),
        (0.25, 0.00, 5.1, True),
        (0.25, 0.00, 4.9, False),
        (0.25, 0.14, 4.9, False),
        (1.90, 0.00, 0.0, False),
        (1.9991, 0.00, 0.0, True),
        (2.00, 0.00, 0.0, True),
        (5.00, 0.01, 0.0, True),
        (0.00, 1.00, 90.0, False),
    ],
)
def test_a_frame_is_a_keyframe_when_the_rule_says_so(elapsed_s, distance_m, angle_deg, verdict):
    last = Keyframe(stamp_ns=1_000_000_000, world_from_camera=START)
    stamp_ns = 1_000_000_000 + round(elapsed_s * 1e9)
    assert is_keyframe(last, stamp_ns, moved(distance_m, angle_deg), CONFIG) is verdict


@given(st.integers(-(2**62), 2**62), rigid_transforms())
def test_the_first_frame_is_a_keyframe(stamp_ns, pose):
    assert is_keyframe(None, stamp_ns, pose, CONFIG)


@given(st.integers(1, 2**62), rigid_transforms())
def test_the_first_frame_after_a_jump_back_is_a_keyframe(back_ns, pose):
    assert is_keyframe(Keyframe(stamp_ns=0, world_from_camera=pose), -back_ns, pose, CONFIG)


@given(st.integers(2_000_000_000, 10**15), rigid_transforms(), rigid_transforms())
def test_no_interval_is_longer_than_the_longest(elapsed_ns, before, after):
    assert is_keyframe(Keyframe(stamp_ns=7, world_from_camera=before), 7 + elapsed_ns, after, CONFIG)
