import json
import numpy as np
import pytest
from hickory_stream.errors import CalibrationError, InputError, NoPosesError, RecordingError
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import invert
from players import SourceOptions, open_source
from players.doctor.diagnosis import examine
from players.logs.layouts.table import LAYOUTS, layout_of
from tests import player_scenes as scenes
from tools.worlds.image_folders import FOLDER_LOGS

ICL_CAMERA = Camera(width=80, height=60, fx=60.15, fy=60.0, cx=39.5, cy=29.5)
KINDS = {
    "bop": "BOP scene", "icl_nuim": "ICL-NUIM folder", "arkit_scenes": "ARKitScenes folder", "open3d": "Open3D folder",
    "nerfstudio": "nerfstudio folder", "scannet": "ScanNet folder",
}  # fmt: skip
FAR_M = 4.5
# Frames without a pose, as the data sets have them.
UNPOSED = {"icl_nuim": 0, "scannet": 2}


def camera_of(layout):
    return ICL_CAMERA if layout == "icl_nuim" else scenes.CAMERA


def write(layout, folder):
    with FOLDER_LOGS[layout](folder, camera_of(layout), 98) as log:
        for true in scenes.make_scene():
            log.write_pose(true.stamp_ns, true.world_from_camera, np.zeros(6))
            rgb, depth = scenes.cast(camera_of(layout), true.world_from_camera)
            if log.depth_view is not None:
                depth = scenes.cast(log.depth_view.camera, true.world_from_camera)[1]
            log.write_images(true.stamp_ns, rgb, np.where(depth < FAR_M, depth, np.nan).astype(np.float32))
    return folder


def true_poses(layout):
    return [frame.world_from_camera for i, frame in enumerate(scenes.make_scene()) if i != UNPOSED.get(layout)]


@pytest.fixture(params=FOLDER_LOGS)
def written(request, tmp_path):
    return request.param, write(request.param, tmp_path / request.param)


def scene_of(folder):
    return next((file.parent for file in folder.glob("*/*/scene_camera.json")), folder)


def text_files(folder):
    suffixes = (".json", ".txt", ".log", ".traj", ".pincam", ".sim")
    return [file for file in sorted(folder.rglob("*")) if file.suffix in suffixes]


def test_poses_are_true_and_the_world_is_upright(written):
    layout, folder = written
    source = open_source(folder)
    assert source.info.kind == KINDS[layout]
    found, true = [raw.world_from_camera for raw in source.frames()], true_poses(layout)
    found_from_true = found[0] @ invert(true[0])
    assert np.degrees(np.arccos(min(1.0, found_from_true[2, 2]))) < 1.0
    # Names of ARKitScenes have milliseconds.
    slack = 5e-4 if layout == "arkit_scenes" else 1e-5
    if layout not in ("bop", "open3d"):
        np.testing.assert_allclose(found_from_true, np.eye(4), atol=slack)
    for pose, true_pose in zip(found, true, strict=True):
        np.testing.assert_allclose(pose, found_from_true @ true_pose, atol=slack)


def test_images_are_the_scene_in_metres(written):
    layout, folder = written
    for raw, pose in zip(open_source(folder).frames(), true_poses(layout), strict=True):
        frame = raw.decode()
        rgb, depth = scenes.cast(camera_of(layout), pose)
        np.testing.assert_allclose(frame.camera.K, camera_of(layout).K, atol=1e-5)
        assert np.abs(frame.rgb.astype(int) - rgb).mean() < 8.0
        both = np.isfinite(frame.depth_m) & (depth < FAR_M)
        assert both.mean() > 0.8 * (depth < FAR_M).mean() > 0.1
        # Depth of half as many rows lies on slanted floors.
        slack = 0.02 if layout not in ("nerfstudio", "scannet") else 0.12
        assert (np.abs(frame.depth_m - depth)[both] < slack).mean() > 0.95


def test_the_table_and_the_doctor_know_every_layout(written):
    layout, folder = written
    assert len({one.name for one in LAYOUTS if one.marks}) == len(LAYOUTS)
    found = examine([folder], SourceOptions())
    assert (found.kind, found.refusal, found.frames["frames"]) == (KINDS[layout], None, len(true_poses(layout)))
    assert layout_of(folder).missing(folder) == ()
    if layout == "scannet":
        (folder / "intrinsic/intrinsic_depth.txt").unlink()
        assert layout_of(folder).missing(folder) == ("intrinsic/intrinsic_depth.txt",)
    if layout == "arkit_scenes":
        stamps = [raw.stamp_ns for raw in open_source(folder).frames()]
        assert max(abs(a - frame.stamp_ns) for a, frame in zip(stamps, scenes.make_scene(), strict=True)) < 1_000_000


