from hickory_stream.box_scene import SceneSource
from hickory_stream.engine.accounting import run_ledger, run_timings


def test_late_frames_and_a_readers_own_counts_are_accounted_for():
    ledger = run_ledger(
        SceneSource(2), num_frames=8, num_keyframes=3,
        counts={"frames_late": 2, "between_keyframes": 5, "time_jumps": 0}, shapes={"ready": 1}, num_not_shown=0,
    )  # fmt: skip
    assert ledger["frames"] == {"read": 10, "keyframes": 3, "frames_late": 2, "between_keyframes": 5}
    assert ledger["shapes"] == {"ready": 1}
    assert "messages" not in ledger
    ledger = run_ledger(SceneSource(2), num_frames=8, num_keyframes=3, counts={"read": 12}, shapes={}, num_not_shown=4)
    assert ledger["frames"] == {"read": 12, "keyframes": 3, "reports_not_shown": 4}


def test_times_are_told_by_layer_and_by_stage():
    times = run_timings(
        {"perceive": 2.0, "decide": 0.5, "decode": 1.0}, {"reconstruct": 3.0, "fit": 4.0, "inflate": 5.0}, 0.25
    )
    assert times == {
        "layer1_s": 2.5,
        "layer2_s": 3.0,
        "layer3_s": 4.0,
        "layer4_s": 5.0,
        "decide_s": 0.5,
        "decode_s": 1.0,
        "perceive_s": 2.0,
        "loop_delay_p99_ms": 250.0,
    }
