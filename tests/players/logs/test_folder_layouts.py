import json
from dataclasses import replace
import cv2
import numpy as np
import pytest
from hickory_stream.errors import CalibrationError, InputError, RecordingError
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.depth_sensor import DepthSensor
from hickory_stream.geometry.rigid import from_rotation_translation
from players import SourceOptions, open_source
from tests import player_scenes as scenes

TRUTH = scenes.make_scene()
REGISTERED = SourceOptions(profile="registered")
RIG = """
rig = {body = "a", color = "b", depth = "b", links = [{parent = "a", child = "b", translation_m = [0, nan, 0]}]}
"""
FAR = "100.5 0 0 0 0 0 0 1\n101.5 0 0 0 0 0 0 1\n"


@pytest.fixture
def seven(tmp_path):
    return scenes.write_seven_scenes(tmp_path / "seven", TRUTH)


@pytest.fixture
def tum(tmp_path):
    return scenes.write_tum(tmp_path / "tum", TRUTH)


@pytest.fixture
def posed(tmp_path):
    return scenes.write_posed_folder(tmp_path / "posed", TRUTH)


def test_7_scenes_colour_is_a_camera_of_its_own_by_default(tmp_path):
    depth_camera = Camera(width=160, height=120, fx=146.25, fy=146.25, cx=80.0, cy=60.0)
    profile = tmp_path / "small.toml"
    lens = "{fx = 131.4, fy = 131.4, cx = 80.9, cy = 58.9}"
    profile.write_text(f"color_from_depth_m = [-0.0343, 0.0080, 0.0]\ncolor = {lens}\n")
    color_camera = Camera(width=160, height=120, fx=131.4, fy=131.4, cx=80.9, cy=58.9)
    color_from_depth = from_rotation_translation(np.eye(3), np.array([-0.0343, 0.0080, 0.0]))
    frames = []
    for truth in TRUTH:
        # The scene's pose is the colour camera's; the folder holds the depth camera's.
        world_from_depth = truth.world_from_camera @ color_from_depth
        depth = scenes.cast(depth_camera, world_from_depth)[1]
        rgb = scenes.cast(color_camera, truth.world_from_camera)[0]
        depth_mm = np.round(np.where(depth < 6, depth, 0) * 1000).astype(np.uint16)
        frames.append(replace(truth, world_from_camera=world_from_depth, rgb=rgb, depth_mm=depth_mm))
    folder = scenes.write_seven_scenes(tmp_path / "seven", frames, depth_camera)
    source = open_source(folder, SourceOptions(profile=str(profile)))
    assert source.info.camera == color_camera
    for raw, truth in zip(source.frames(), TRUTH, strict=True):
        np.testing.assert_allclose(raw.world_from_camera, truth.world_from_camera, atol=1e-6)
        depth_m, expected = raw.decode().depth_m, scenes.cast(color_camera, truth.world_from_camera)[1]
        both = np.isfinite(depth_m) & np.isfinite(expected)
        assert (np.abs(depth_m - expected)[both] < 0.05).mean() > 0.95


def test_7_scenes_is_upright_at_30_hz_with_the_fitted_camera(seven):
    camera = open_source(seven).info.camera
    # An eighth of 525.7, 525.7, 323.6, 235.7 of 640x480; pixel centres are at integers.
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == pytest.approx((65.7125, 65.7125, 40.0125, 29.025))
    upright, *rest = open_source(seven, REGISTERED).frames()
    assert [frame.stamp_ns for frame in (upright, *rest)] == [100_000_000 * i for i in range(len(TRUTH))]
    (seven / "gravity-direction.txt").unlink()
    tilted = next(open_source(seven, REGISTERED).frames()).world_from_camera
    np.testing.assert_allclose(upright.world_from_camera, TRUTH[0].world_from_camera, atol=1e-9)
    turned = upright.world_from_camera @ np.linalg.inv(tilted)
    assert np.degrees(np.arccos(turned[2, 2])) == pytest.approx(30.0)
    for file in seven.glob("*.pose.txt"):
        file.unlink()
    with pytest.raises(RecordingError, match=r"no frame has colour, depth and a pose; found 6 no_pose"):
        open_source(seven, SourceOptions(odometry="topic"))


def test_files_without_partners_or_poses_are_counted(seven):
    (seven / "frame-000000.color.png").unlink()
    (seven / "frame-000003.depth.png").unlink()
    np.savetxt(seven / "frame-000006.pose.txt", np.full((4, 4), np.nan))
    source = open_source(seven, REGISTERED)
    assert len(list(source.frames())) == len(TRUTH) - 3
    fates = {"color_without_depth": 1, "depth_without_color": 1, "no_pose": 1}
    assert source.ledger() == {"frames": len(TRUTH) - 3, **fates}
    account = source.account().as_dict()
    assert account["declared"] == 2 * len(TRUTH) - 2
    assert account["used"] == 2 * (len(TRUTH) - 3)
    assert account["rejected"] == {"color_without_depth": 1, "depth_without_color": 1, "no_pose": 2}
    assert (account["difference"], account["not_played"], account["is_complete"]) == (0, 0, True)


