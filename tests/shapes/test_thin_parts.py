import numpy as np
import trimesh
from hickory_stream.geometry.superquadric import Superquadrics
from hickory_stream.shapes.fit.panels import with_thin_parts

SEAT = Superquadrics(
    exponents=np.full((1, 2), 0.1), semi_axes_m=np.array([[0.2, 0.2, 0.05]]), world_from_local=np.eye(4)[None]
)


def found(parts):
    """Return the primitives of a seat and more parts, of which the fit found the seat, at cells of 2 cm."""
    mesh = trimesh.util.concatenate([trimesh.creation.box((0.4, 0.4, 0.1)), *parts])
    vertices, faces = np.asarray(mesh.vertices), mesh.faces.astype(np.int32)
    return with_thin_parts(SEAT, vertices, faces, step_m=0.02, most=8, least_area=0.01)


def test_a_rod_and_a_board_that_stick_out_keep_their_thickness():
    rod = trimesh.creation.cylinder(radius=0.012, height=0.5, sections=16).apply_translation((0.1, 0.1, -0.3))
    shape = found([rod, trimesh.creation.box((0.4, 0.01, 0.4)).apply_translation((0, 0.19, 0.25))])
    assert len(shape) == 3
    sizes = np.sort(shape.semi_axes_m[1:], axis=1)
    sizes = sizes[np.argsort(sizes[:, 0])]
    np.testing.assert_allclose(sizes[0], (0.005, 0.2, 0.2), rtol=0.05)
    np.testing.assert_allclose(sizes[1, :2], (0.012, 0.012), rtol=0.05)


def test_a_bulge_on_one_side_is_no_part():
    bulge = trimesh.creation.icosphere(subdivisions=3, radius=0.15).apply_translation((0, 0, 0.0))
    assert len(found([bulge])) == 1


def test_nothing_is_added_beyond_the_most():
    rods = [
        trimesh.creation.cylinder(radius=0.01, height=0.5, sections=12).apply_translation((x, y, -0.3))
        for x in (-0.15, -0.05, 0.05, 0.15)
        for y in (-0.15, -0.05, 0.05, 0.15)
    ]
    assert len(found(rods)) == 8
