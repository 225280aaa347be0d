import json
import struct
from dataclasses import replace
import numpy as np
import pytest
import trimesh
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from skimage.measure import marching_cubes
from hickory_stream.geometry.codecs.mesh_file import mesh_file_bytes, mesh_of_file
from hickory_stream.geometry.lattice import MESH_STEPS_PER_M, on_steps
from hickory_stream.geometry.mesh import (
    Mesh,
    face_areas_m2,
    glb_arrays,
    glb_bytes,
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
        vertices=shape.vertices, faces=shape.faces, colors=rng.integers(0, 255, (count, 3)),
        is_seen=rng.random(count) > 0.5,
    )  # fmt: skip


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


def test_the_hash_changes_with_a_single_flag():
    other = BOX.is_seen.copy()
    other[0] = not other[0]
    changed = Mesh(vertices=BOX.vertices, faces=BOX.faces, colors=BOX.colors, is_seen=other)
    assert sha256_of(changed) != sha256_of(BOX)


def ball(num_colors=7, *, is_at_steps=False):
    solid = trimesh.creation.icosphere(3)
    vertices = solid.vertices.astype(np.float32)
    return Mesh(
        vertices=on_steps(vertices, MESH_STEPS_PER_M) if is_at_steps else vertices,
        faces=solid.faces,
        colors=(np.arange(3 * len(solid.vertices)) % num_colors).reshape(-1, 3).astype(np.uint8),
        is_seen=solid.vertices[:, 2] > 0,
    )


@given(st.integers(1, 40), st.integers(0, 60), st.integers(0, 2**32 - 1), st.booleans())
def test_a_mesh_comes_back_exactly(num_vertices, num_faces, seed, is_at_steps):
    rng = np.random.default_rng(seed)
    vertices = rng.normal(size=(num_vertices, 3)).astype(np.float32)
    mesh = Mesh(
        vertices=on_steps(vertices, MESH_STEPS_PER_M) if is_at_steps else vertices,
        faces=rng.integers(0, num_vertices, (num_faces, 3)),
        colors=rng.integers(0, 256, (num_vertices, 3)).astype(np.uint8),
        is_seen=rng.random(num_vertices) < 0.5,
    )
    assert sha256_of(mesh_of_file(mesh_file_bytes(mesh))) == sha256_of(mesh)


def test_it_takes_half_of_a_glb_which_is_read_as_well():
    data, glb = mesh_file_bytes(ball()), glb_bytes(ball())
    assert len(data) < len(glb) / 2
    assert sha256_of(mesh_of_file(data)) == sha256_of(mesh_of_file(glb)) == sha256_of(ball())


def test_a_mesh_at_steps_takes_two_thirds_of_another_one():
    x, y, z = np.mgrid[-1:1:32j, -1:1:32j, -1:1:32j]
    vertices, faces, _, _ = marching_cubes((x - 0.1) ** 2 + 1.3 * y**2 + z**2 + 0.2 * x * y, 0.6, spacing=(0.02,) * 3)
    count = len(vertices)
    colors, is_seen = np.full((count, 3), 99, np.uint8), np.ones(count, bool)
    mesh = Mesh(vertices=vertices.astype(np.float32), faces=faces, colors=colors, is_seen=is_seen)
    data = mesh_file_bytes(replace(mesh, vertices=on_steps(vertices, MESH_STEPS_PER_M)))
    assert data.startswith(b"HSM2")
    assert len(data) < 0.67 * len(mesh_file_bytes(mesh))


AT_STEPS = mesh_file_bytes(ball(is_at_steps=True))
WHOLE = mesh_file_bytes(ball())
BODY = zstandard.decompress(WHOLE[12:])
DAMAGED = {
    "empty": b"", "only its name": b"HSM1", "cut": WHOLE[:-20], "cut, at steps": AT_STEPS[:-20],
    "more than there is, at steps": struct.pack("<4sII", b"HSM2", 2**32 - 1, 2**32 - 1) + AT_STEPS[12:],
    "other kind": b"HSM2" + WHOLE[4:],
    "more than there is": struct.pack("<4sII", b"HSM1", 2**32 - 1, 2**32 - 1) + WHOLE[12:],
    "other numbers of the same size": struct.pack("<4sII", b"HSM1", 5, 5) + WHOLE[12:],
    "no frame": WHOLE[:12] + bytes(40), "not finite": WHOLE[:12] + zstandard.compress(b"\xff" * len(BODY)),
    "a face of no vertex": WHOLE[:12] + zstandard.compress(BODY[: 15 * 642] + b"\x80" * (12 * 1280) + BODY[-81:]),
}  # fmt: skip


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_file_is_refused(name):
    reasons = {"not finite": "a vertex that is not finite", "a face of no vertex": r"but with vertices 0 to 641 only"}
    with pytest.raises(ValueError, match=reasons.get(name, r".")):
        mesh_of_file(DAMAGED[name])


