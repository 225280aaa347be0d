from hickory_stream.box_scene import SceneSource
from hickory_stream.engine.accounting import message_ledger, run_ledger, run_timings
from players import open_source
from players.first_frames import FirstFrames
from tests import player_scenes as scenes

M = scenes.Messages(ros=2)
TRUTH = scenes.make_scene()
LOG = scenes.scene_messages(M, TRUTH, scenes.png_images)


def test_images_of_frames_that_were_no_keyframes_were_not_needed(tmp_path):
    source = open_source(scenes.write_mcap(tmp_path / "log.mcap", M, LOG))
    assert len(list(source.frames())) == len(TRUTH)
    account = message_ledger(source, {"read": len(TRUTH), "keyframes": 2, "frames_undecodable": 1})
    assert account["declared"] == len(LOG)
    assert account["not_keyframe"] == account["not_needed"] == 2 * (len(TRUTH) - 3)
    assert account["unreadable"] == 2
    assert account["used"] + account["not_needed"] + account["unreadable"] == len(LOG)
    assert account["explanation"] == ""


def test_what_was_not_played_is_told_apart(tmp_path):
    source = FirstFrames(open_source(scenes.write_mcap(tmp_path / "log.mcap", M, LOG)), 2)
    assert len(list(source.frames())) == 2
    account = message_ledger(source, {"read": 2, "keyframes": 2})
    assert account["not_played"] > 0
    assert not account["is_complete"]
    assert account["used"] + account["not_played"] == len(LOG)


def test_a_source_without_an_account_has_none():
    assert message_ledger(SceneSource(2), {"read": 0}) == {}
    assert message_ledger(FirstFrames(SceneSource(2), 1), {"read": 0}) == {}


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
