"""Boxes of points, observations and tracks made of them, and a driver that answers the core as the engine does."""

from collections.abc import Mapping
from dataclasses import replace
import numpy as np
from hickory_stream.events import (
    CancelShape,
    ComputeFeatures,
    DropView,
    FeaturesReady,
    FrameObserved,
    KeepView,
    Publish,
    RequestShape,
    ShapeReady,
)
from hickory_stream.geometry.bounds import bounds_of
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.lattice import STEPS_PER_M
from hickory_stream.geometry.rigid import from_rotation_translation, yaw_rotation
from hickory_stream.geometry.voxels import sorted_unique
from hickory_stream.mapping.entities.cloud import cloud_of
from hickory_stream.mapping.entities.observed_space import empty_space
from hickory_stream.mapping.entities.track import Track
from hickory_stream.mapping.rules.support_graph import SupportGraph
from hickory_stream.records import Containment, MaskFeature, ObjectShape, Observation, Phase, SpaceObservation, View
from tests.strategies import quadric

VOXEL_M = 0.02
SECOND_NS = 1_000_000_000


def box_surface(center, size=(0.2, 0.2, 0.2), yaw_rad=0.0):
    """(N, 3) points on the surface of an upright box, on a grid finer than the voxels."""
    axes = [np.linspace(-s / 2, s / 2, max(2, int(np.ceil(s / (0.7 * VOXEL_M))))) for s in size]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    half = np.array(size) / 2
    shell = grid[(np.abs(np.abs(grid) - half) < 1e-9).any(axis=1)]
    points = (shell @ yaw_rotation(yaw_rad).T + center).astype(np.float32)
    # At steps, as the mapping has points, and in the cells where they are: faces lie on the border of two.
    return (np.ceil(points * np.float32(STEPS_PER_M)) / np.float32(STEPS_PER_M)).astype(np.float32)


def observation(index, points, *, box_px=None, r_area=0.05, r_depth=0.9, color=(120, 90, 60)):
    """An observation of these points; no two of a frame have the same `box_px` unless it is given."""
    box_px = box_px or (20 * index, 5, 20 * index + 16, 17)
    return Observation(
        index=index, box_px=box_px, mask=np.ones((box_px[3] - box_px[1], box_px[2] - box_px[0]), dtype=bool),
        points_world=points, colors=np.tile(np.uint8(color), (len(points), 1)),
        box=gravity_aligned_box(points, VOXEL_M), r_area=r_area, r_depth=r_depth, is_cut=False,
    )  # fmt: skip


def track(track_id, points, *, sightings=3, phase=Phase.ACTIVE):
    """A track that was seen at these points, each in every one of its keyframes, one per second; last at clock 0."""
    cloud = cloud_of(points, np.full((len(points), 3), 100, dtype=np.uint8), VOXEL_M)
    cloud = replace(cloud, hits=cloud.hits * sightings)
    return Track(
        id=track_id, phase=phase, sightings=sightings, first_seen_ns=0, last_seen_ns=0, seen_clock_ns=0, cloud=cloud,
        solid=cloud, box=gravity_aligned_box(points, VOXEL_M), bounds=bounds_of(points),
        observed_ns=(sightings - 1) * SECOND_NS,
    )  # fmt: skip


def graph_of(tracks, space=None, *, floor_z_m=None):
    """The support graph of tracks, in a room where nothing was seen but a floor, unless another one is given."""
    bodies = tracks if isinstance(tracks, Mapping) else {item.id: item for item in tracks}
    room = replace(empty_space(0.05), floor_z_m=floor_z_m) if space is None else space
    return SupportGraph(bodies=bodies, space=room)


def view(frame_index, *, score=None, r_area=0.05, r_depth=0.9):
    return View(
        object_id=1, frame_index=frame_index, stamp_ns=frame_index * SECOND_NS, box_px=(0, 0, 16, 12),
        world_from_camera=np.eye(4), r_area=r_area, r_depth=r_depth, box_volume_m3=0.01, score=score, variance=None,
        feature=None,
    )  # fmt: skip


def camera_at(angle_rad, distance_m=3.0):
    """world_from_camera of a camera on a circle around the origin; only its place matters to the core."""
    return from_rotation_translation(np.eye(3), distance_m * np.array([np.cos(angle_rad), np.sin(angle_rad), 0.4]))


def space(free=None, structure=None, floor_z_m=None, surface=None):
    none = np.zeros(0, dtype=np.int64)
    return SpaceObservation(
        free_keys=none if free is None else sorted_unique(free),
        structure_keys=none if structure is None else sorted_unique(structure),
        surface_keys=none if surface is None else sorted_unique(surface),
        floor_z_m=floor_z_m,
    )


def keyframe(frame_index, observations, *, stamp_ns=None, seen=None, angle_rad=0.0):
    """A keyframe, by default one per second."""
    return FrameObserved(
        frame_index=frame_index, stamp_ns=frame_index * SECOND_NS if stamp_ns is None else stamp_ns,
        world_from_camera=camera_at(angle_rad), observations=tuple(observations), space=seen or space(),
    )  # fmt: skip


def feature(index, variance):
    pooled = np.zeros(4, dtype=np.float32)
    pooled[index % 4] = 1.0
    return MaskFeature(observation_index=index, variance=variance, pooled=pooled)


def shape(ticket):
    unit = quadric((1.0, 1.0), (1.0, 1.0, 1.0))
    return ObjectShape(
        revision=ticket, reconstructor="fused", mesh_name=f"{ticket:06d}.glb", mesh_sha256="0" * 64,
        world_from_object=np.eye(4), fitted=unit, inflated=unit, seen_share=np.ones(1),
        containment=Containment(num_checked=10, num_outside=0, max_g=0.9),
    )  # fmt: skip


def shape_ready(ticket, object_id):
    return ShapeReady(ticket=ticket, object_id=object_id, stamp_ns=0, shape=shape(ticket))


def drive(core, events, variance_of=lambda frame, index: 0.5):
    """Hand events to a core, answer every `ComputeFeatures` at once, and return all effects."""
    effects = []
    for event in events:
        effects += core.handle(event)
        if effects and isinstance(effects[-1], ComputeFeatures):
            asked = effects[-1]
            features = tuple(feature(i, variance_of(asked.frame_index, i)) for i in asked.observation_indices)
            effects += core.handle(FeaturesReady(frame_index=asked.frame_index, features=features))
    return effects


def told(effects):
    """Effects as short tuples, to be compared as a list."""
    short = []
    for effect in effects:
        match effect:
            case ComputeFeatures():
                short.append(("features", effect.frame_index, effect.observation_indices))
            case KeepView():
                short.append(("keep", effect.view.object_id, effect.view.frame_index))
            case DropView():
                short.append(("drop", int(effect.name.split("-")[0])))
            case RequestShape():
                short.append(("request", effect.ticket, effect.object_id))
            case CancelShape():
                short.append(("cancel", effect.ticket))
            case Publish():
                short.append(("publish", tuple((o.id, str(o.phase)) for o in effect.snapshot.objects)))
    return short
