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
from hickory_stream.geometry.mesh import Mesh, glb_bytes, sha256_of


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
