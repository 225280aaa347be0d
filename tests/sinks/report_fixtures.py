"""A synthetic run for sinks: a camera circles some boxes on a floor; every box becomes an object."""

import cv2
import numpy as np
import trimesh
from hickory_stream.box_scene import SceneBox, cast_scene
from hickory_stream.geometry.boxes import OrientedBox
from hickory_stream.geometry.camera import Camera, backproject
from hickory_stream.geometry.mesh import Mesh, sha256_of, write_glb
from hickory_stream.geometry.rigid import apply, from_rotation_translation
from hickory_stream.geometry.superquadric import Superquadrics
from hickory_stream.geometry.voxels import centers_of_keys, keys_of_cells, keys_of_points
from hickory_stream.records import (
    Containment,
    Decision,
    Frame,
    FrameReport,
    MapSnapshot,
    ObjectShape,
    Observation,
    ObservedSpace,
    Phase,
    Submap,
    TrackedObject,
    View,
)
from tests.perception.perception_scenes import looking

START_NS = 1_700_000_000_123_456_789
PERIOD_NS = 66_666_667
KEYFRAME_EVERY = 4
SHAPE_FRAME = 12
_COLORS = [
    (196, 86, 60), (70, 130, 190), (120, 170, 80), (205, 170, 70), (150, 100, 170), (90, 170, 165), (180, 180, 175),
]  # fmt: skip


def boxes(count=7):
    """Return upright boxes in a loose ring on the floor z = 0."""
    rng = np.random.default_rng(5)
    found = []
    for i in range(count):
        half = rng.uniform((0.12, 0.1, 0.1), (0.35, 0.25, 0.45))
        angle, radius = 2 * np.pi * i / count, 1.1 + 0.3 * (i % 2)
        center = np.array([radius * np.cos(angle), radius * np.sin(angle), half[2]])
        pose = from_rotation_translation(np.eye(3), center)
        found.append(OrientedBox(world_from_box=pose, half_extents_m=half))
    return found


def reports(num_frames, folder, *, width=320, merge_at=None):
    """Yield a run; from keyframe frame `merge_at` on, object 2 is gone. The meshes are written to `folder`/shapes."""
    run = SyntheticRun(folder, width)
    for index in range(num_frames):
        yield run.report(index, num_frames, is_merged=merge_at is not None and index >= merge_at)


