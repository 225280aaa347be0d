import numpy as np
import pytest
import trimesh
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.geometry.superquadric import Superquadrics
from hickory_stream.ports import Reconstruction
from hickory_stream.shapes.build import seen_shares


@pytest.mark.parametrize(("cut", "share"), [(-1.0, 1.0), (0.0, 0.5), (0.25, 0.25), (1.0, 0.0)])
def test_the_seen_share_is_that_of_the_area(cut, share):
    # Of a ball, the area above a height is proportional to what is left of the diameter.
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    place = from_rotation_translation(np.eye(3), np.array([2.0, -1.0, 0.5]))
    reconstruction = Reconstruction(
        mesh=Mesh(
            vertices=ball.vertices.astype(np.float32),
            faces=ball.faces.astype(np.int32),
            colors=np.zeros((len(ball.vertices), 3), np.uint8),
            is_seen=np.asarray(ball.vertices[:, 2] > cut),
        ),
        world_from_object=place,
    )
    fitted = Superquadrics(exponents=np.ones((1, 2)), semi_axes_m=np.full((1, 3), 0.5), world_from_local=place[None])
    assert seen_shares(fitted, reconstruction) == pytest.approx([share], abs=0.02)
