"""A mesh with a picture on it: what exports, pictures and the viewer take in the place of colours per vertex."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.mesh import Mesh

_JPEG_QUALITY = 92


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TexturedMesh:
    """A mesh whose vertices lie in an image; a vertex on the border of two charts is in `mesh` once for each."""

    mesh: Mesh
    #: (V, 2) float32 in 0..1, u right and v down, as in glTF and Rerun
    uv: NDArray[np.float32]
    #: (S, S, 3) uint8 RGB
    image: NDArray[np.uint8]
    #: (V,) the vertex of the bare mesh
    source: NDArray[np.int32]

    def __post_init__(self) -> None:
        freeze(self, "uv", np.float32, (len(self.mesh.vertices), 2))
        freeze(self, "source", np.int32, (len(self.mesh.vertices),))
        freeze(self, "image", np.uint8, (len(self.image), len(self.image), 3))


def jpeg_bytes(textured: TexturedMesh) -> bytes:
    """Return the image as a JPEG."""
    import cv2

    _, data = cv2.imencode(".jpg", textured.image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return data.tobytes()


def png_bytes(textured: TexturedMesh) -> bytes:
    """Return the image as a PNG, for programs that read no other."""
    import cv2

    return cv2.imencode(".png", textured.image[..., ::-1])[1].tobytes()


def trimesh_visual(textured: TexturedMesh) -> Any:
    """Return the look of the mesh as trimesh writes it into a GLB: the JPEG, without light of its own."""
    import io

    import trimesh
    from PIL import Image

    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.open(io.BytesIO(jpeg_bytes(textured))), metallicFactor=0.0, roughnessFactor=1.0
    )
    # Its v goes up.
    uv = np.column_stack([textured.uv[:, 0], 1 - textured.uv[:, 1]])
    return trimesh.visual.TextureVisuals(uv=uv, material=material)
