from dataclasses import replace
from xml.etree import ElementTree
import cv2
import numpy as np
import pytest
import trimesh
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.superquadric import support
from hickory_stream.geometry.superquadric_surface import display_mesh
from hickory_stream.navigation.nav2 import pgm_of, yaml_of
from hickory_stream.navigation.observed import Band
from hickory_stream.navigation.occupancy import Cell, frame_around
from hickory_stream.navigation.simulators import SimulatedObject, mjcf_files, polyhedron_around, urdf_files
from hickory_stream.navigation.walls import wall_boxes
from hickory_stream.textures.textured_mesh import TexturedMesh
from tests.engine.snapshot_fixtures import box_mesh, placed
from tests.navigation.rooms import boxes, snapshot, table
from tests.navigation.test_clearance import random_primitives


def test_a_grid_is_read_back_by_the_rules_of_map_server(tmp_path):
    frame = frame_around(np.array([-1.0, 0.5]), np.array([0.5, 1.5]), 0.25)
    states = np.random.default_rng(0).choice([-1, 0, 100], frame.shape).astype(np.int8)
    (tmp_path / "grid.pgm").write_bytes(pgm_of(states))
    (tmp_path / "grid.yaml").write_text(yaml_of(frame, "grid.pgm"))
    served = dict(line.split(": ", 1) for line in (tmp_path / "grid.yaml").read_text().splitlines())
    grey = cv2.imread(str(tmp_path / served["image"]), cv2.IMREAD_GRAYSCALE)[::-1]
    chance = (255.0 - grey) / 255.0
    is_occupied, is_free = chance > float(served["occupied_thresh"]), chance < float(served["free_thresh"])
    assert np.array_equal(np.select([is_occupied, is_free], [100, 0], -1), states)
    assert (served["mode"], served["negate"], served["resolution"], served["origin"]) == (
        "trinary",
        "0",
        "0.25",
        "[-1.0, 0.5, 0.0]",
    )
    # The thresholds by hand: 254 -> 0.004 free, 205 -> 0.19608 neither, 0 -> 1 occupied; row 0 is the far end of y.
    data = (tmp_path / "grid.pgm").read_bytes()
    assert data.startswith(b"P5\n6 4\n255\n")
    greys = {Cell.FREE: 254, Cell.UNKNOWN: 205, Cell.OCCUPIED: 0}
    assert data[-1] == greys[Cell(int(states[0, -1]))]
    assert data[len(b"P5\n6 4\n255\n")] == greys[Cell(int(states[-1, 0]))]


@pytest.mark.parametrize("seed", range(4))
def test_a_primitives_polyhedron_is_closed_and_holds_it(seed):
    primitives = random_primitives(np.random.default_rng(seed), 6)
    for i in range(len(primitives)):
        vertices, faces = polyhedron_around(primitives, i)
        solid = trimesh.Trimesh(vertices, faces, process=False)
        assert solid.is_watertight
        assert solid.volume > 0
        # Convex: behind each of its faces, and so behind all of them.
        heights = np.einsum("ij,ij->i", solid.face_normals, solid.triangles[:, 0])
        assert (support(primitives, i, solid.face_normals) <= heights + 1e-9).all()
        inner = trimesh.Trimesh(*display_mesh(primitives, i), process=False)
        assert solid.volume < 2.2 * inner.volume


def scene():
    objects = [
        SimulatedObject(
            name="table", mesh=box_mesh((1.2, 0.8, 0.7), (90, 60, 30)), world_from_object=placed(1.5, 2.0, 0.35),
            inflated=table(),
        ),
        SimulatedObject(
            name="crate", mesh=None, world_from_object=placed(4.5, 1.0, 0.3),
            inflated=boxes(((4.5, 1.0, 0.3), (0.4, 0.3, 0.3))),
        ),
    ]  # fmt: skip
    return objects, wall_boxes(snapshot().submaps[:1], Band(low_m=0.0, high_m=2.0), 0.0)


def write(files, folder):
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)


