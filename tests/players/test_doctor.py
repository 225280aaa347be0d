import re
from dataclasses import replace
from pathlib import Path
import numpy as np
import pytest
from hickory_stream.box_scene import SCENE_CAMERA, START_NS, SceneSource
from hickory_stream.geometry.rigid import from_rotation_translation, yaw_rotation
from hickory_stream.records import RawFrame, SourceInfo
from players import SourceOptions
from players.doctor.depth_color_alignment import ColorAlignment
from players.doctor.diagnosis import (
    SOUND,
    UNUSABLE,
    WITH_LOSSES,
    Diagnosis,
    examine,
    examine_frames,
    judge_color,
    judge_ends,
)
from players.doctor.report import diagnosis_page, diagnosis_text
from tests import player_scenes as scenes
from tests.cli.test_cli import answer, said

M = scenes.Messages(ros=2)
FRAMES = scenes.make_scene(num_frames=12)
LOG = scenes.scene_messages(M, FRAMES, scenes.raw_images)
BAGS = Path(__file__).resolve().parents[3] / "shared/data/bags"

# For what is judged by poses and times.
SMALL = SCENE_CAMERA.scaled(0.25)


def _log(tmp_path):
    return scenes.write_mcap(tmp_path / "desk.mcap", M, LOG, chunk_size=40_000)


def _examined(path):
    return examine([path], SourceOptions())


def test_a_sound_log_is_sound_and_its_figures_are_right(tmp_path):
    found = _examined(_log(tmp_path))
    assert (found.status, found.problems, found.refusal) == (SOUND, [], None)
    assert found.checksum == "CRC-32 per chunk"
    assert found.frames["frames"] == len(FRAMES)
    assert found.frames["torn"] == 0
    true_invalid = np.median([np.isnan(frame.depth_m).mean() for frame in FRAMES])
    assert found.frames["depth_invalid_median"] == pytest.approx(true_invalid, abs=0.02)
    color = found.topics[scenes.RAW_COLOR]
    assert color["messages"] == color["declared"] == len(FRAMES)
    assert color["rate_hz"] == pytest.approx(10.0, abs=0.1)
    assert color["gaps"] == color["duplicates"] == color["out_of_order"] == 0
    assert found.sync["within"] == 1.0
    assert sum(found.sync["histogram"]["counts"]) == len(FRAMES)
    assert {"parent": "cam_link", "child": "cam_optical", "static": True} in found.tf["edges"]
    assert found.estimate["map_s"] > 0


def test_too_few_frames_for_the_motion_are_losses_5_hz_enough():
    # The camera moves by 0.3 m a second and turns by 20 degrees: a frame every 0.6 s leaves a third of what is due.
    found = _judged([(0.6 * i, 0.18 * i, 12.0 * i) for i in range(19)])
    assert found.status == WITH_LOSSES
    assert "19 keyframes in 10.8 s, 43 would be due at this motion" in found.problems[0]
    assert "seen for 1 s" in found.problems[0]
    assert _judged([(0.2 * i, 0.1 * i, 8.0 * i) for i in range(50)]).problems == []
    assert _judged([(0.1 * i, 0.0, 0.0) for i in range(200)]).problems == []
    short = "3 keyframes in 0.9 s: what is seen for 1 s is mapped; record for longer"
    assert _judged([(0.45 * i, 0.2 * i, 0.0) for i in range(3)]).problems == [short]


class _Walk:
    """A source of one frame that moves along x and turns: seconds, metres and degrees of each."""

    def __init__(self, steps):
        self._steps = steps
        self.info = SourceInfo(
            uri="memory:walk", kind="walk", identity="walk", camera=SMALL, num_frames=len(steps),
            start_ns=START_NS, end_ns=START_NS + int(1e9 * steps[-1][0]), streams=(),
        )  # fmt: skip

    def frames(self):
        frame = next(iter(SceneSource(1, camera=SMALL).frames())).decode()
        for i, (seconds, metres, degrees) in enumerate(self._steps):
            pose = from_rotation_translation(yaw_rotation(np.deg2rad(degrees)), np.array([metres, 0.0, 0.0]))
            stamp_ns = START_NS + round(1e9 * seconds)
            known = {"index": i, "stamp_ns": stamp_ns, "camera": SMALL, "world_from_camera": pose}
            yield RawFrame(**known, decode=lambda: frame)

    def ledger(self):
        return {"frames": len(self._steps)}

    def close(self):
        pass


def _judged(steps):
    found = Diagnosis(uri="walk")
    examine_frames(found, _Walk(steps), {})
    return found


def test_colour_25_mm_beside_depth_is_a_problem_of_a_link():
    shown = Diagnosis(uri="a")
    off = ColorAlignment(offset_m=(-0.025, 0.005), offset_px=5.2, gain=1.4, share=1.0, num_frames=12)
    judge_color(shown, off)
    assert shown.status == WITH_LOSSES
    (problem,) = shown.problems
    assert "-25 mm to the right and +5 mm down" in problem
    assert "5.2 pixels" in problem
    judge_color(shown, replace(off, gain=1.02))
    judge_color(shown, None)
    assert len(shown.problems) == 1


