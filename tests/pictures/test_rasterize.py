import importlib.util
import subprocess
import sys
import numpy as np
import pytest
import trimesh
from hickory_stream.errors import InputError
from hickory_stream.pictures.open3d_import import import_open3d
from hickory_stream.pictures.rasterize import Dots, first_hits
from hickory_stream.pictures.ray_caster import ray_caster
from hickory_stream.pictures.raycast import Scene, Surface
from hickory_stream.pictures.viewpoint import from_above, from_corner

CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (0.0, 1.0)])
WITHIN = np.array([[0, 0], [0.375, -0.125]], dtype=np.float32)


def surfaces():
    """A ball of random colours within a box, which hides a part of it."""
    ball, box = trimesh.creation.icosphere(subdivisions=3, radius=0.6), trimesh.creation.box((1.2, 0.3, 0.8))
    random = np.random.default_rng(3)
    return [
        Surface(
            vertices=mesh.vertices + np.array([0, 0, 0.5]), faces=mesh.faces,
            colors=random.integers(0, 255, (len(mesh.vertices), 3)).astype(np.uint8), owner=owner,
        )
        for owner, mesh in ((4, ball), (9, box))
    ]  # fmt: skip


@pytest.mark.parametrize(
    "viewpoint", [from_above(CORNERS, 90, 70, 3), from_corner(CORNERS, 0.7, 0.6, 90, 70, 3)], ids=["above", "corner"]
)
def test_what_is_seen_first_is_what_rays_meet_first(viewpoint):
    made = surfaces()
    for hits, within in zip(first_hits(made, [], viewpoint, within_px=WITHIN), WITHIN, strict=True):
        rays = Scene(made).cast(*viewpoint.rays(viewpoint.centers_px() + within))
        assert {-1, 4, 9} == set(np.unique(rays.owners))
        same = hits.owners == rays.owners
        assert same.mean() > 0.999
        met = same & (rays.owners >= 0)
        assert np.allclose(hits.distance_m[met], rays.distance_m[met], atol=1e-4)
        assert np.allclose(hits.colors[met], rays.colors[met], atol=0.01)
        assert ((hits.normals * rays.normals).sum(axis=1)[met] > 0.99).mean() > 0.99


def test_an_image_on_a_surface_shows_where_nothing_hides_it():
    vertices = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    image = np.zeros((4, 4, 3), np.uint8)
    image[:, :2] = (255, 0, 0)
    uv = np.array([[0, 1], [1, 1], [1, 0], [0, 0]])
    floor = Surface(
        vertices=vertices, faces=[[0, 1, 2], [0, 2, 3]], colors=np.zeros((4, 3), np.uint8), owner=1, uv=uv, image=image
    )
    dot = Dots(points=[[-0.5, 0.5, 0.5]], colors=np.uint8([[0, 255, 0]]), half_m=0.2, owner=2)
    (hits,) = first_hits([floor], [dot], from_above(CORNERS, 40, 40, 0))
    colors, owners = hits.colors.reshape(40, 40, 3), hits.owners.reshape(40, 40)
    assert colors[35, 5] == pytest.approx((1, 0, 0))
    assert colors[35, 35] == pytest.approx((0, 0, 0))
    assert colors[10, 10] == pytest.approx((0, 1, 0))
    assert (owners == 2).sum() == 8 * 8
    assert (owners == 1).sum() == 40 * 40 - 8 * 8


def test_far_dots_leave_no_holes_and_many_are_thinned():
    side = np.linspace(-0.9, 0.9, 300, dtype=np.float32)
    x, y = np.meshgrid(side, side, indexing="ij")
    points = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    dots = Dots(points=points, colors=np.zeros((len(points), 3), np.uint8), half_m=0.004, owner=5)
    viewpoint = from_above(CORNERS, 60, 60, 0)
    for step in (1, 3):
        owners = first_hits([], [dots], viewpoint, step_px=step)[0].owners.reshape(60 // step, 60 // step)
        rim = 6 // step
        assert (owners[rim:-rim, rim:-rim] == 5).all()
        assert (owners[0] == -1).all()


def rays_at(center, count):
    rng = np.random.default_rng(3)
    origins = center + 4 * rng.normal(size=(count, 3))
    aims = center + rng.uniform(-1.2, 1.2, (count, 3))
    return np.concatenate([origins, aims - origins], axis=1).astype(np.float32)


def test_both_casters_see_the_same():
    rays = rays_at(np.array([0.5, 0, 0]), 5000)
    found = []
    for name in ("embreex", "open3d"):
        caster = ray_caster(name)
        for mesh in (trimesh.creation.icosphere(3), trimesh.creation.box((0.6, 0.8, 1.0))):
            shift = np.array([1.0, 0, 0]) if len(mesh.faces) == 12 else np.zeros(3)
            caster.add((mesh.vertices + shift).astype(np.float32), mesh.faces.astype(np.int32))
        found.append((caster.cast(rays), caster.is_occluded(rays, 0.8)))
    (one, one_occluded), (other, other_occluded) = found
    is_hit = np.isfinite(one.t)
    assert 0.2 < is_hit.mean() < 0.9
    assert np.array_equal(is_hit, np.isfinite(other.t))
    assert one.t[is_hit] == pytest.approx(other.t[is_hit], abs=1e-5)
    assert np.array_equal(one.geometry[is_hit], other.geometry[is_hit])
    assert set(np.unique(one.geometry[is_hit])) == {0, 1}
    # On an edge either triangle may be named.
    same = is_hit & (one.triangle == other.triangle)
    assert same.sum() > 0.999 * is_hit.sum()
    assert one.uv[same] == pytest.approx(other.uv[same], abs=1e-3)
    assert one.normals[same] == pytest.approx(other.normals[same], abs=1e-4)
    assert (one_occluded == other_occluded).mean() > 0.999
    assert np.array_equal(one_occluded, one.t <= 0.8)


def test_without_open3d_pictures_are_drawn_and_measures_refused(monkeypatch):
    find_spec = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "open3d" else find_spec(name))
    monkeypatch.delitem(sys.modules, "open3d.pybind", raising=False)
    box = trimesh.creation.box((1, 1, 1))
    scene = Scene([Surface(vertices=box.vertices, faces=box.faces, colors=np.zeros((8, 3), np.uint8), owner=4)])
    hits = scene.cast(np.array([[0.1, 0.2, 3.0]]), np.array([[0, 0, -1.0]]))
    assert hits.distance_m == pytest.approx([2.5])
    assert hits.owners.tolist() == [4]
    with pytest.raises(InputError, match="pip install --upgrade hickory-stream"):
        scene.nearest(np.zeros((1, 3)))
    with pytest.raises(InputError, match="Open3D"):
        import_open3d()


def test_measuring_loads_no_viewer_of_open3d():
    # Nor does reading KISS-ICP's name load it.
    program = """
import sys, trimesh
from hickory_stream.cli import main
from hickory_stream.pictures.raycast import Scene, Surface
from hickory_stream.poses import choose
box = trimesh.creation.box((1, 1, 1))
scene = Scene([Surface(vertices=box.vertices, faces=box.faces, colors=0 * box.vertices.astype("u1"), owner=4)])
before = sys.modules.keys() & {"open3d.pybind", "kiss_icp"}
print(scene.nearest([[0, 0, 1]]))
print(*before, *(sys.modules.keys() & {"open3d", "dash", "flask", "plotly", "IPython", "ipywidgets", "kiss_icp"}))
print("open3d.pybind" in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.stderr == ""
    assert done.stdout.splitlines()[1:] == ["", "True"]
