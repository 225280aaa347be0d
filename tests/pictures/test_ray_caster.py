import importlib.util
import subprocess
import sys
import numpy as np
import pytest
import trimesh
from hickory_stream.errors import InputError
from hickory_stream.pictures.open3d_import import import_open3d
from hickory_stream.pictures.ray_caster import ray_caster
from hickory_stream.pictures.raycast import Scene, Surface


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