@pytest.mark.parametrize(("layout", "file", "text", "message"), [
    ("seven", "camera-intrinsics.txt", None, r"has no camera-intrinsics\.txt; it must hold the 3x3"),
    ("seven", "camera-intrinsics.txt", "1 2 3", r"camera-intrinsics\.txt"),
    ("seven", "camera-intrinsics.txt", "a b c", r"camera-intrinsics\.txt"),
    ("seven", "camera-intrinsics.txt", "0 0 0 0 0 0 0 0 1", r"camera-intrinsics\.txt"),
    ("tum", "depth.txt", None, r"looks like TUM RGB-D but has no depth\.txt"),
    ("tum", "rgb.txt", "# list\nsoon rgb/1.png\n", r"rgb\.txt, line 2: 'soon' is no stamp"),
    ("tum", "groundtruth.txt", "# nothing\n100.5 0 0 0 0 0 0 0\n", r"groundtruth\.txt holds no pose"),
    ("tum", "groundtruth.txt", FAR, r"images from 1700000000\.123 s to .* poses from 100\.500 s to 101\.500 s"),
    ("posed", "camera_poses.txt", "1 2 3 4 5 6 7\n", "line 1: 7 numbers; expected 16 or 12"),
    ("posed", "camera_poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n", r"1 poses in camera_poses\.txt for 6 images"),
    ("posed", "cam_params.json", None, r"has no cam_params\.json"),
    ("posed", "cam_params.json", '{"fx": 3}', r"cam_params\.json: KeyError\('fy'\); expected fx, fy"),
])  # fmt: skip
def test_a_file_that_is_missing_or_broken_is_named(request, layout, file, text, message):
    folder = request.getfixturevalue(layout)
    (folder / file).unlink()
    if text is not None:
        (folder / file).write_text(text)
    with pytest.raises(InputError, match=message):
        open_source(folder)


def test_torn_other_sized_and_blind_images_are_counted(seven):
    torn = seven / "frame-000006.depth.png"
    torn.write_bytes(torn.read_bytes()[:-30])
    source = open_source(seven, REGISTERED)
    frames = list(source.frames())
    with pytest.raises(RecordingError, match=r"frame-000006\.depth\.png is torn"):
        frames[2].decode()
    assert source.ledger() == {"frames": len(TRUTH), "unreadable_image": 1}
    scenes.write_png(seven / "frame-000006.color.png", np.zeros((30, 40, 3), dtype=np.uint8))
    source = open_source(seven, REGISTERED)
    assert [frame.index for frame in source.frames()] == list(range(len(TRUTH) - 1))
    assert source.ledger() == {"frames": len(TRUTH) - 1, "frame_of_other_size": 1}
    scenes.write_png(seven / "frame-000000.depth.png", np.zeros((60, 80), dtype=np.uint16))
    source = open_source(seven, REGISTERED)
    assert np.isnan(next(source.frames()).decode().depth_m).all()
    assert source.ledger()["depth_without_returns"] == 1


def test_the_sensor_of_a_profile_bounds_the_depth_of_frames(seven, tmp_path):
    profile = tmp_path / "mine.toml"
    plain = next(open_source(seven, REGISTERED).frames()).decode()
    farthest_m = float(np.nanmedian(plain.depth_m))
    profile.write_text(f"[sensor]\nnoise_per_m = 0.0019\nmax_m = {farthest_m!r}\nbias_m = 0.1\n")
    frame = next(open_source(seven, SourceOptions(profile=str(profile))).frames()).decode()
    assert frame.sensor == DepthSensor(noise_per_m=0.0019, max_m=farthest_m, bias_m=0.1)
    expected = np.where(plain.depth_m - 0.1 <= farthest_m, plain.depth_m - np.float32(0.1), np.nan)
    np.testing.assert_allclose(frame.depth_m, expected, atol=1e-6)


@pytest.mark.parametrize(("text", "message"), [
    ("depth_unit = 3", "unexpected keyword argument 'depth_unit'"),
    ("[color]\nfx = 3.0", "missing"),
    ("frame_rate_hz = 0", "frame_rate_hz is 0; expected 1 to 1000 Hz"),
    ("[sensor]\nmax_m = -5", "max_m is -5; expected 0.01 to 10000 m"),
    ("depth_units_per_m = nan", "depth_units_per_m is nan; expected 0.001 to 1000000000 1/m"),
    ("color_from_depth_m = [0, inf, 0]", "color_from_depth_m is .*inf.*; expected -100 to 100 m"),
    ("[color]\nfx = nan\nfy = 1\ncx = 1\ncy = 1", "fx is nan; expected 0.001 to 1000000 px"),
    ("[time]\nsync_tolerance_ms = nan", "sync_tolerance_ms is nan; expected 0.001 to 3600000 ms"),
    ("[time]\njump_m = inf", "jump_m is inf; expected 0.001 to 1000 m"),
    (RIG, "translation_m is .*nan.*; expected -1000 to 1000 m"),
    ("= 4", "Invalid"),
])  # fmt: skip
def test_a_profile_with_a_mistake_is_refused(seven, tmp_path, text, message):
    profile = tmp_path / "mine.toml"
    profile.write_text(text)
    with pytest.raises(CalibrationError, match=message):
        open_source(seven, SourceOptions(profile=str(profile)))


