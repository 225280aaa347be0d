from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.worlds.recording import make_recording
from players import SourceOptions, open_source
from players.doctor.diagnosis import WITH_LOSSES, examine
from players.poses.extrinsics import estimated_extrinsics
from players.profile import load_profile
from tests.cli.test_cli import answer, look
from tests.cli.test_cli_strange_walks import LAYER_ONE
from tools.worlds.layouts import drawn_mounting
from tools.worlds.recording_config import RecordingConfig

SEED = 7


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A B2 whose camera is where the seed has it; the walk turns by more than half a circle."""
    folder = tmp_path_factory.mktemp("b2")
    config = RecordingConfig(seed=SEED, seconds=12.0, width=240, height=136, layout="nus_clb", camera_offset=True)
    make_recording(config, folder, "b2", caster=None)
    return folder


@pytest.fixture(scope="module")
def estimate(recorded):
    return estimated_extrinsics(open_source(recorded / "b2"))


def test_the_offset_is_four_decimetres_and_ten_degrees_by_seed():
    for seed in range(5):
        mounting = drawn_mounting(seed)
        assert np.linalg.norm(mounting[:3, 3]) == pytest.approx(0.4)
        forward = mounting[:3, :3] @ np.array([0.0, 0.0, 1.0])
        assert forward[0] > np.cos(np.radians(10.5))
    assert not np.allclose(drawn_mounting(0), drawn_mounting(1))


def test_the_camera_is_found_to_three_centimetres_or_left_open(estimate):
    off = estimate.body_from_camera[:3, 3] - drawn_mounting(SEED)[:3, 3]
    for axis, name in enumerate(("forward", "left", "up")):
        assert abs(off[axis]) < 0.03 or name in estimate.open_names()
    turned = estimate.body_from_camera[:3, :3] @ drawn_mounting(SEED)[:3, :3].T
    assert np.degrees(np.arccos(min(1.0, (np.trace(turned) - 1) / 2))) < 1.0


def test_doctor_warns_that_the_profile_is_off(recorded, estimate, monkeypatch):
    monkeypatch.setattr("players.doctor.diagnosis.estimated_extrinsics", lambda *_: estimate)
    found = examine([recorded / "b2"], SourceOptions())
    told = [problem for problem in found.problems if "by its motion the camera sits" in problem]
    assert len(told) == 1
    assert "--extrinsics estimate" in told[0]


def test_a_motion_that_leaves_all_open_confirms_no_profile(recorded, estimate, monkeypatch):
    unknown = replace(estimate, covariance=100 * np.eye(6), open_directions=np.eye(6))
    monkeypatch.setattr("players.doctor.diagnosis.estimated_extrinsics", lambda *_: unknown)
    (note,) = [note for note in examine([recorded / "b2"], SourceOptions()).notes if "the profile" in note]
    assert note.endswith("cannot be checked: the motion leaves every direction of it open")


def test_a_mended_profile_has_the_estimated_place_on_its_base(recorded, estimate, monkeypatch):
    monkeypatch.setattr("players.doctor.diagnosis.estimated_extrinsics", lambda *_: estimate)
    mended, base = recorded / "mended.toml", load_profile("nus_clb")
    told = look("doctor", recorded / "b2", "--fix", mended, "--json")
    assert (told.status, told.json()["fixes"].keys()) == (WITH_LOSSES, {"rig"})
    (link,), found = load_profile(str(mended)).rig.links, load_profile(str(mended))
    np.testing.assert_allclose(link.parent_from_child, estimate.body_from_camera, atol=1e-4)
    assert (found.topics, found.rig.color) == (base.topics, base.rig.color)


def test_a_log_is_mapped_through_the_estimate(recorded, estimate, monkeypatch):
    monkeypatch.setattr("players.poses.extrinsics.estimated_extrinsics", lambda *_: estimate)
    out = recorded / "b2.map"
    played = look("play", recorded / "b2", "--extrinsics", "estimate", "--end", "8", "--out", out, *LAYER_ONE)
    assert played.status in (0, 3)
    found = answer("evaluate", out, "--truth", recorded / "b2.truth")
    # 0.59 as measured; 0.14 through the profile's zero, 0.73 where there is no offset.
    assert found["recall_25"] >= 0.45
