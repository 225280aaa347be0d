import numpy as np
import pytest
from players import SourceOptions, open_source
from tests import player_scenes as scenes
from tests.players.logs.layouts.test_public_folders import KINDS, write

BASES = {"seven_scenes": "seven_scenes", "tum": "tum", **{layout: layout for layout in KINDS}}


@pytest.fixture(params=BASES)
def folder(request, tmp_path):
    plain = {"seven_scenes": scenes.write_seven_scenes, "tum": scenes.write_tum}
    path = tmp_path / "log"
    if request.param in plain:
        return request.param, plain[request.param](path, scenes.make_scene(num_frames=8)) or path
    return request.param, write(request.param, path)


def played(folder, tmp_path, *lines):
    profile = tmp_path / f"{len(lines)}.toml"
    profile.write_text("\n".join([f'base = "{BASES[folder[0]]}"', *lines]) + "\n")
    source = open_source(folder[1], SourceOptions(profile=str(profile)))
    return source, [raw.decode() for raw in source.frames()]


def test_depth_scale_holds_for_every_folder(folder, tmp_path):
    (_, plain), (source, scaled) = played(folder, tmp_path), played(folder, tmp_path, "depth_scale = 0.5", "")
    assert source.depth_units_per_m == pytest.approx(2 * open_source(folder[1]).depth_units_per_m)
    for before, after in zip(plain, scaled, strict=True):
        # Depth beside colour lands on other pixels when it is nearer.
        assert np.nanmedian(after.depth_m) == pytest.approx(0.5 * np.nanmedian(before.depth_m), rel=0.02)


def test_offsets_move_poses_and_depth_of_every_folder(folder, tmp_path):
    _, plain = played(folder, tmp_path)
    period_ms = (plain[1].stamp_ns - plain[0].stamp_ns) / 1e6
    # Stamps of poses are late, and those of depth early, by one frame.
    lines = ("[time]", f"pose_offset_ms = {-period_ms}", f"depth_offset_ms = {period_ms}")
    source, moved = played(folder, tmp_path, *lines)
    by_stamp = {frame.stamp_ns: i for i, frame in enumerate(plain)}
    assert len(moved) >= len(plain) - 3
    for frame in moved:
        i = by_stamp[frame.stamp_ns]
        assert np.array_equal(frame.rgb, plain[i].rgb)
        if plain[i + 1].stamp_ns - frame.stamp_ns < 1.5e6 * period_ms:
            np.testing.assert_allclose(frame.world_from_camera, plain[i + 1].world_from_camera, atol=2e-3)
    assert source.account().as_dict()["difference"] == 0


def test_camera_axes_turn_the_poses_of_every_folder(folder, tmp_path):
    (_, plain), (_, turned) = played(folder, tmp_path), played(folder, tmp_path, 'camera_axes = "-y -z x"', "", "")
    axes = np.eye(4)
    axes[:3, :3] = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    for before, after in zip(plain, turned, strict=True):
        np.testing.assert_allclose(after.world_from_camera, before.world_from_camera @ axes, atol=1e-9)
