"""Synthetic logs as the image folders of public data sets, with their units, axes and quirks, and their annotations."""
# The numbers and axes are repeated here, so that an error in a reader of `players` cannot cancel itself out.

from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.json_text import dumps
from hickory_stream.evaluation.truth import Truth, instances_of, mesh_of, moved_mesh, structure_meshes
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.rigid import invert, rotation_vector
from hickory_stream.worlds.zed_log import DepthView, encode_jpeg, encode_png

_BOP_SCENE = "test/000001"


class FolderLog:
    """Writes an image folder: images as they come, text files at the end."""

    color, depth, units_per_m = "color/{i}.jpg", "depth/{i}.png", 1000.0

    def __init__(self, folder: Path, camera: Camera, jpeg_quality: int) -> None:
        self._folder, self._camera, self._jpeg_quality = folder, camera, jpeg_quality
        self.depth_view: DepthView | None = None
        self.poses: list[NDArray[np.float64]] = []
        self.stamps_ns: list[int] = []
        self._pose = np.eye(4)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        if error[0] is None:
            self.finish()

    def write_static(self, stamp_ns: int) -> None: ...

    def write_pose(
        self, stamp_ns: int, world_from_camera: NDArray[np.float64], velocity_link: NDArray[np.float64]
    ) -> None:
        self._pose = world_from_camera

    def write_images(self, stamp_ns: int, rgb: NDArray[np.uint8], depth_m: NDArray[np.float32]) -> None:
        names = {"i": len(self.poses), "s": stamp_ns // 1_000_000 / 1000, "n": self._folder.name}
        units = np.nan_to_num(depth_m * self.units_per_m, nan=0.0, posinf=0.0, neginf=0.0).round().astype(np.uint16)
        color = self.color.format(**names)
        data = encode_jpeg(rgb, self._jpeg_quality) if color.endswith("jpg") else encode_png(rgb[..., ::-1])
        for name, content in ((color, data), (self.depth.format(**names), encode_png(units))):
            (self._folder / name).parent.mkdir(parents=True, exist_ok=True)
            (self._folder / name).write_bytes(content)
        self.poses.append(self._pose)
        self.stamps_ns.append(stamp_ns)

    def finish(self) -> None:
        """Write the text files."""

    def text(self, name: str, content: str) -> None:
        (self._folder / name).parent.mkdir(parents=True, exist_ok=True)
        (self._folder / name).write_text(content)

    def smaller_depth(self) -> DepthView:
        """Return the view of the colour camera with half as many pixels on a side."""
        return DepthView(camera=self._camera.scaled(0.5), color_from_depth=np.eye(4), lag_ns=0)


class BopLog(FolderLog):
    """A data set of one scene, whose world is the first camera; lengths are in millimetres, depth in tenths of them."""

    color, depth, units_per_m = f"{_BOP_SCENE}/rgb/{{i:06d}}.png", f"{_BOP_SCENE}/depth/{{i:06d}}.png", 10_000.0

    def finish(self) -> None:
        table = {}
        for i, pose in enumerate(self.poses):
            camera_from_first = invert(pose) @ self.poses[0]
            table[str(i)] = {
                "cam_K": self._camera.K.ravel().tolist(), "depth_scale": 0.1,
                **_in_mm(camera_from_first, "cam_{}_w2c"),
            }  # fmt: skip
        self.text(f"{_BOP_SCENE}/scene_camera.json", dumps(table, indent=1))


class IclNuimLog(FolderLog):
    """Left-handed: the camera's y and the world's second axis are up, fy is negative. The first image has no pose."""

    color, depth, units_per_m = "rgb/{i}.png", "depth/{i}.png", 5000.0

    def finish(self) -> None:
        blocks = []
        for pose in self.poses[1:]:
            rotation, place = pose[:3, :3].copy(), pose[:3, 3]
            rotation[:, 1] *= -1.0
            blocks.append(_rows(np.column_stack([rotation, place])[[0, 2, 1]]))
        self.text("livingRoom0n.gt.sim", "\n".join(blocks))


class ArkitScenesLog(FolderLog):
    """Stamps in seconds are in the names; poses are camera_from_world, with rotations as angle-axis."""

    color, depth = "{n}_frames/lowres_wide/{n}_{s:.3f}.png", "{n}_frames/lowres_depth/{n}_{s:.3f}.png"

    def __init__(self, folder: Path, camera: Camera, jpeg_quality: int) -> None:
        super().__init__(folder, camera, jpeg_quality)
        self._rows: list[str] = []

    def write_pose(
        self, stamp_ns: int, world_from_camera: NDArray[np.float64], velocity_link: NDArray[np.float64]
    ) -> None:
        super().write_pose(stamp_ns, world_from_camera, velocity_link)
        camera_from_world = invert(world_from_camera)
        values = np.array([[*rotation_vector(camera_from_world[:3, :3]), *camera_from_world[:3, 3]]])
        self._rows.append(f"{stamp_ns / 1e9:.6f} {_rows(values)}")

    def finish(self) -> None:
        c, name = self._camera, self._folder.name
        self.text(f"{name}_frames/lowres_wide.traj", "".join(self._rows))
        for stamp_ns in self.stamps_ns:
            pincam = f"{name}_frames/lowres_wide_intrinsics/{name}_{stamp_ns // 1_000_000 / 1000:.3f}.pincam"
            self.text(pincam, f"{c.width} {c.height} {c.fx} {c.fy} {c.cx} {c.cy}")


class Open3dLog(FolderLog):
    """The world is the first camera."""

    color, depth = "color/{i:05d}.jpg", "depth/{i:05d}.png"

    def finish(self) -> None:
        origin = invert(self.poses[0])
        blocks = [f"{i} {i} {i + 1}\n{_rows(origin @ pose)}" for i, pose in enumerate(self.poses)]
        self.text("trajectory.log", "".join(blocks))
        c = self._camera
        matrix = {"width": c.width, "height": c.height, "intrinsic_matrix": c.K.T.ravel().tolist()}
        self.text("camera_intrinsic.json", dumps(matrix))


class NerfstudioLog(FolderLog):
    """Cameras look along -z with y up; depth has fewer pixels; the middle of the first pixel is at 0.5."""

    color, depth = "images/frame_{i:05d}.png", "depth/frame_{i:05d}.png"

    def __init__(self, folder: Path, camera: Camera, jpeg_quality: int) -> None:
        super().__init__(folder, camera, jpeg_quality)
        self.depth_view = self.smaller_depth()

    def finish(self) -> None:
        c, frames = self._camera, []
        for i, pose in enumerate(self.poses):
            paths = {"file_path": self.color.format(i=i), "depth_file_path": self.depth.format(i=i)}
            frames.append({**paths, "transform_matrix": (pose * (1.0, -1.0, -1.0, 1.0)).tolist()})
        calibration = {"w": c.width, "h": c.height, "fl_x": c.fx, "fl_y": c.fy, "cx": c.cx + 0.5, "cy": c.cy + 0.5}
        # The order of frames is arbitrary.
        table = {"camera_model": "OPENCV", **calibration, "k1": 0.0, "frames": frames[::-1]}
        self.text("transforms.json", dumps(table, indent=1))


class ScannetLog(FolderLog):
    """Depth has fewer pixels than colour; the third pose was lost."""

    def __init__(self, folder: Path, camera: Camera, jpeg_quality: int) -> None:
        super().__init__(folder, camera, jpeg_quality)
        self.depth_view = self.smaller_depth()

    def finish(self) -> None:
        assert self.depth_view is not None
        for i, pose in enumerate(self.poses):
            self.text(f"pose/{i}.txt", _rows(np.full((4, 4), -np.inf) if i == 2 else pose, 6))
        for name, camera in (("color", self._camera), ("depth", self.depth_view.camera)):
            k = np.eye(4)
            k[:3, :3] = camera.K
            for part, matrix in (("intrinsic", k), ("extrinsic", np.eye(4))):
                self.text(f"intrinsic/{part}_{name}.txt", _rows(matrix, 6))


FOLDER_LOGS: dict[str, type[FolderLog]] = {
    "bop": BopLog, "icl_nuim": IclNuimLog, "arkit_scenes": ArkitScenesLog, "open3d": Open3dLog,
    "nerfstudio": NerfstudioLog, "scannet": ScannetLog,
}  # fmt: skip


def annotate(layout: str, folder: Path, truth: Truth) -> None:
    """Add the annotations of objects that a layout has to a folder: poses and masks, boxes, or labels of a mesh."""
    if layout == "bop":
        _annotate_bop(folder, truth)
    elif layout == "arkit_scenes":
        _annotate_arkit(folder, truth)
    elif layout == "scannet":
        _annotate_scannet(folder, truth)


def _annotate_bop(folder: Path, truth: Truth) -> None:
    infos = {}
    (folder / "models").mkdir()
    for item in truth.objects:
        mesh = _write_ply(folder / f"models/obj_{item.id:06d}.ply", [mesh_of(truth, item)], 1000.0)
        low, high = mesh.min(axis=0), mesh.max(axis=0)
        infos[str(item.id)] = {
            "diameter": float(np.linalg.norm(high - low)),
            **{f"min_{axis}": float(value) for axis, value in zip("xyz", low, strict=True)},
            **{f"size_{axis}": float(value) for axis, value in zip("xyz", high - low, strict=True)},
        }
    (folder / "models/models_info.json").write_text(dumps(infos, indent=1))
    scene, table = folder / _BOP_SCENE, {}
    (scene / "mask_visib").mkdir()
    for frame in truth.frames:
        instances, shown = instances_of(truth, frame), [o for o in truth.objects if frame.index in o.frames]
        camera_from_world = invert(frame.world_from_camera)
        table[str(frame.index)] = [
            {"obj_id": item.id, **_in_mm(camera_from_world @ item.world_from_object, "cam_{}_m2c")} for item in shown
        ]
        for i, item in enumerate(shown):
            mask = np.where(instances == item.id, 255, 0).astype(np.uint8)
            (scene / f"mask_visib/{frame.index:06d}_{i:06d}.png").write_bytes(encode_png(mask))
    (scene / "scene_gt.json").write_text(dumps(table, indent=1))


def _annotate_arkit(folder: Path, truth: Truth) -> None:
    data = []
    for item in truth.objects:
        box = gravity_aligned_box(moved_mesh(mesh_of(truth, item), item.world_from_object).vertices, 0.005)
        aligned = {
            "centroid": box.center.tolist(), "axesLengths": (2 * box.half_extents_m).tolist(),
            "normalizedAxes": box.world_from_box[:3, :3].T.ravel().tolist(),
        }  # fmt: skip
        segments = {"obbAligned": aligned}
        data.append({"uid": str(item.id), "objectId": item.id, "label": item.kind, "segments": segments})
    file = folder / f"{folder.name}_3dod_annotation.json"
    file.write_text(dumps({"data": data, "skipped": False}, indent=1))


def _annotate_scannet(folder: Path, truth: Truth) -> None:
    items = [(item.kind, moved_mesh(mesh_of(truth, item), item.world_from_object)) for item in truth.objects]
    items += [("wall", mesh) for mesh in structure_meshes(truth)]
    name = "scene0000_00"
    _write_ply(folder / f"{name}_vh_clean_2.ply", [mesh for _, mesh in items], 1.0)
    segments = [10 * i for i, (_, mesh) in enumerate(items) for _ in mesh.vertices]
    (folder / f"{name}_vh_clean_2.0.010000.segs.json").write_text(dumps({"segIndices": segments}))
    groups = [{"id": i, "objectId": i, "segments": [10 * i], "label": kind} for i, (kind, _) in enumerate(items)]
    (folder / f"{name}.aggregation.json").write_text(dumps({"segGroups": groups}))


def _rows(matrix: NDArray[np.float64], digits: int = 9) -> str:
    return "".join(" ".join(f"{value:.{digits}f}" for value in row) + "\n" for row in matrix)


def _in_mm(a_from_b: NDArray[np.float64], names: str) -> dict[str, Any]:
    return {
        names.format("R"): a_from_b[:3, :3].ravel().tolist(), names.format("t"): (1000.0 * a_from_b[:3, 3]).tolist(),
    }  # fmt: skip


def _write_ply(path: Path, meshes: list[Mesh], units_per_m: float) -> NDArray[np.float64]:
    # One mesh of all, with vertex colours; returns the vertices as they were written.
    import trimesh

    firsts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    vertices = np.concatenate([mesh.vertices for mesh in meshes]).astype(np.float64) * units_per_m
    faces = np.concatenate([mesh.faces + first for mesh, first in zip(meshes, firsts, strict=False)])
    shown = trimesh.Trimesh(vertices, faces, vertex_colors=np.concatenate([m.colors for m in meshes]), process=False)
    path.write_bytes(shown.export(file_type="ply"))
    return vertices
