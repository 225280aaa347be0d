import base64
import gzip
import io
import json
import re
import shutil
import subprocess
from dataclasses import replace
import pytest
import trimesh
from hickory_stream.errors import InputError
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.pictures.map_page import map_page


def page_of(saved):
    meshes = trimesh.Scene()
    for item in saved.snapshot.objects:
        if item.shape is not None:
            mesh = saved.mesh(item.shape)
            shown = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=mesh.colors, process=False)
            shown.vertex_attributes["_SEEN"] = mesh.is_seen.astype("f4")
            name = f"object-{item.id}"
            meshes.add_geometry(shown, node_name=name, geom_name=name, transform=item.shape.world_from_object)
    return map_page(saved, meshes).decode()


def element(page, name):
    (content,) = re.findall(f'<script type="[a-z/]+" id="{name}">(.*?)</script>', page, flags=re.DOTALL)
    return str(content)


@pytest.fixture(scope="module")
def page(short_map):
    return page_of(open_map(short_map))


def test_the_page_holds_every_layer_of_every_object(page, short_map):
    content = gzip.decompress(base64.b64decode(element(page, "map")))
    scene = trimesh.load(io.BytesIO(content), file_type="glb")
    expected = {"room"}
    for item in open_map(short_map).snapshot.objects:
        expected |= {f"points-{item.id}"} | ({f"superquadrics-{item.id}"} if item.superquadrics is not None else set())
        expected |= set() if item.shape is None else {f"object-{item.id}", f"inflated-{item.id}"}
    assert set(scene.graph.nodes_geometry) == expected
    assert "_SEEN" in next(mesh for name, mesh in scene.geometry.items() if name.startswith("obj")).vertex_attributes
    objects = json.loads(element(page, "data"))["objects"]
    assert [item["id"] for item in objects] == [item.id for item in open_map(short_map).snapshot.objects]


def test_the_page_loads_nothing_and_keeps_the_licence(page):
    assert not re.search(r"""\b(src|href)\s*=\s*["']?(https?:)?//|@import|\bimport\s*\(""", page)
    assert "Three.js Authors" in page
    assert "{{" not in page.split('<script type="application/json"')[1]


def test_names_from_a_log_cannot_end_an_element(short_map):
    saved = open_map(short_map)
    name = "<script>alert(1)</script>\x1b"
    page = page_of(replace(saved, manifest=replace(saved.manifest, source={"uri": name})))
    assert "<title>script&gt;\\x1b</title>" in page


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node")
def test_the_script_of_the_page_is_valid(page, tmp_path):
    scripts = re.findall(r"<script>(.*?)</script>", page, flags=re.DOTALL)
    assert len(scripts) == 2
    for i, script in enumerate(scripts):
        (tmp_path / f"{i}.js").write_text(script)
        subprocess.run(["node", "--check", tmp_path / f"{i}.js"], check=True)


def test_trimesh_without_three_js_is_named(short_map, monkeypatch):
    monkeypatch.setattr(trimesh.resources, "get_bytes", lambda _: b"")
    with pytest.raises(InputError, match=r"trimesh \d.* brings no three.js"):
        page_of(open_map(short_map))
