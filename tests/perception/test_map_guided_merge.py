"""What something nearer divides in the image is one mask where the map knows that it is one object."""

from dataclasses import replace

import numpy as np
import pytest
from perception_scenes import Block, floor, looking, render

from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.camera import backproject
from hickory_stream.geometry.rigid import apply
from hickory_stream.perception.map_guided_merge import MapGuidedMergeConfig, merged_by_map
from hickory_stream.records import Phase, Segmentation, TrackedObject

VIEW = looking((0.0, 0.0, 0.3), start=(-2.2, -0.3, 1.5))
LEFT = Block(low=(0.0, 0.15, 0.0), high=(0.3, 0.5, 0.4), color=(190, 40, 40))
RIGHT = Block(low=(0.0, -0.5, 0.0), high=(0.3, -0.15, 0.4), color=(40, 60, 190))
BESIDE = Block(low=(0.0, -0.15, 0.0), high=(0.3, 0.15, 0.4), color=(40, 150, 60))


def scene(*blocks):
    """A frame of blocks on a floor, each a mask of its own, and the points that it shows of each."""
    frame, shown = render([floor(), *blocks], VIEW)
    segmentation = Segmentation(
        instances=np.maximum(shown, 0).astype(np.int32), structure=shown == 0, floor_z_m=0.0, rejected=()
    )
    points = apply(frame.world_from_camera, backproject(frame.depth_m, frame.camera))
    return frame, segmentation, [points[shown == i + 1].astype(np.float32) for i in range(len(blocks))]


def known(points, **changes):
    tracked = TrackedObject(
        id=1,
        phase=Phase.ACTIVE,
        submap_id=0,
        sightings=9,
        first_seen_ns=0,
        last_seen_ns=1,
        points_world=points,
        colors=np.zeros(points.shape, dtype=np.uint8),
        box=gravity_aligned_box(points, 0.01),
        feature=None,
        views=(),
        best_view=None,
        shape=None,
        merged_ids=(),
    )
    return replace(tracked, **changes)


def joined(blocks, *objects):
    frame, segmentation, _ = scene(*blocks)
    return merged_by_map(
        frame, segmentation, objects, MapGuidedMergeConfig(enabled=True)
    ).instances, segmentation.instances


def test_two_masks_apart_on_one_known_object_become_one():
    _, _, points = scene(LEFT, RIGHT)
    instances, before = joined((LEFT, RIGHT), known(np.concatenate(points)))
    assert ((instances == 1) == (before > 0)).all()
    assert instances.max() == 1


def test_two_masks_on_two_known_objects_stay_two():
    _, _, points = scene(LEFT, RIGHT)
    instances, before = joined((LEFT, RIGHT), *(known(p, id=i + 1) for i, p in enumerate(points)))
    assert (instances == before).all()


def test_masks_that_touch_stay_apart_so_that_the_map_can_learn_better():
    _, _, points = scene(LEFT, BESIDE)
    instances, before = joined((LEFT, BESIDE), known(np.concatenate(points)))
    assert (instances == before).all()


@pytest.mark.parametrize("changes", [{"phase": Phase.TENTATIVE}, {"sightings": 2}])
def test_an_object_that_is_hardly_known_joins_nothing(changes):
    _, _, points = scene(LEFT, RIGHT)
    instances, before = joined((LEFT, RIGHT), known(np.concatenate(points), **changes))
    assert (instances == before).all()


def test_without_masks_or_objects_nothing_changes():
    frame, segmentation, points = scene(LEFT, RIGHT)
    assert merged_by_map(frame, segmentation, (), MapGuidedMergeConfig(enabled=True)) is segmentation
    empty = replace(segmentation, instances=np.zeros_like(segmentation.instances))
    assert merged_by_map(frame, empty, (known(points[0]),), MapGuidedMergeConfig(enabled=True)) is empty
