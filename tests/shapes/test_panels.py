import numpy as np
import pytest
import trimesh
from hickory_stream.geometry.superquadric import log_implicit_value
from hickory_stream.shapes.fit.marching_primitives import FitConfig, fitted_shape
from hickory_stream.shapes.fit.panels import panels
from hickory_stream.shapes.inflate.inflation import InflateConfig, inflated
from tests.shapes.shape_fixtures import as_mesh

CONFIG = FitConfig()
TURN = trimesh.transformations.rotation_matrix(0.7, [1.0, 2.0, 3.0])


def turned(mesh):
    mesh.apply_transform(TURN)
    return mesh


def carton():
    """Return an open box of five panels of 4 mm."""
    sides = {(0.4, 0.3, 0.004): [(0, 0, 0.002)]}
    sides[0.4, 0.004, 0.25] = [(0, y, 0.125) for y in (-0.148, 0.148)]
    sides[0.004, 0.3, 0.25] = [(x, 0, 0.125) for x in (-0.198, 0.198)]
    return trimesh.util.concatenate(
        [trimesh.creation.box(size).apply_translation(place) for size, places in sides.items() for place in places]
    )


def bent_sheet():
    """Return a third of a pipe of 1 m in diameter and length, with a wall of 1 mm."""
    angles = np.linspace(-np.pi / 3, np.pi / 3, 25)
    rings = [(r * np.cos(angles), r * np.sin(angles), z) for z in (0.0, 1.0) for r in (0.5, 0.501)]
    vertices = np.concatenate([np.column_stack([x, y, np.full(25, z)]) for x, y, z in rings])
    quads = [(50, 51, 1, 0), (25, 26, 76, 75), (0, 1, 26, 25), (51, 50, 75, 76)]
    faces = [[a + i, b + i, c + i, d + i] for i in range(24) for a, b, c, d in quads]
    faces += [[0, 25, 75, 50], [24, 74, 99, 49]]
    return trimesh.Trimesh(vertices, [t for a, b, c, d in faces for t in ((a, b, c), (a, c, d))], process=False)


def union_m3(primitives):
    """Return the volume of what primitives within 1.5 m of the origin hold together, from points drawn by seed."""
    points = np.random.default_rng(0).uniform(-1.5, 1.5, (200_000, 3))
    inside = np.zeros(len(points), bool)
    for i in range(len(primitives)):
        inside |= log_implicit_value(primitives, i, points) <= 0
    return 27 * float(inside.mean())


def test_a_carpet_is_as_thick_as_it_is():
    found = fitted_shape(as_mesh(turned(trimesh.creation.box((2.0, 1.4, 0.002)))), CONFIG)
    assert found.kind == "panels"
    assert np.sort(found.primitives.semi_axes_m) == pytest.approx(np.array([[0.001, 0.7, 1.0]]), rel=0.01)


def test_a_rod_is_as_thick_as_it_is():
    rod = turned(trimesh.creation.cylinder(radius=0.006, height=5.0, sections=24))
    found = fitted_shape(as_mesh(rod), CONFIG).primitives
    assert np.sort(found.semi_axes_m) == pytest.approx(np.array([[0.006, 0.006, 2.5]]), rel=0.02)


def test_a_carton_keeps_its_five_panels():
    found = fitted_shape(as_mesh(turned(carton())), CONFIG)
    assert found.kind == "panels"
    assert found.primitives.semi_axes_m.min(axis=1) == pytest.approx(np.full(5, 0.002), rel=0.01)


def test_the_panels_of_a_bent_sheet_are_as_thick_as_the_sheet():
    sheet = turned(bent_sheet())
    assert sheet.is_watertight and sheet.volume > 0
    vertices, faces = np.asarray(sheet.vertices), sheet.faces.astype(np.int32)
    found = panels(vertices, faces, most=12, min_size_m=1e-4)
    # One for each of the 24 flat faces that the bend has.
    assert found.primitives.semi_axes_m.min(axis=1) == pytest.approx(np.full(24, 0.0005), rel=0.03)
    assert found.share > 0.95
    grown = inflated(found.primitives, vertices, faces, np.empty((0, 3)), InflateConfig(r_safe_m=0.05))
    assert grown.certificate.holds and not grown.is_fallback
    # The sheet with 5 cm on both sides takes 0.13 m3; one body around the bend more than 0.3.
    assert union_m3(grown.primitives) < 0.16


def test_an_open_mesh_has_no_thickness_to_share():
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    found = panels(square, np.array([[0, 1, 2], [0, 2, 3]], np.int32), most=3, min_size_m=0.01)
    assert found.share == 0.0
    assert len(found.primitives) == 1