class SyntheticRun:
    """Keeps the objects' clouds between frames."""

    def __init__(self, folder, width):
        self.boxes = boxes()
        ends = [box.corners_world()[[0, -1]] for box in self.boxes]
        self._scene = [SceneBox(low=a, high=b, rgb=rgb) for (a, b), rgb in zip(ends, _COLORS, strict=True)]
        height = width * 9 // 16
        self.camera = Camera(
            width=width, height=height, fx=0.6 * width, fy=0.6 * width, cx=(width - 1) / 2, cy=(height - 1) / 2
        )
        self.points = {}
        self.best = {}
        self.shapes = _write_shapes(self.boxes, folder)

    def report(self, index, num_frames, *, is_merged):
        angle = 2 * np.pi * index / max(num_frames, 60)
        world_from_camera = looking((0.0, 0.0, 0.3), start=(2.9 * np.cos(angle), 2.9 * np.sin(angle), 1.5))
        stamp_ns = START_NS + index * PERIOD_NS
        rgb, depth_m, instances = cast_scene(self._scene, self.camera, world_from_camera)
        depth_m[depth_m > 6.0] = np.nan
        color_bytes = cv2.imencode(".jpg", rgb[..., ::-1])[1].tobytes()
        shared = {
            "index": index, "stamp_ns": stamp_ns, "camera": self.camera, "world_from_camera": world_from_camera,
            "color_bytes": color_bytes,
        }  # fmt: skip
        if index % KEYFRAME_EVERY:
            return FrameReport(keyframe_index=None, **shared)
        frame = Frame(
            index=index, stamp_ns=stamp_ns, rgb=rgb, depth_m=depth_m, camera=self.camera,
            world_from_camera=world_from_camera,
        )  # fmt: skip
        observed = self._observe(frame, instances)
        return FrameReport(
            keyframe_index=index // KEYFRAME_EVERY, frame=frame, observations=tuple(o for _, o in observed),
            object_ids=tuple(i for i, _ in observed),
            decisions=(
                *(Decision(kind="associate", object_id=i, text=f"mask {o.index}: IoU 0.81") for i, o in observed),
                Decision(kind="reject", object_id=None, text="mask (3, 5, 9, 12): 21 pixels, 60 needed"),
            ),
            snapshot=self._snapshot(frame, is_merged),
            metrics=(
                ("time/segment", 0.021 + 0.004 * np.sin(index)), ("time/associate", 0.003),
                ("queue/shapes", float(index % 5)),
                *((f"score/{i}", view.score) for i, view in sorted(self.best.items())),
            ),
            **shared,
        )  # fmt: skip

    def _observe(self, frame, instances):
        points_world = apply(frame.world_from_camera, backproject(frame.depth_m, frame.camera))
        observed = []
        for i, box in enumerate(self.boxes, start=1):
            rows, columns = np.nonzero(instances == i)
            if len(rows) < 60:
                continue
            box_px = (int(columns.min()), int(rows.min()), int(columns.max()) + 1, int(rows.max()) + 1)
            mask = instances[box_px[1] : box_px[3], box_px[0] : box_px[2]] == i
            observation = Observation(
                index=len(observed), box_px=box_px, mask=mask, points_world=points_world[rows, columns],
                colors=frame.rgb[rows, columns], box=box, r_area=mask.sum() / instances.size, r_depth=1.0, is_cut=False,
            )  # fmt: skip
            observed.append((i, observation))
            self._fuse(i, observation, frame)
        return observed

    def _fuse(self, i, observation, frame):
        keys = keys_of_points(observation.points_world, 0.02)
        self.points[i] = np.union1d(self.points.get(i, np.zeros(0, np.int64)), keys)
        score = float(np.log(1.5) * observation.r_area**0.3)
        if i not in self.best or score > self.best[i].score:
            self.best[i] = View(
                object_id=i, frame_index=frame.index, stamp_ns=frame.stamp_ns, box_px=observation.box_px,
                world_from_camera=frame.world_from_camera, r_area=observation.r_area, r_depth=1.0,
                box_volume_m3=observation.box.volume_m3, score=score, variance=0.5, feature=None,
            )  # fmt: skip

    def _snapshot(self, frame, is_merged):
        floor = np.stack(np.meshgrid(np.arange(-2.5, 2.5, 0.05), np.arange(-2.5, 2.5, 0.05)), axis=-1).reshape(-1, 2)
        keys = np.unique(keys_of_points(np.column_stack([floor, np.full(len(floor), 0.01)]), 0.05))
        wall = np.array([(50, y, z) for y in range(-20, 20) for z in range(6, 30)])
        keys, before_it = np.union1d(keys, keys_of_cells(wall)), np.sort(keys_of_cells(wall - (1, 0, 0)))
        space = ObservedSpace(voxel_m=0.05, free=before_it, structure=keys, floor_z_m=0.0)
        return MapSnapshot(
            revision=frame.index,
            stamp_ns=frame.stamp_ns,
            submaps=(Submap(id=0, world_from_submap=np.eye(4), observed_space=space),),
            objects=tuple(self._object(i, frame) for i in sorted(self.points) if not (is_merged and i == 2)),
        )

    def _object(self, i, frame):
        points = centers_of_keys(self.points[i], 0.02)
        return TrackedObject(
            id=i, phase=Phase.TENTATIVE if i == 3 and frame.index < 8 else Phase.DORMANT if i == 5 else Phase.ACTIVE,
            submap_id=0, sightings=1 + frame.index // KEYFRAME_EVERY, first_seen_ns=START_NS,
            last_seen_ns=frame.stamp_ns, points_world=points,
            colors=np.full((len(points), 3), _COLORS[i - 1], np.uint8), box=self.boxes[i - 1], feature=None,
            views=(self.best[i],), best_view=self.best[i], shape=self.shapes[i] if frame.index >= SHAPE_FRAME else None,
        )  # fmt: skip


def _write_shapes(shown, folder):
    (folder / "shapes").mkdir(parents=True, exist_ok=True)
    shapes = {}
    for i, box in enumerate(shown, start=1):
        solid = trimesh.creation.box(2 * box.half_extents_m)
        mesh = Mesh(
            vertices=solid.vertices, faces=solid.faces, colors=np.tile(np.array(_COLORS[i - 1], np.uint8), (8, 1)),
            is_seen=np.ones(8, dtype=bool),
        )  # fmt: skip
        write_glb(mesh, folder / "shapes" / f"{i}.glb")
        shapes[i] = ObjectShape(
            revision=i, reconstructor="fused", mesh_name=f"{i}.glb", mesh_sha256=sha256_of(mesh),
            world_from_object=box.world_from_box, fitted=_two_halves(box, 1.0), inflated=_two_halves(box, 1.15),
            seen_share=np.array([1.0, 0.5]), containment=Containment(num_checked=100, num_outside=0, max_g=0.9),
        )  # fmt: skip
    return shapes


def _two_halves(box, grown):
    """Return the lower and the upper half of a box, slightly rounded."""
    poses = np.stack([box.world_from_box, box.world_from_box])
    quarter = box.half_extents_m[2] / 2
    poses[:, 2, 3] += (-quarter, quarter)
    half = box.half_extents_m * (1, 1, 0.5) * grown
    return Superquadrics(exponents=np.full((2, 2), 0.3), semi_axes_m=np.stack([half, half]), world_from_local=poses)


def bare_report(index=0, **changes):
    """A report of a frame of which no more than its camera is known."""
    camera = Camera(width=40, height=30, fx=30.0, fy=30.0, cx=20.0, cy=15.0)
    known = {"stamp_ns": index, "keyframe_index": None, "world_from_camera": np.eye(4), "color_bytes": None}
    return FrameReport(index=index, camera=camera, **{**known, **changes})
