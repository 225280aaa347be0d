"""A map for physics simulators: MJCF for MuJoCo, URDF for the rest, each a folder of one XML file and meshes.

Layer 2 is the visual geometry. Layer 4 is the collision geometry: one circumscribed convex mesh for each primitive,
since neither format has superquadrics. All bodies are static.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree
from xml.etree.ElementTree import SubElement

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.confined import plain_name
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.rigid import invert, quaternion_from_rotation
from hickory_stream.geometry.superquadric import Superquadrics, moved, support
from hickory_stream.geometry.superquadric_surface import display_mesh
from hickory_stream.textures.textured_mesh import TexturedMesh, png_bytes

_FLOOR_HALF_M = 50.0
_WALL_RGBA = "0.84 0.86 0.89 1"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SimulatedObject:
    """One object: its mesh in its own frame, its pose, its layer 4 in the world; `texture` replaces the mesh's colours.

    Raises:
        ValueError: the name has characters that are not allowed in file names.
    """

    name: str
    mesh: Mesh | None
    world_from_object: NDArray[np.float64]
    inflated: Superquadrics
    texture: TexturedMesh | None = None

    def __post_init__(self) -> None:
        plain_name(self.name)


def mjcf_files(
    objects: Sequence[SimulatedObject], walls: NDArray[np.float64], floor_z_m: float, model: str
) -> dict[str, bytes]:
    """Return the files of an MJCF model by name, `scene.xml` and meshes; `walls` (N, 8, 3) are corners of boxes."""
    files: dict[str, bytes] = {}
    root = ElementTree.Element("mujoco", model=model)
    SubElement(root, "compiler", angle="radian", meshdir="meshes", texturedir="meshes")
    asset = SubElement(root, "asset")
    world = SubElement(root, "worldbody")
    SubElement(world, "light", pos=f"0 0 {floor_z_m + 6:g}", dir="0 0 -1", directional="true")
    SubElement(
        world,
        "geom",
        name="floor",
        type="plane",
        pos=f"0 0 {floor_z_m:g}",
        size=f"{_FLOOR_HALF_M:g} {_FLOOR_HALF_M:g} 1",
    )
    for i, (center, half, quaternion) in enumerate(_boxes(walls)):
        place = {"pos": _numbers(center), "quat": _numbers(quaternion), "size": _numbers(half)}
        SubElement(world, "geom", {"name": f"wall-{i}", "type": "box", "rgba": _WALL_RGBA, **place})
    for item in objects:
        quaternion = _wxyz(item.world_from_object)
        body = SubElement(
            world, "body", name=item.name, pos=_numbers(item.world_from_object[:3, 3]), quat=_numbers(quaternion)
        )
        if item.mesh is not None:
            files |= _seen_files(item, item.mesh)
            SubElement(asset, "mesh", name=item.name, file=f"{item.name}.obj", inertia="shell")
            seen = {"type": "mesh", "mesh": item.name}
            if item.texture is None:
                seen["rgba"] = _numbers(np.append(item.mesh.colors.mean(axis=0) / 255, 1.0))
            else:
                seen["material"] = item.name
                SubElement(asset, "texture", type="2d", name=item.name, file=f"{item.name}.png")
                SubElement(asset, "material", name=item.name, texture=item.name)
            SubElement(body, "geom", {**seen, "contype": "0", "conaffinity": "0", "group": "1"})
        for i, (vertices, _) in enumerate(_around(item)):
            name = f"{item.name}-{i}"
            SubElement(asset, "mesh", name=name, vertex=_numbers(vertices.ravel()), inertia="convex")
            touched = {"name": name, "type": "mesh", "mesh": name, "rgba": "0.3 0.6 0.9 0.25", "group": "3"}
            SubElement(body, "geom", touched)
    files["scene.xml"] = _xml(root)
    return files


def urdf_files(
    objects: Sequence[SimulatedObject], walls: NDArray[np.float64], floor_z_m: float, model: str
) -> dict[str, bytes]:
    """Return the files of a URDF model by name, `scene.urdf` and meshes: links fixed to the link `world`."""
    files: dict[str, bytes] = {}
    root = ElementTree.Element("robot", name=model)
    world = SubElement(root, "link", name="world")
    floor = SubElement(world, "collision", name="floor")
    SubElement(floor, "origin", xyz=f"0 0 {floor_z_m - 0.05:g}", rpy="0 0 0")
    size = f"{2 * _FLOOR_HALF_M:g} {2 * _FLOOR_HALF_M:g} 0.1"
    SubElement(SubElement(floor, "geometry"), "box", size=size)
    for i, (center, half, quaternion) in enumerate(_boxes(walls)):
        for kind in ("visual", "collision"):
            wall = SubElement(world, kind, name=f"wall-{i}")
            SubElement(wall, "origin", xyz=_numbers(center), rpy=_numbers(_rpy(quaternion)))
            SubElement(SubElement(wall, "geometry"), "box", size=_numbers(2 * half))
    for item in objects:
        link = SubElement(root, "link", name=item.name)
        if item.mesh is not None:
            files |= _seen_files(item, item.mesh)
            _mesh_of(link, "visual", f"meshes/{item.name}.obj", item.name)
        for i, (vertices, faces) in enumerate(_around(item)):
            name = f"{item.name}-{i}"
            files[f"meshes/{name}.obj"] = _obj(vertices, faces)
            _mesh_of(link, "collision", f"meshes/{name}.obj", name)
        joint = SubElement(root, "joint", name=f"world-{item.name}", type="fixed")
        SubElement(joint, "parent", link="world")
        SubElement(joint, "child", link=item.name)
        place = {"xyz": _numbers(item.world_from_object[:3, 3]), "rpy": _numbers(_rpy(_wxyz(item.world_from_object)))}
        SubElement(joint, "origin", place)
    files["scene.urdf"] = _xml(root)
    return files


def _around(item: SimulatedObject) -> list[tuple[NDArray[np.float64], NDArray[np.int32]]]:
    # A convex polyhedron around each primitive, in the object's frame.
    local = moved(item.inflated, invert(item.world_from_object))
    return [polyhedron_around(local, i) for i in range(len(local))]


def polyhedron_around(primitives: Superquadrics, index: int) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return vertices (V, 3) and faces (F, 3) of a convex polyhedron slightly larger than a primitive.

    Its vertices on the surface are scaled about the centre until its faces lie outside.
    """
    from scipy.spatial import ConvexHull

    vertices, _ = display_mesh(primitives, index)
    center = primitives.world_from_local[index, :3, 3]
    offsets = vertices.astype(np.float64) - center
    hull = ConvexHull(offsets)
    normals, distances = hull.equations[:, :3], -hull.equations[:, 3]
    reach = support(primitives, index, normals) - normals @ center
    grown = offsets * float(np.max(reach / distances)) * (1 + 1e-6)
    kept = np.unique(hull.simplices)
    number = np.full(len(vertices), -1, np.int32)
    number[kept] = np.arange(len(kept), dtype=np.int32)
    faces = number[hull.simplices]
    a, b, c = (grown[hull.simplices[:, i]] for i in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), normals) < 0
    faces[inwards] = faces[inwards][:, ::-1]
    return grown[kept] + center, faces


