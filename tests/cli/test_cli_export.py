import json
from dataclasses import replace
import numpy as np
import pytest
import trimesh
from hickory_stream.geometry.mesh import Mesh, sha256_of, write_glb
from hickory_stream.geometry.rigid import apply
from hickory_stream.map_folder.saved_map import open_map
from players.poses.pose_file import read_pose_file
from tests.cli.test_cli import answer, ended_as, look, refusal, said
from tests.cli.test_cli_navigation import saved
from tests.engine.snapshot_fixtures import box_mesh
from tests.navigation.rooms import table, tracked

FIRST_BYTES = {"glb": b"glTF", "ply": b"ply\n", "json": b"{"}


@pytest.mark.parametrize(
    ("ending", "form"),
    [("glb", "glb"), ("PLY", "ply"), ("obj", "obj"), ("stl", "stl"), ("tum", "tum"), ("htm", "html"), ("json", "json")],
)
def test_the_ending_of_a_file_chooses_the_format(short_map, tmp_path, ending, form):
    out = tmp_path / f"map.{ending}"
    assert answer("export", short_map, "-o", out, "--texture", 0)["format"] == form
    assert out.read_bytes().startswith(FIRST_BYTES.get(form, b""))
    if form == "json":
        ids = [tracked.id for tracked in open_map(short_map).snapshot.objects]
        assert [entry["id"] for entry in json.loads(out.read_text())["objects"]] == ids


@pytest.mark.parametrize(("arguments", "complaint"), [
    (("export", "-o", "x.foo"), "a name that ends in .json, .ply, .glb"),
    (("export", "-o", "map"), "or choose a --format"),
    (("export", "--format", "glb", "-o", "x.json"), "a name that ends in .glb"),
    (("export", "--format", "nav2", "--robot", "point", "-o", "x.pgm"), ".yaml or .yml"),
    (("export", "--format", "urdf", "-o", "x.glb"), "the name of a folder"),
    (("render", "-o", "z.foo"), "a name that ends in .png"),
    (("render", "-o", "z.svg"), "a name that ends in .png"),
    (("render", "--graph", "-o", "z.jpg"), ".png or .svg"),
])  # fmt: skip
def test_an_ending_that_contradicts_is_refused(short_map, tmp_path, arguments, complaint, monkeypatch):
    monkeypatch.chdir(tmp_path)
    command, *rest = arguments
    (refused,) = refusal(command, short_map, *rest).splitlines()
    assert complaint in refused
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("ending", ["stl", "obj"])
def test_closed_meshes_are_read_as_closed_in_the_world(short_map, tmp_path, ending):
    out = tmp_path / f"map.{ending}"
    assert answer("export", short_map, "-o", out)["open_meshes"] == 0
    read, of_map = trimesh.load(out, force="mesh"), open_map(short_map)
    shapes = [item.shape for item in of_map.snapshot.objects if item.shape is not None]
    assert read.is_watertight
    assert len(read.faces) == sum(len(of_map.mesh(shape).faces) for shape in shapes)
    corners = np.concatenate([apply(shape.world_from_object, of_map.mesh(shape).vertices) for shape in shapes])
    np.testing.assert_allclose(read.bounds, [corners.min(axis=0), corners.max(axis=0)], atol=1e-5)


@pytest.mark.parametrize("texture", [0, 64])
def test_a_glb_says_how_many_meshes_have_seams(short_map, tmp_path, texture):
    out = tmp_path / "map.glb"
    ended = look("export", short_map, "-o", out, "--texture", texture)
    read = trimesh.load(out, force="scene").geometry.values()
    num_open = sum(not mesh.is_watertight for mesh in read)
    assert (num_open > 0) == (texture > 0)
    assert (f"note: {num_open} of the meshes are not watertight; textures" in ended.stderr) == (texture > 0)


@pytest.mark.parametrize("ending", ["glb", "stl", "obj"])
def test_a_mesh_that_is_open_in_the_map_is_counted(tmp_path, ending):
    whole = box_mesh((1.0, 0.5, 0.2), (120, 90, 60))
    cut = Mesh(vertices=whole.vertices, faces=whole.faces[1:], colors=whole.colors, is_seen=whole.is_seen)
    one, other = tracked(1, table()), tracked(2, table())
    shape = replace(one.shape, mesh_name="cut.glb", mesh_sha256=sha256_of(cut))
    folder = saved(tmp_path / "a.map", replace(one, shape=shape), other)
    write_glb(cut, folder / "shapes" / "cut.glb")
    ended = ended_as(0, "export", folder, "-o", tmp_path / f"a.{ending}", "--texture", 0)
    assert ended.stderr == "note: 1 of the meshes are not watertight\n"


def test_an_exported_trajectory_has_every_frame_of_the_log(short_map, short_log, tmp_path):
    said("export", short_map, "-o", tmp_path / "map.tum")
    said("odometry", short_log, "--odometry", "topic", "-o", tmp_path / "log.tum")
    # The poses of the demo are exact: nothing is corrected.
    for ours, of_log in zip(*(read_pose_file(tmp_path / f"{name}.tum", None) for name in ("map", "log")), strict=True):
        np.testing.assert_allclose(ours, of_log, atol=1e-6)
    said("export", short_map, "--at", 1, "-o", tmp_path / "early.tum")
    early, whole = ((tmp_path / f"{name}.tum").read_text() for name in ("early", "map"))
    assert whole.startswith(early)
    assert 2 < early.count("\n") < whole.count("\n")


def test_a_map_without_poses_is_refused_in_a_line(tmp_path):
    (refused,) = refusal("export", saved(tmp_path / "a.map"), "-o", tmp_path / "a.tum").splitlines()
    assert "holds no journal" in refused
