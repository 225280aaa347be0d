import numpy as np
from hickory_stream.events import ComputeFeatures, FeaturesReady, FrameObserved, Publish, RequestShape, ShapeFailed
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.geometry.voxels import centers_of_keys
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.core import MapperCore
from hickory_stream.perception.descriptor import ColorTextureDescriptor
from hickory_stream.perception.geometric_segmenter import GeometricConfig, GeometricSegmenter
from hickory_stream.perception.perceive import PerceptionConfig, features_of, perceive
from hickory_stream.perception.space import SpaceConfig
from hickory_stream.records import Frame, Phase
from tests.perception.perception_scenes import Block, Cylinder, floor, looking, render

BOX = Block(low=(0.1, 0.3, 0.0), high=(0.5, 0.8, 0.45), color=(170, 130, 80))
WALL = Block(low=(1.6, -9.0, 0.0), high=(1.8, 9.0, 2.6), color=(225, 225, 220))
PERIOD_S = 0.3
SMALL = Camera(width=240, height=180, fx=217.0, fy=217.0, cx=119.5, cy=89.5)


def person_at(x, y):
    return [
        Cylinder(foot=(x, y, 0.0), radius=0.25, height=1.4, color=(60, 60, 150)),
        Cylinder(foot=(x, y, 1.4), radius=0.1, height=0.3, color=(200, 160, 130)),
    ]


def played(steps):
    """The maps after keyframes in which a person is at each of the places, None for nowhere."""
    core, config = MapperCore(MappingConfig()), PerceptionConfig(space=SpaceConfig(stride_px=2))
    segmenter, extractor = GeometricSegmenter(GeometricConfig()), ColorTextureDescriptor()
    snapshot, snapshots = None, []
    for i, place in enumerate(steps):
        view = looking((0.4, 0.0, 0.6), start=(-2.4, -0.3 + 0.02 * (i % 10), 1.5))
        shot, _ = render([floor(), WALL, BOX, *(person_at(*place) if place else ())], view, SMALL)
        noise = np.random.default_rng(i).normal(0.0, 0.0015, shot.depth_m.shape) * shot.depth_m**2
        frame = Frame(
            index=i, stamp_ns=int(i * PERIOD_S * 1e9), rgb=shot.rgb, depth_m=(shot.depth_m + noise).astype(np.float32),
            camera=shot.camera, world_from_camera=view,
        )  # fmt: skip
        seen = perceive(frame, core.prior(), None, segmenter, config, lattice=Lattice())
        waiting = core.handle(
            FrameObserved(
                frame_index=i,
                stamp_ns=frame.stamp_ns,
                world_from_camera=view,
                observations=seen.observations,
                space=seen.space,
            )
        )
        for effect in waiting:
            if isinstance(effect, ComputeFeatures):
                features, _ = features_of(frame, seen.observations, effect.observation_indices, extractor)
                waiting += core.handle(FeaturesReady(frame_index=i, features=features))
            elif isinstance(effect, RequestShape):
                waiting += core.handle(
                    ShapeFailed(
                        ticket=effect.ticket, object_id=effect.object_id, stamp_ns=frame.stamp_ns, reason="none here"
                    )
                )
            elif isinstance(effect, Publish):
                snapshot = effect.snapshot
        snapshots.append(snapshot)
    return snapshots


def objects_near(snapshot, x, y):
    return [
        tracked
        for tracked in snapshot.objects
        if tracked.phase is not Phase.TENTATIVE and np.linalg.norm(tracked.box.center[:2] - (x, y)) < 0.35
    ]


def structure_near(snapshot, x, y):
    space = snapshot.submaps[0].observed_space
    centers = centers_of_keys(space.structure, space.voxel_m)
    at_place = (np.linalg.norm(centers[:, :2] - (x, y), axis=1) < 0.4) & (centers[:, 2] > 0.2)
    return int(at_place.sum())


def test_a_person_is_forgotten_once_the_place_is_seen_through():
    maps = played([(0.0, -0.6)] * 6 + [None] * 7)
    # Who stands is, from one side, an upright slab from the floor to above one's waist: taken for a piece of wall.
    assert objects_near(maps[5], 0.0, -0.6) or structure_near(maps[5], 0.0, -0.6) > 20
    after = maps[-1]
    assert not objects_near(after, 0.0, -0.6)
    assert structure_near(after, 0.0, -0.6) == 0
    assert len(objects_near(after, 0.3, 0.55)) == 1, "the box stays"


def test_a_person_who_walks_through_leaves_nothing_behind():
    after = played([None, *[(0.0, y) for y in np.arange(-1.2, 0.2, 0.15)], *[None] * 6])[-1]
    assert len([tracked for tracked in after.objects if tracked.phase is not Phase.TENTATIVE]) == 1
    assert len(objects_near(after, 0.3, 0.55)) == 1