def test_a_damaged_or_cut_off_log_is_usable_with_losses(tmp_path):
    log = _log(tmp_path)
    data = bytearray(log.read_bytes())
    data[len(data) // 2] ^= 0xFF
    log.write_bytes(bytes(data))
    found = _examined(log)
    assert found.status == WITH_LOSSES
    (flaw,) = found.damage
    assert "fails its checksum" in flaw["what"]
    assert flaw["messages"] > 0
    assert found.ledger["unreadable"] == flaw["messages"]
    assert found.ledger["difference"] == 0
    assert any("1 damaged places" in problem for problem in found.problems)
    log = _log(tmp_path)
    log.write_bytes(log.read_bytes()[: log.stat().st_size * 2 // 3])
    found = _examined(log)
    assert found.status == WITH_LOSSES
    assert 0 < found.frames["frames"] < len(FRAMES)
    assert "declares no totals" in found.ledger["explanation"]


@pytest.mark.parametrize(
    "content", [b"", b"to do: buy milk", b"\x89MCAP0\r\n", b"#ROSBAG V2.0\n", b"SQLite format 3\0"]
)
def test_what_is_no_log_is_unusable_and_says_why(tmp_path, content):
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    found = _examined(path)
    assert found.status == UNUSABLE
    assert "a.mcap" in found.refusal


def test_a_log_without_a_link_to_the_camera_lists_its_frames(tmp_path):
    messages = [message for message in LOG if message.topic != "/tf_static"]
    found = _examined(scenes.write_mcap(tmp_path / "log.mcap", M, messages))
    assert found.status == UNUSABLE
    assert "no transform from base_link" in str(found.refusal)
    assert found.tf["pose_streams"][0]["child"] == "base_link"
    assert found.images["depth"]["encoding"] == "32FC1"


def test_a_folder_of_images_is_examined_too(tmp_path):
    found = _examined(scenes.write_tum(tmp_path / "tum", FRAMES))
    assert found.status == SOUND
    assert found.frames["frames"] == len(FRAMES)
    files = [*(tmp_path / "tum").rglob("*.png"), *(tmp_path / "tum").rglob("*.jpg"), *(tmp_path / "tum").glob("*.txt")]
    assert 0.9 * sum(file.stat().st_size for file in files) < found.num_bytes
    assert found.ledger["declared"] == found.ledger["used"] == 2 * len(FRAMES)
    assert f"ledger: {2 * len(FRAMES)} files declared" in diagnosis_text(found)
    drops = np.random.default_rng(0).random((60, 80)) < 0.02
    wet = [replace(frame, depth_mm=np.where(drops, np.uint16(500), frame.depth_mm)) for frame in FRAMES]
    (problem,) = _examined(scenes.write_tum(tmp_path / "rain", wet)).problems
    assert re.match(r"1\.\d% of the depth are specks in the air", problem)


def test_the_command_ends_with_the_verdict_in_text_json_and_page(tmp_path):
    log, page = _log(tmp_path), tmp_path / "page.html"
    assert answer("doctor", log, "--html", page, status=SOUND)["verdict"] == "sound"
    assert page.read_text().startswith("<!doctype html>")
    assert "desk.mcap: SOUND" in said("doctor", log, status=SOUND)
    said("doctor", tmp_path / "none.bag", status=UNUSABLE)
    found = _examined(log)
    found.notes.append("<script>")
    page = diagnosis_page(found)
    assert "<svg" in page and "<script>" not in page


@pytest.mark.skipif(not BAGS.is_dir(), reason="needs real logs beside the checkout")
def test_every_real_log_is_read_whole_or_says_why_not(capsys):
    """None of them holds images; every message of every one is read. Prints the table of them."""
    logs, rows = [*BAGS.rglob("*")], []
    logs = sorted(p for p in logs if p.suffix in (".bag", ".mcap", ".db3") or (p / "metadata.yaml").is_file())
    assert len(logs) > 50
    for log in logs:
        found = _examined(log)
        assert found.status == UNUSABLE
        assert "no images" in str(found.refusal) or "holds no messages" in str(found.refusal)
        assert found.damage == []
        for name, figures in found.topics.items():
            assert figures["messages"] == (figures["declared"] or 0), (log, name)
        total = sum(figures["messages"] for figures in found.topics.values())
        rows.append(f"{log.name:<48} {found.kind:<24} {len(found.topics):>3} topics {total:>6} messages")
    with capsys.disabled():
        print("\n" + "\n".join(rows))  # noqa: T201 # asked for: a table in the output of the tests


@pytest.mark.parametrize(
    ("color_s", "depth_s", "said"), [(60, 48, "depth stops 12.0 s before colour"), (5, 9, "colour"), (60, 59, None)]
)
def test_a_camera_that_stops_long_before_the_other_is_a_problem(color_s, depth_s, said):
    found = Diagnosis(uri="walk")
    color_ns, depth_ns = (np.arange(0, end_s * 10**9 + 1, 10**8) for end_s in (color_s, depth_s))
    judge_ends(found, color_ns, depth_ns)
    assert len(found.problems) == (said is not None)
    if said is not None:
        assert found.problems[0].startswith(said)
