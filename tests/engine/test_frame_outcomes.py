from dataclasses import replace
import numpy as np
from hickory_stream.box_scene import SceneSource
from hickory_stream.engine.frame_accounting import FrameOutcome, KeyframeChoice
from hickory_stream.engine.reading import QueuedFrame
from hickory_stream.mapping.rules.keyframes import KeyframeConfig

RAW = next(SceneSource(1).frames())
CONFIG = KeyframeConfig()
FAR_M = 10.0


def read(place_m, *, is_candidate, is_corrupt=False, seconds=0.0):
    """Return a frame so far along x: a keyframe of its own wherever it is far from the last one."""
    pose = np.array(RAW.world_from_camera)
    pose[0, 3] += place_m
    raw = replace(RAW, stamp_ns=RAW.stamp_ns + round(seconds * 1e9), world_from_camera=pose)
    return QueuedFrame(raw=raw, round_index=0, first_index=0, is_candidate=is_candidate, is_corrupt=is_corrupt)


def test_a_playback_maps_candidates_and_counts_corrupt_frames():
    choice = KeyframeChoice("playback", CONFIG)
    assert choice.outcomes([read(0.0, is_candidate=True)]) == [FrameOutcome.MAPPED]
    assert choice.outcomes([read(0.0, is_candidate=False)]) == [FrameOutcome.BETWEEN]
    assert choice.outcomes([read(FAR_M, is_candidate=False, is_corrupt=True)]) == [FrameOutcome.UNDECODABLE]


def test_a_live_run_maps_the_newest_candidate_alone():
    choice = KeyframeChoice("live", CONFIG)
    come = [read(i * FAR_M, is_candidate=i % 2 == 0, seconds=i) for i in range(5)]
    assert choice.outcomes(come) == [
        FrameOutcome.DROPPED,
        FrameOutcome.BETWEEN,
        FrameOutcome.DROPPED,
        FrameOutcome.BETWEEN,
        FrameOutcome.MAPPED,
    ]


def test_a_candidate_is_mapped_dropped_or_replaced():
    choice = KeyframeChoice("live", CONFIG)
    come = [read(0.0, is_candidate=True), read(FAR_M, is_candidate=False, seconds=1.0)]
    assert choice.outcomes(come) == [FrameOutcome.BETWEEN, FrameOutcome.MAPPED]
    assert choice.outcomes([read(0.0, is_candidate=True)]) == [FrameOutcome.MAPPED]
    assert choice.outcomes([read(0.0, is_candidate=True)]) == [FrameOutcome.DROPPED]
    assert choice.outcomes([read(0.0, is_candidate=False)]) == [FrameOutcome.BETWEEN]