def _boxes(hulls: NDArray[np.float64]) -> list[tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]]:
    # Centre, half extents, quaternion (w first); corners in the order of `box_corners`.
    out = []
    for corners in hulls:
        edges = corners[[1, 2, 4]] - corners[0]
        lengths = np.linalg.norm(edges, axis=1)
        pose = np.eye(4)
        pose[:3, :3] = (edges / lengths[:, None]).T
        out.append((corners.mean(axis=0), lengths / 2, _wxyz(pose)))
    return out


def _wxyz(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y, z, w = quaternion_from_rotation(pose[:3, :3])
    return np.array([w, x, y, z])


def _rpy(wxyz: NDArray[np.float64]) -> NDArray[np.float64]:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(wxyz[[1, 2, 3, 0]]).as_euler("xyz"))


def _mesh_of(link: ElementTree.Element, kind: str, path: str, name: str) -> None:
    element = SubElement(link, kind, name=name)
    SubElement(SubElement(element, "geometry"), "mesh", filename=path)


def _obj(vertices: NDArray[np.float64] | NDArray[np.float32], faces: NDArray[np.int32]) -> bytes:
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    return ("\n".join(lines) + "\n").encode()


def _seen_files(item: SimulatedObject, mesh: Mesh) -> dict[str, bytes]:
    if item.texture is None:
        return {f"meshes/{item.name}.obj": _obj(mesh.vertices, mesh.faces)}
    textured = item.texture
    lines = [f"mtllib {item.name}.mtl", f"usemtl {item.name}"]
    lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in textured.mesh.vertices.tolist()]
    # Its v goes up.
    lines += [f"vt {u:.6f} {1 - v:.6f}" for u, v in textured.uv.tolist()]
    lines += [f"f {a}/{a} {b}/{b} {c}/{c}" for a, b, c in (textured.mesh.faces + 1).tolist()]
    material = f"newmtl {item.name}\nKd 1 1 1\nmap_Kd {item.name}.png\n"
    return {
        f"meshes/{item.name}.obj": ("\n".join(lines) + "\n").encode(),
        f"meshes/{item.name}.mtl": material.encode(),
        f"meshes/{item.name}.png": png_bytes(textured),
    }


def _numbers(values: NDArray[np.float64]) -> str:
    return " ".join(f"{value:.9g}" for value in np.asarray(values).tolist())


def _xml(root: ElementTree.Element) -> bytes:
    ElementTree.indent(root)
    return b'<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(root) + b"\n"