def test_a_tum_folder_without_intrinsics_uses_the_known_profile(tum):
    with pytest.raises(CalibrationError, match=r"no profile 'kinect'; there are arkit_scenes, bop, hope, .*, tum, zed"):
        open_source(tum, SourceOptions(profile="kinect"))
    with pytest.raises(RecordingError, match="found 6 color_without_depth, 6 depth_without_color"):
        open_source(tum, SourceOptions(sync_tolerance_ns=1_000_000))
    (tum / "camera-intrinsics.txt").unlink()
    camera = open_source(tum).info.camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (65.625, 65.625, 39.5, 29.5)  # an eighth of 640x480
    for pattern in ("rgb/*", "depth/*"):
        _resize(tum, pattern, (80, 45))
    with pytest.raises(CalibrationError, match=r"of 640x480 pixels, those of 80x45.*camera-intrinsics.txt"):
        open_source(tum)


@pytest.mark.parametrize("parameters", [
    {"fx": 70.0, "fy": 70.0, "cx": 39.5, "cy": 29.5, "depth_scale": 0.001},
    {"K": scenes.CAMERA.K.tolist(), "depth_units_per_m": 1000.0},
    {"camera": {"fx": 70.0, "fy": 70.0, "cx": 39.5, "cy": 29.5}},
])  # fmt: skip
def test_cam_params_and_poses_are_read_as_people_write_them(posed, parameters):
    (posed / "cam_params.json").write_text(json.dumps(parameters))
    # Twelve numbers are as good as sixteen.
    np.savetxt(posed / "camera_poses.txt", [truth.world_from_camera[:3].ravel() for truth in TRUTH])
    source = open_source(posed)
    assert source.info.camera == scenes.CAMERA
    for raw, truth in zip(source.frames(), TRUTH, strict=True):
        np.testing.assert_allclose(raw.world_from_camera, truth.world_from_camera, atol=1e-9)
    np.testing.assert_allclose(next(source.frames()).decode().depth_m, TRUTH[0].depth_m, atol=1e-6)


def _resize(folder, pattern, size):
    for file in folder.glob(pattern):
        image = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        scenes.write_png(file, cv2.resize(image, size, interpolation=cv2.INTER_NEAREST))


@pytest.mark.parametrize("is_sized", [False, True])
def test_depth_of_half_the_size_has_intrinsics_of_half(posed, is_sized):
    if not is_sized:
        parameters = json.loads((posed / "cam_params.json").read_text())["camera"]
        (posed / "cam_params.json").write_text(json.dumps({k: v for k, v in parameters.items() if k not in "wh"}))
    _resize(posed, "depth/*.png", (40, 30))
    frame = next(open_source(posed).frames()).decode()
    both = np.isfinite(frame.depth_m) & np.isfinite(TRUTH[0].depth_m)
    assert both.mean() > 0.9 * np.isfinite(TRUTH[0].depth_m).mean()
    assert np.median(np.abs(frame.depth_m - TRUTH[0].depth_m)[both]) < 0.02
    assert (frame.camera.fx, frame.camera.cx) == (scenes.CAMERA.fx, scenes.CAMERA.cx)


def test_images_resized_since_their_calibration_are_told(posed):
    for pattern in ("rgb/*", "depth/*"):
        _resize(posed, pattern, (160, 120))
    source = open_source(posed)
    assert (source.info.camera.fx, source.info.camera.cx) == (140.0, 79.5)
    assert dict(source.info.streams)["camera_info"] == "cam_params.json (scaled from 80x60)"


@pytest.mark.parametrize(("parameters", "told"), [
    ({"w": 80, "h": 45}, "are of images of 80x45 pixels, those of 80x60"),
    ({"cx": 159.5, "cy": 119.5}, "not those of images of 80x60"),
])  # fmt: skip
def test_intrinsics_of_other_images_are_refused(posed, parameters, told):
    camera = {"fx": 70, "fy": 70, "cx": 39.5, "cy": 29.5, "scale": 1000}
    (posed / "cam_params.json").write_text(json.dumps({**camera, **parameters}))
    with pytest.raises(CalibrationError, match=told):
        open_source(posed)
