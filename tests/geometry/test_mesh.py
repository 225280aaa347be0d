import numpy as np
import pytest
import trimesh
from hickory_stream.geometry.mesh import (
    Mesh,
    face_areas_m2,
    is_closed,
    mesh_of_glb,
    sample_surface,
    sha256_of,
    volume_m3,
    write_glb,
)


def mesh_of(shape):
    rng = np.random.default_rng(0)
    count = len(shape.vertices)
    return Mesh(
        vertices=shape.vertices,
        faces=shape.faces,
        colors=rng.integers(0, 255, (count, 3)),
        is_seen=rng.random(count) > 0.5,
    )


BOX = mesh_of(trimesh.creation.box((1.0, 2.0, 3.0)))


def test_a_box_has_its_volume_and_its_area_and_is_closed():
    assert volume_m3(BOX) == pytest.approx(6.0)
    assert face_areas_m2(BOX).sum() == pytest.approx(22.0)
    assert is_closed(BOX)


def test_a_mesh_with_a_gap_or_a_turned_face_is_not_closed():
    assert not is_closed(Mesh(vertices=BOX.vertices, faces=BOX.faces[1:], colors=BOX.colors, is_seen=BOX.is_seen))
    faces = BOX.faces.copy()
    faces[0] = faces[0, ::-1]
    assert not is_closed(Mesh(vertices=BOX.vertices, faces=faces, colors=BOX.colors, is_seen=BOX.is_seen))


def test_samples_lie_on_their_faces_and_follow_the_area():
    points, chosen = sample_surface(BOX, 20_000, np.random.default_rng(0))
    assert np.abs(np.abs(points) / np.array([0.5, 1.0, 1.5])).max(axis=1) == pytest.approx(np.ones(20_000), abs=1e-5)
    share = np.bincount(chosen, minlength=12) / 20_000
    assert share == pytest.approx(face_areas_m2(BOX) / 22.0, abs=0.01)


def test_a_glb_keeps_the_mesh_and_equal_meshes_give_equal_files(tmp_path):
    write_glb(BOX, tmp_path / "box.glb")
    assert sha256_of(mesh_of_glb((tmp_path / "box.glb").read_bytes())) == sha256_of(BOX)
    write_glb(BOX, tmp_path / "a.glb")
    write_glb(BOX, tmp_path / "b.glb")
    assert (tmp_path / "a.glb").read_bytes() == (tmp_path / "b.glb").read_bytes()


def test_the_hash_changes_with_a_single_flag():
    other = BOX.is_seen.copy()
    other[0] = not other[0]
    changed = Mesh(vertices=BOX.vertices, faces=BOX.faces, colors=BOX.colors, is_seen=other)
    assert sha256_of(changed) != sha256_of(BOX)
