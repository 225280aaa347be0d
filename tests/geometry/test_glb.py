import json
import struct
import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.geometry.mesh import Mesh, glb_arrays, glb_bytes, mesh_of_glb, sha256_of

SOLID = trimesh.creation.box((1.0, 2.0, 3.0))
MESH = Mesh(
    vertices=SOLID.vertices,
    faces=SOLID.faces,
    colors=np.arange(24, dtype=np.uint8).reshape(8, 3),
    is_seen=np.arange(8) % 3 == 0,
)
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
    (tmp_path / "box.glb").write_bytes(GLB)
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
    "no_view": lambda d: d["accessors"][1].pop("bufferView"),
    "sparse": lambda d: d["accessors"][1].update(sparse={}),
    "beyond": lambda d: d["bufferViews"][0].update(byteOffset=10**9),
    "text_offset": lambda d: d["bufferViews"][0].update(byteOffset="0"),
    "lines": lambda d: d["meshes"][0]["primitives"][0].update(mode=1),
    "two_meshes": lambda d: d["meshes"].append(d["meshes"][0]),
    "moved": lambda d: d["nodes"][0].update(translation=[1, 0, 0]),
    "no_positions": lambda d: d["meshes"][0]["primitives"][0]["attributes"].pop("POSITION"),
    "wrong_kind": lambda d: d["meshes"][0]["primitives"][0].update(indices=1),
    "other_array": lambda d: d["meshes"][0]["primitives"][0]["attributes"].update(_SEEN=0),
    "no_list": lambda d: d.update(accessors={"0": 1}),
    "null": lambda d: d.update(meshes=None),
}


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