SOLID = trimesh.creation.box((1.0, 2.0, 3.0))
MESH = Mesh(
    vertices=SOLID.vertices, faces=SOLID.faces, colors=np.arange(24, dtype=np.uint8).reshape(8, 3),
    is_seen=np.arange(8) % 3 == 0,
)  # fmt: skip
GLB = glb_bytes(MESH)


def with_document(change):
    """Return the file with another document, well-formed."""
    size = struct.unpack_from("<I", GLB, 12)[0]
    document = json.loads(GLB[20 : 20 + size])
    change(document)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = GLB[20 + size :]
    header = struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest))
    return header + struct.pack("<I4s", len(text), b"JSON") + text + rest


def test_what_was_written_is_read_and_so_does_every_other_reader(tmp_path):
    assert sha256_of(mesh_of_glb(GLB)) == sha256_of(MESH)
    write_glb(MESH, tmp_path / "box.glb")
    assert (tmp_path / "box.glb").read_bytes() == GLB
    loaded = trimesh.load(tmp_path / "box.glb", force="mesh", process=False)
    assert np.array_equal(loaded.vertices.astype(np.float32), MESH.vertices)
    assert np.array_equal(loaded.faces, MESH.faces)


def test_a_file_without_colours_and_flags_is_grey_and_seen():
    def bare(document):
        attributes = document["meshes"][0]["primitives"][0]["attributes"]
        document["meshes"][0]["primitives"][0]["attributes"] = {"POSITION": attributes["POSITION"]}

    read = mesh_of_glb(with_document(bare))
    assert read.is_seen.all()
    assert (read.colors == 180).all()


CHANGES = {
    "another_file": lambda d: d["buffers"][0].update(uri="../../secret.bin"),
    "an_image": lambda d: d.update(images=[{"uri": "file:///etc/passwd"}]),
    "an_extension": lambda d: d.update(extensionsRequired=["KHR_draco_mesh_compression"]),
    "huge_count": lambda d: d["accessors"][1].update(count=10**15),
    "negative_count": lambda d: d["accessors"][1].update(count=-1),
    "no_view": lambda d: d["accessors"][1].pop("bufferView"), "sparse": lambda d: d["accessors"][1].update(sparse={}),
    "beyond": lambda d: d["bufferViews"][0].update(byteOffset=10**9),
    "text_offset": lambda d: d["bufferViews"][0].update(byteOffset="0"),
    "lines": lambda d: d["meshes"][0]["primitives"][0].update(mode=1),
    "two_meshes": lambda d: d["meshes"].append(d["meshes"][0]),
    "moved": lambda d: d["nodes"][0].update(translation=[1, 0, 0]),
    "no_positions": lambda d: d["meshes"][0]["primitives"][0]["attributes"].pop("POSITION"),
    "wrong_kind": lambda d: d["meshes"][0]["primitives"][0].update(indices=1),
    "other_array": lambda d: d["meshes"][0]["primitives"][0]["attributes"].update(_SEEN=0),
    "no_list": lambda d: d.update(accessors={"0": 1}), "null": lambda d: d.update(meshes=None),
}  # fmt: skip


@pytest.mark.parametrize("name", CHANGES)
def test_a_document_with_more_than_one_mesh_is_refused(name):
    with pytest.raises(ValueError, match=r"."):
        mesh_of_glb(with_document(CHANGES[name]))


def test_unknown_vertices_and_infinite_ones_are_refused():
    at = GLB.index(b"BIN\0") + 4
    with pytest.raises(ValueError, match="other vertices than the 8"):
        glb_arrays(GLB[:at] + struct.pack("<I", 8) + GLB[at + 4 :])
    at = GLB.index(MESH.vertices[:1].tobytes())
    with pytest.raises(ValueError, match="finite"):
        mesh_of_glb(GLB[:at] + struct.pack("<f", float("nan")) + GLB[at + 4 :])


@given(st.integers(0, len(GLB) - 1), st.binary(min_size=0, max_size=8), st.booleans())
def test_damage_anywhere_is_a_mesh_or_a_value_error(at, data, is_cut):
    try:
        mesh_of_glb(GLB[:at] if is_cut else GLB[:at] + data + GLB[at + len(data) :])
    except ValueError:
        pass