def test_lost_poses_and_lonely_images_are_in_the_ledger(written):
    layout, folder = written
    next(folder.rglob(f"*{FOLDER_LOGS[layout].depth.split('/')[-2]}/*4*.png")).unlink()
    source = open_source(folder)
    list(source.frames())
    fates = {fate: number for fate, number in source.ledger().items() if fate != "frames"}
    assert fates == {"color_without_depth": 1, **({"no_pose": 1} if layout in UNPOSED else {})}
    assert source.account().as_dict()["difference"] == 0


def test_a_torn_first_image_costs_one_frame(written):
    layout, folder = written
    image = sorted(folder.rglob(f"*{FOLDER_LOGS[layout].color.split('/')[-2]}/*"))[1]
    image.write_bytes(image.read_bytes()[:8])
    source, torn = open_source(folder), 0
    for raw in source.frames():
        try:
            raw.decode()
        except RecordingError as error:
            torn += 1
            assert image.name in str(error)
    assert torn == source.ledger()["unreadable_image"] == 1


@pytest.mark.parametrize("content", [None, b"", b"\xff\xfe\x00", b"nan " * 12, b"-inf", b"{}", b"[1]", b'{"0": null}'])
def test_damaged_text_is_refused_in_one_line_or_counted(written, content):
    _, folder = written
    files = text_files(folder)
    for file in [*files[:3], files[-1]]:
        whole = file.read_bytes()
        if content is None:
            file.unlink()
        else:
            file.write_bytes(content)
        try:
            source = open_source(folder, SourceOptions(odometry="topic"))
            list(source.frames())
            assert source.account().as_dict()["difference"] == 0
        except InputError as error:
            assert "\n" not in str(error)
        file.write_bytes(whole)


def poses_by_frame(layout, folder):
    starts_ns = scenes.make_scene()[0].stamp_ns // 1_000_000 * 1_000_000 if layout == "arkit_scenes" else 0
    rate_hz = {"arkit_scenes": 10, "bop": 4, "nerfstudio": 4}.get(layout, 30)
    frames = open_source(folder, SourceOptions(odometry="topic")).frames()
    return {round((raw.stamp_ns - starts_ns) * rate_hz / 1e9): raw.world_from_camera for raw in frames}


def test_cut_off_text_is_refused_or_costs_frames_only(written):
    layout, folder = written
    expected = poses_by_frame(layout, folder)
    files = [file for file in text_files(folder) if file.suffix != ".pincam"]
    for file in [files[0], *files[-2:]]:
        whole = file.read_bytes()
        for share in (0.3, 0.6, 0.95):
            file.write_bytes(whole[: int(share * len(whole))])
            try:
                found = poses_by_frame(layout, folder)
            except InputError as error:
                assert "\n" not in str(error)
                continue
            for index, pose in found.items():
                np.testing.assert_allclose(pose, expected[index], atol=1e-5)
        file.write_bytes(whole)


def test_bop_has_intrinsics_by_image_and_names_its_scenes(tmp_path):
    folder = write("bop", tmp_path / "bop")
    file = scene_of(folder) / "scene_camera.json"
    table = json.loads(file.read_text())
    table["1"]["cam_K"][2] += 3.0
    del table["2"]["cam_K"]
    file.write_text(json.dumps(table))
    with pytest.raises(CalibrationError, match=r"KeyError\('cam_K'\); expected cam_K and depth_scale of image 2"):
        open_source(folder)
    del table["2"]
    file.write_text(json.dumps(table))
    source = open_source(folder)
    np.testing.assert_allclose([raw.camera.cx for raw in source.frames()], [39.5, 42.5, 39.5, 39.5, 39.5])
    assert source.ledger() == {"frames": 5, "no_intrinsics": 1}
    (folder / "val/000007").mkdir(parents=True)
    (folder / "val/000007/scene_camera.json").write_text("{}")
    with pytest.raises(RecordingError, match=r"of 2 scenes; name one of them: test/000001, val/000007"):
        open_source(folder)


def objects_of(poses, order):
    # Two cups of one model and a box, whose poses in the cameras are in millimetres.
    at = [(1, (3.0, 0.3, 0.0)), (1, (2.5, -0.4, 0.0)), (7, (3.5, 0.0, 0.5))]
    entries = []
    for model, place in (at[i] for i in order):
        camera_from_object = invert(poses)
        camera_from_object[:3, 3] += camera_from_object[:3, :3] @ place
        rotation, shift = camera_from_object[:3, :3], camera_from_object[:3, 3]
        entries.append({"obj_id": model, "cam_R_m2c": rotation.ravel().tolist(), "cam_t_m2c": (1000 * shift).tolist()})
    return entries