def test_mujoco_opens_the_mjcf_and_a_ball_rests_on_the_table(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    objects, walls = scene()
    write(mjcf_files(objects, walls, 0.0, "room"), tmp_path)
    text = (tmp_path / "scene.xml").read_text()
    ball = '<body pos="1.5 2 1.0"><freejoint/><geom type="sphere" size="0.05" mass="0.1" condim="6"/></body>'
    (tmp_path / "with-ball.xml").write_text(text.replace("</worldbody>", f"{ball}</worldbody>"))
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "with-ball.xml"))
    data = mujoco.MjData(model)
    for _ in range(1000):
        mujoco.mj_step(model, data)
    # On the top, which ends at 0.71 m; the polyhedron around it is a little thicker.
    assert 0.755 <= data.qpos[2] <= 0.775
    assert model.ngeom == 1 + len(walls) + 1 + 5 + 1 + 1
    at = mujoco.MjData(model)
    mujoco.mj_forward(model, at)
    names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, i) for i in range(model.ngeom)]
    assert at.geom_xpos[names.index("crate-0")] == pytest.approx([4.5, 1.0, 0.3], abs=1e-6)
    assert at.geom_xpos[names.index("table-0")] == pytest.approx([1.5, 2.0, 0.7], abs=1e-6)


def test_mujoco_has_the_texture_of_an_object_the_right_way_round(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    objects, walls = scene()
    mesh = objects[0].mesh
    low, size = mesh.vertices.min(axis=0), np.ptp(mesh.vertices, axis=0)
    # The picture as on the front of the table: left red, right blue, the lower half darker.
    right, height = ((mesh.vertices - low) / size)[:, [0, 2]].T
    image = np.zeros((8, 8, 3), np.uint8)
    image[:, :4], image[:, 4:] = (200, 0, 0), (0, 0, 200)
    image[4:] //= 2
    uv = np.column_stack([0.05 + 0.9 * right, 0.95 - 0.9 * height])
    textured = TexturedMesh(mesh=mesh, uv=uv, image=image, source=np.arange(len(uv)))
    write(mjcf_files([replace(objects[0], texture=textured)], walls, 0.0, "room"), tmp_path)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "scene.xml"))
    seen = next(i for i in range(model.ngeom) if model.geom_matid[i] >= 0)
    data = model.geom_dataid[seen]
    first = model.mesh_texcoordadr[data]
    found = model.mesh_texcoord[first : first + model.mesh_texcoordnum[data]]
    assert sorted(map(tuple, found.round(4))) == sorted(map(tuple, uv.round(4)))
    assert (model.tex_width[0], model.tex_height[0], model.tex_nchannel[0]) == (8, 8, 3)
    assert (model.tex_data[: image.size].reshape(image.shape) == image).all()


def test_the_urdf_has_a_link_for_each_object_at_its_place(tmp_path):
    objects, walls = scene()
    write(urdf_files(objects, walls, 0.0, "room"), tmp_path)
    root = ElementTree.parse(tmp_path / "scene.urdf").getroot()
    assert [link.get("name") for link in root.findall("link")] == ["world", "table", "crate"]
    assert len(root.findall("link/collision")) == 1 + len(walls) + 5 + 1
    joints = {joint.find("child").get("link"): joint for joint in root.findall("joint")}
    for item in objects:
        place = np.array(joints[item.name].find("origin").get("xyz").split(), dtype=float)
        assert place == pytest.approx(item.world_from_object[:3, 3])
        parts = [
            trimesh.load(tmp_path / mesh.get("filename"))
            for mesh in root.findall(f"link[@name='{item.name}']/collision/geometry/mesh")
        ]
        assert len(parts) == len(item.inflated)
        for i, part in enumerate(parts):
            low, high = apply(item.world_from_object, np.asarray(part.bounds))
            assert low == pytest.approx(
                item.inflated.world_from_local[i, :3, 3] - item.inflated.semi_axes_m[i], abs=0.06
            )
            assert high == pytest.approx(
                item.inflated.world_from_local[i, :3, 3] + item.inflated.semi_axes_m[i], abs=0.06
            )
