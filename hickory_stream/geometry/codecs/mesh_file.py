"""The file of a mesh in a map folder: its arrays as they compress, exact, a fifth of a GLB of the same mesh.

`HSM2`, the numbers of vertices and of faces (little-endian, 4 bytes each), then a frame of zstd: vertices (V, 3) in
steps from one to the next (`lattice`), colours (`packing`), indices of faces, and a bit for each seen vertex. An index
is its distance below the next vertex that no face before it has named (`packing.unsigned`), mostly small. Where a
vertex lies at no step the file begins with `HSM1`, and vertices are float32 (`packing`).
"""

import struct

import numpy as np
import zstandard
from numpy.typing import NDArray

from hickory_stream.geometry.codecs.packing import array_of, color_planes, colors_of, planes_of, signed, unsigned
from hickory_stream.geometry.lattice import MESH_STEPS_PER_M, packed_points, points_of, unpacked_steps
from hickory_stream.geometry.mesh import Mesh, mesh_of_glb

SUFFIX = ".mesh"

_AT_STEPS, _ANYWHERE = b"HSM2", b"HSM1"
_HEADER = struct.Struct("<4sII")
_FLOAT, _SIGNED, _UNSIGNED = np.dtype("<f4"), np.dtype("<i4"), np.dtype("<u4")


def mesh_file_bytes(mesh: Mesh) -> bytes:
    """Return the file of a mesh; equal meshes give equal bytes."""
    steps, below = packed_points(mesh.vertices, MESH_STEPS_PER_M), _below_next(mesh.faces.reshape(-1))
    body = (
        planes_of(mesh.vertices.astype(_FLOAT, copy=False)) if steps is None else steps,
        color_planes(mesh.colors),
        planes_of(below.astype(_SIGNED, copy=False) if steps is None else unsigned(below)),
        np.packbits(mesh.is_seen).tobytes(),
    )
    header = _HEADER.pack(_ANYWHERE if steps is None else _AT_STEPS, len(mesh.vertices), len(mesh.faces))
    return header + zstandard.compress(b"".join(body), 3)


def mesh_of_file(data: bytes) -> Mesh:
    """Return the mesh of a file of `mesh_file_bytes`, or of a GLB; raises ValueError if it is neither, or damaged."""
    if not data.startswith((_AT_STEPS, _ANYWHERE)):
        return mesh_of_glb(data)
    if len(data) < _HEADER.size:
        raise ValueError("a mesh of which only the beginning is there")
    magic, count, num_faces = _HEADER.unpack_from(data)
    ends = np.cumsum([count * 12, count * 3, num_faces * 12, -(-count // 8)]).tolist()
    # What the header claims must be there: memory is taken for it.
    try:
        found = zstandard.frame_content_size(data[_HEADER.size :])
        if found != ends[-1]:
            raise ValueError(f"a mesh of {count} vertices and {num_faces} faces in {found} bytes")
        body = zstandard.decompress(data[_HEADER.size :])
    except zstandard.ZstdError as error:
        raise ValueError(f"a mesh that is damaged: {error}") from error
    if magic == _AT_STEPS:
        vertices = points_of(unpacked_steps(body[: ends[0]], count), MESH_STEPS_PER_M)
        faces = _indices(signed(array_of(body[ends[1] : ends[2]], _UNSIGNED, (3 * num_faces,))))
    else:
        vertices = array_of(body[: ends[0]], _FLOAT, (count, 3))
        faces = _indices(array_of(body[ends[1] : ends[2]], _SIGNED, (3 * num_faces,)))
    if not np.isfinite(vertices).all():
        raise ValueError("a mesh with a vertex that is not finite")
    wrong = faces[(faces < 0) | (faces >= count)]
    if len(wrong):
        raise ValueError(f"a mesh with a face of vertex {wrong[0]}, but with vertices 0 to {count - 1} only")
    return Mesh(
        vertices=vertices,
        faces=faces.reshape(-1, 3).astype(np.int32),
        colors=colors_of(body[ends[0] : ends[1]], count),
        is_seen=np.unpackbits(np.frombuffer(body[ends[2] :], np.uint8), count=count).astype(bool),
    )


def _below_next(indices: NDArray[np.int32]) -> NDArray[np.int32]:
    # (N,) how far each index is below the least that is greater than all before it.
    following = np.maximum.accumulate(np.concatenate([[-1], indices[:-1]])) + 1
    return (following - indices).astype(np.int32)


def _indices(below_next: NDArray[np.int32]) -> NDArray[np.int64]:
    gained = np.maximum(1 - below_next.astype(np.int64), np.int64(0))
    following = np.cumsum(gained, dtype=np.int64) - gained
    return following - below_next.astype(np.int64)