def test_objects_that_do_not_move_tell_how_a_bop_camera_moved(tmp_path):
    folder = write("bop", tmp_path / "bop")
    scene, true = scene_of(folder), true_poses("bop")
    file = scene / "scene_camera.json"
    table = {k: {n: v for n, v in entry.items() if "w2c" not in n} for k, entry in json.loads(file.read_text()).items()}
    file.write_text(json.dumps(table))
    with pytest.raises(NoPosesError, match="6 no_pose"):
        open_source(folder, SourceOptions(odometry="topic"))
    entries = {str(i): objects_of(pose, (0, 1, 2) if i < 4 else (0, 2)) for i, pose in enumerate(true)}
    # The objects of the last image moved against one another.
    for entry in entries["5"]:
        entry["cam_t_m2c"][0] += 400.0 * entry["obj_id"]
    (scene / "scene_gt.json").write_text(json.dumps(entries))
    source = open_source(folder)
    found = [raw.world_from_camera for raw in source.frames()]
    for pose, true_pose in zip(found, true[:5], strict=True):
        np.testing.assert_allclose(invert(found[0]) @ pose, invert(true[0]) @ true_pose, atol=1e-6)
    assert source.ledger()["no_pose"] == 1


def test_icl_poses_of_the_first_camera_are_read_as_well(tmp_path):
    folder = write("icl_nuim", tmp_path / "icl")
    rows = []
    for i, block in enumerate((folder / "livingRoom0n.gt.sim").read_text().split("\n\n"), start=1):
        pose = np.array([float(word) for word in block.split()]).reshape(3, 4)
        rows.append(f"{i} " + " ".join(str(value) for value in scenes.pose_row(np.vstack([pose, [0, 0, 0, 1]]))))
    (folder / "livingRoom0n.gt.sim").unlink()
    (folder / "livingRoom0.gt.freiburg").write_text("\n".join(rows))
    for raw, pose in zip(open_source(folder).frames(), true_poses("icl_nuim"), strict=True):
        np.testing.assert_allclose(raw.world_from_camera, pose, atol=1e-5)


def test_nerfstudio_images_are_rectified(tmp_path):
    folder = write("nerfstudio", tmp_path / "nerf")
    plain = next(open_source(folder).frames())
    table = json.loads((folder / "transforms.json").read_text())
    (folder / "transforms.json").write_text(json.dumps({**table, "k1": 0.2}))
    raw = next(open_source(folder).frames())
    assert (plain.color_bytes is None, raw.color_bytes) == (False, None)
    frame, before = raw.decode(), plain.decode()
    np.testing.assert_array_equal(frame.rgb[29:31, 39:41], before.rgb[29:31, 39:41])
    assert np.abs(frame.rgb.astype(int) - before.rgb)[:10, :10].mean() > 5.0


POSED = {"transform_matrix": np.eye(4).tolist()}


@pytest.mark.parametrize(("change", "message"), [
    ({"camera_model": "EQUIRECTANGULAR"}, "camera_model EQUIRECTANGULAR"),
    ({"fl_x": -3.0}, "fx is -3.0; expected 0.001"),
    ({"k1": float("nan")}, "distortion"),
    ({"depth_unit_scale_factor": 0}, "ZeroDivisionError"),
    ({"frames": [{**POSED, "file_path": "images/frame_00000.png"}]}, "no frame has"),
    ({"frames": [{"file_path": "a.png"}]}, "transform_matrix"),
    ({"frames": [{**POSED, "file_path": 500 * "a", "depth_file_path": "b"}]}, "found 1 depth_without_color"),
])  # fmt: skip
def test_a_nerfstudio_file_without_a_pinhole_or_depth_is_refused(tmp_path, change, message):
    folder = write("nerfstudio", tmp_path / "nerf")
    table = json.loads((folder / "transforms.json").read_text())
    (folder / "transforms.json").write_text(json.dumps({**table, **change}))
    with pytest.raises(InputError, match=message):
        open_source(folder)


def test_an_open3d_folder_takes_gravity_and_needs_a_trajectory(tmp_path):
    folder = write("open3d", tmp_path / "o3d")
    np.savetxt(folder / "gravity-direction.txt", scenes.make_scene()[0].world_from_camera[:3, :3].T @ (0.0, 0.0, -1.0))
    source = open_source(folder)
    assert dict(source.info.streams)["up"] == "gravity-direction.txt"
    assert next(source.frames()).world_from_camera[2, 1] == pytest.approx(-1.0, abs=1e-6)
    (folder / "trajectory.log").unlink()
    with pytest.raises(NoPosesError, match=r"has no trajectory\.log; --odometry depth estimates poses"):
        open_source(folder, SourceOptions(odometry="topic"))
    (folder / "camera_intrinsic.json").unlink()
    assert layout_of(folder) is None
