from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.core import MapperCore
from hickory_stream.mapping.entities.cloud import cloud_of
from hickory_stream.mapping.rules.association import AssociateConfig, is_oversized
from hickory_stream.mapping.rules.splitting import TrackSplitConfig, reassigned, with_keyframe
from tests.mapping.mapping_fixtures import SECOND_NS, VOXEL_M, box_surface, drive, keyframe, observation, track

CONFIG = TrackSplitConfig()
PASSED_NS = SECOND_NS // 2
DRESSER = box_surface((0.0, 0.0, 0.4), (0.8, 0.4, 0.8))
SET = box_surface((0.0, 0.0, 1.0), (0.5, 0.2, 0.36))


def cloud(points):
    return cloud_of(points, np.full((len(points), 3), 100, dtype=np.uint8), VOXEL_M)


def test_a_part_that_is_seen_apart_often_is_an_object():
    parts = {}
    for frame in range(3):
        assert not any(part.is_object(CONFIG) for part in parts.get(1, ()))
        parts = with_keyframe(parts, frame, PASSED_NS, [(1, cloud(SET))], [(1, cloud(DRESSER))])
    assert [part.is_object(CONFIG) for part in parts[1]] == [True]


def test_being_seen_as_one_counts_against_it():
    parts = {}
    both = cloud(np.concatenate([DRESSER, SET]))
    for frame in range(6):
        parts = with_keyframe(parts, 2 * frame, PASSED_NS, [(1, cloud(SET))], [])
        parts = with_keyframe(parts, 2 * frame + 1, PASSED_NS, [], [(1, both)])
    (part,) = parts[1]
    assert (part.sightings, part.apart_ns, part.together_ns) == (6, 6 * PASSED_NS, 6 * PASSED_NS)
    assert not part.is_object(CONFIG)


def test_parts_are_told_by_place_and_go_where_their_host_goes():
    parts = with_keyframe({}, 0, PASSED_NS, [(1, cloud(SET))], [])
    parts = with_keyframe(parts, 1, PASSED_NS, [], [(1, cloud(SET))])
    assert [(part.frame_index, part.sightings, part.together_ns) for part in parts[1]] == [(0, 1, 0)]
    parts = with_keyframe({}, 0, PASSED_NS, [(1, cloud(SET)), (1, cloud(SET + np.float32([0, 0.6, 0])))], [])
    assert [part.sightings for part in parts[1]] == [1, 1]
    parts = with_keyframe({}, 0, PASSED_NS, [(2, cloud(SET))], [])
    assert list(reassigned(parts, 1, 2)) == [1]


def test_the_core_promotes_what_an_early_view_swallowed():
    core = MapperCore(MappingConfig(voxels=Lattice(object_m=VOXEL_M)))
    both = np.concatenate([DRESSER, SET])
    frames = [keyframe(i, [observation(0, both)]) for i in range(3)]
    frames += [keyframe(i, [observation(0, DRESSER), observation(1, SET)]) for i in range(3, 14)]
    drive(core, frames)
    boxes = [2 * tracked.box.half_extents_m for tracked in core.snapshot().objects]
    assert len(boxes) == 2
    assert sorted(float(size[2]) for size in boxes) == pytest.approx([0.36, 0.8], abs=0.06)


def test_the_core_keeps_as_one_what_is_seen_as_one():
    core = MapperCore(MappingConfig(voxels=Lattice(object_m=VOXEL_M)))
    both = np.concatenate([DRESSER, SET])
    for i in range(12):
        seen = [observation(0, both)] if i % 2 == 0 else [observation(0, DRESSER), observation(1, SET)]
        drive(core, [keyframe(i, seen, stamp_ns=i * PASSED_NS)])
    assert len(core.snapshot().objects) == 1


def test_the_core_promotes_the_rest_of_a_split_track():
    core = MapperCore(MappingConfig(voxels=Lattice(object_m=VOXEL_M)))
    table = box_surface((0.0, 0.0, 0.7), (1.2, 0.8, 0.04))
    tray, mug = box_surface((0.3, 0.1, 0.75), (0.4, 0.3, 0.06)), box_surface((0.3, 0.1, 0.84), (0.1, 0.1, 0.12))
    early = [observation(0, table), observation(1, np.concatenate([tray, mug]))]
    later = [observation(0, np.concatenate([table, tray])), observation(1, mug)]
    drive(core, [keyframe(i, early) for i in range(4)] + [keyframe(i, later) for i in range(4, 9)])
    heights = sorted(float(2 * tracked.box.half_extents_m[2]) for tracked in core.snapshot().objects)
    # The tray, of which most lies near the table, is the table's.
    assert heights == pytest.approx([0.1, 0.12], abs=0.015)


def test_one_observation_does_not_double_a_settled_track():
    config = AssociateConfig()
    mug = track(1, box_surface((0.0, 0.0, 0.05), (0.1, 0.1, 0.1)), sightings=8)
    with_bowl = observation(0, box_surface((0.1, 0.0, 0.06), (0.32, 0.2, 0.12)))
    assert is_oversized(with_bowl, mug, config)
    assert not is_oversized(with_bowl, replace(mug, sightings=2), config)
    assert not is_oversized(observation(0, box_surface((0.0, 0.0, 0.05), (0.11, 0.1, 0.11))), mug, config)
