import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hickory_stream.geometry.rigid import yaw_rotation
from hickory_stream.geometry.superquadric import log_implicit_value
from hickory_stream.shapes.fit.marching_primitives import FitConfig, fitted_shape
from hickory_stream.shapes.fit.panels import panels, with_thin_parts
from hickory_stream.shapes.inflate.inflation import InflateConfig, inflated
from hickory_stream.shapes.inflate.residual_boxes import boxes_around
from tests.shapes.shape_fixtures import as_mesh
from tests.strategies import quadric

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


def test_a_carpet_a_rod_and_five_panels_are_as_thick_as_they_are():
    thin = trimesh.creation.box((2.0, 1.4, 0.002)), trimesh.creation.cylinder(radius=0.006, height=5.0, sections=24)
    carpet, rod, box = (fitted_shape(as_mesh(turned(mesh)), CONFIG) for mesh in (*thin, carton()))
    assert carpet.kind == box.kind == "panels"
    assert np.sort(carpet.primitives.semi_axes_m) == pytest.approx(np.array([[0.001, 0.7, 1.0]]), rel=0.01)
    assert np.sort(rod.primitives.semi_axes_m) == pytest.approx(np.array([[0.006, 0.006, 2.5]]), rel=0.02)
    assert box.primitives.semi_axes_m.min(axis=1) == pytest.approx(np.full(5, 0.002), rel=0.01)


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


SEAT = quadric((0.1, 0.1), (0.2, 0.2, 0.05))


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


def volume(boxes, margin=0.0):
    return sum(float((2 * (box.half_extents + margin)).prod()) for box in boxes)


def tiny_triangles(rng, middles, size=0.01):
    return np.asarray(middles[:, None] + rng.uniform(-size, size, (len(middles), 3, 3)))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 60), st.integers(1, 9), st.sampled_from([0.0, 0.1]))
def test_every_triangle_lies_in_the_one_box_that_holds_it(seed, count, most, margin):
    rng = np.random.default_rng(seed)
    triangles = tiny_triangles(rng, rng.normal(size=(count, 3)) * 10 ** rng.uniform(-2, 1, 3), 0.2)
    boxes = boxes_around(triangles, np.eye(3), margin=margin, most=most)
    assert 1 <= len(boxes) <= min(most, count)
    assert sorted(np.concatenate([box.held for box in boxes])) == list(range(count))
    for box in boxes:
        assert np.linalg.det(box.axes) == pytest.approx(1.0)
        local = (triangles[box.held].reshape(-1, 3) - box.center) @ box.axes
        assert (np.abs(local) <= box.half_extents + 1e-9).all()
    single = boxes_around(triangles, np.eye(3), margin=margin, most=1)
    assert volume(boxes, margin) <= volume(single, margin) * (1 + 1e-9)


def test_leaves_that_are_far_apart_get_a_box_each():
    rng = np.random.default_rng(0)
    middles = np.array([[3.0, 0, 0], [-3.0, 0, 0], [0, 3.0, 0], [0, 0, 3.0]])
    triangles = tiny_triangles(rng, np.repeat(middles, 30, axis=0) + rng.uniform(-0.1, 0.1, (120, 3)))
    boxes = boxes_around(triangles, np.eye(3), margin=0.05, most=4)
    held = sorted((sorted(box.held.tolist()) for box in boxes), key=min)
    assert held == [list(range(30 * i, 30 * i + 30)) for i in range(4)]
    assert all((box.half_extents < 0.2).all() for box in boxes)


def test_the_first_cut_is_the_best_of_all_planes_across_the_axes():
    rng = np.random.default_rng(1)
    # Longest along x, then y, then z, and nearly so in itself: principal axes are the given ones.
    triangles = tiny_triangles(rng, rng.uniform(-1, 1, (40, 3)) * [4.0, 2.0, 1.0])
    single = boxes_around(triangles, np.eye(3), margin=0.0, most=1)
    two = boxes_around(triangles, np.eye(3), margin=0.0, most=2)
    totals = []
    for axis in range(3):
        order = np.argsort((triangles.min(axis=1) + triangles.max(axis=1))[:, axis])
        for at in range(1, 40):
            sides = (triangles[order[:at]].reshape(-1, 3), triangles[order[at:]].reshape(-1, 3))
            totals.append(sum(float(np.ptp(side, axis=0).prod()) for side in sides))
    assert volume(two) <= min(totals) * (1 + 1e-9)
    assert volume(two) < 0.97 * volume(single)


def test_a_slanted_twig_gets_a_box_along_itself():
    rng = np.random.default_rng(2)
    along = yaw_rotation(0.7) @ np.array([1.0, 0, 0])
    triangles = tiny_triangles(rng, np.linspace(-1, 1, 50)[:, None] * along)
    box = boxes_around(triangles, np.eye(3), margin=0.01, most=1)[0]
    assert sorted(box.half_extents)[:2] == pytest.approx([0.01, 0.01], abs=0.005)
    assert max(box.half_extents) == pytest.approx(1.0, abs=0.02)


def test_what_would_not_get_smaller_stays_one_box():
    grid = np.stack(np.meshgrid(*[np.linspace(0, 1, 8)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    triangles = np.repeat(grid[:, None], 3, axis=1)
    assert len(boxes_around(triangles, np.eye(3), margin=0.2, most=8)) == 1
