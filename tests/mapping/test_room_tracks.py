"""Tracks that are set aside as part of the room: tracked on, revised, filtered on output."""

import re
from dataclasses import replace
import numpy as np
from numpy.typing import NDArray
from hickory_stream.events import Effect, Event, Publish, SourceEnded
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.geometry.voxels import keys_of_points
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.core import MapperCore
from hickory_stream.mapping.rules.lifecycle import LifecycleConfig
from hickory_stream.records import Decision
from tests.mapping.mapping_fixtures import VOXEL_M, box_surface, drive, keyframe, observation, space

CONFIG = MappingConfig(voxels=Lattice(object_m=VOXEL_M), lifecycle=LifecycleConfig(confirm_s=2.0, phantom_s=2.0))


def cupboard(depth_m: float) -> NDArray[np.float32]:
    """What was seen of a wardrobe whose front is at x = 1 m: up to this depth, and nothing of its back."""
    points = box_surface((1.0 + depth_m / 2, 0.0, 1.0), (depth_m, 1.0, 1.9))
    return points[points[:, 0] < 1.0 + depth_m - 1e-6]


FRONT, WARDROBE = cupboard(0.15), cupboard(0.6)


def seen(i: int, *points: NDArray[np.float32], free: NDArray[np.int64] | None = None, angle_rad: float = 0.0) -> Event:
    found = [observation(j, own) for j, own in enumerate(points)]
    return keyframe(i, found, seen=space(floor_z_m=0.0, free=free), angle_rad=angle_rad)


def decisions(effects: list[Effect]) -> list[Decision]:
    return [decision for effect in effects if isinstance(effect, Publish) for decision in effect.decisions]


def phases(effects: list[Effect]) -> list[str]:
    return [re.split(r",? after \d", d.text)[0] for d in decisions(effects) if d.kind in ("phase", "room")]


def structure(core: MapperCore) -> int:
    return sum(len(submap.observed_space.structure) for submap in core.snapshot().submaps)


def test_a_wardrobe_taken_for_a_wall_becomes_an_object_again():
    core = MapperCore(CONFIG)
    effects = drive(core, [seen(i, FRONT) for i in range(4)])
    assert phases(effects) == ["set aside as part of the room"]
    assert core.snapshot().objects == ()
    held = structure(core)
    assert held > 100
    sides = [cupboard(depth_m) for depth_m in (0.2, 0.26, 0.34, 0.44, 0.6)]
    effects = drive(core, [seen(4 + i, side, angle_rad=0.5 + 0.4 * i) for i, side in enumerate(sides)])
    assert phases(effects)[-2:] == ["an object after all", "tentative -> active"]
    (item,) = core.snapshot().objects
    assert (item.id, item.first_seen_ns) == (1, 0)
    assert min(view.frame_index for view in item.views) < 4, "a view of before it was set aside is kept"
    assert structure(core) == 0
    drive(core, [SourceEnded(stamp_ns=9_000_000_000)])
    assert [found.id for found in core.snapshot().objects] == [1]


def test_a_front_on_a_larger_thing_becomes_a_part_of_it():
    core = MapperCore(CONFIG)
    drive(core, [seen(i, FRONT) for i in range(4)])
    effects = drive(core, [seen(4 + i, WARDROBE, angle_rad=0.5) for i in range(4)])
    assert any("was taken for a part of the room" in d.text for d in decisions(effects) if d.kind == "merge")
    assert [d.text for d in decisions(effects) if d.kind == "room"] == [
        "an object after all: it is a side of #2, which is larger"
    ]
    (item,) = core.snapshot().objects
    assert (item.id, item.first_seen_ns, item.merged_ids) == (1, 0, (2,))
    assert structure(core) == 0


def test_a_final_room_track_is_dropped_as_structure():
    core = MapperCore(CONFIG)
    drive(core, [seen(i, FRONT) for i in range(5)])
    held = structure(core)
    (drop,) = decisions(drive(core, [SourceEnded(stamp_ns=5_000_000_000)]))
    assert (drop.kind, drop.cause) == ("drop", "structure")
    assert core.snapshot().objects == ()
    assert structure(core) == held > 100


def test_a_look_that_is_too_short_revises_nothing():
    config = replace(CONFIG, lifecycle=replace(CONFIG.lifecycle, revise_s=8.0))
    core = MapperCore(config)
    drive(core, [seen(i, FRONT) for i in range(4)])
    growing = [cupboard(depth_m) for depth_m in (0.2, 0.24, 0.28, 0.28)]
    assert phases(drive(core, [seen(4 + i, side) for i, side in enumerate(growing)])) == []
    assert core.snapshot().objects == ()


def test_pieces_of_a_room_track_are_no_objects():
    core = MapperCore(CONFIG)
    drive(core, [seen(i, FRONT) for i in range(4)])
    thing = box_surface((0.8, 0.2, 0.3), (0.2, 0.2, 0.6))
    drive(core, [seen(4 + i, FRONT, thing) for i in range(4)])
    (item,) = core.snapshot().objects
    assert np.allclose(item.box.center, (0.8, 0.2, 0.3), atol=0.03)


def test_a_room_track_that_is_seen_through_is_gone():
    core = MapperCore(CONFIG)
    drive(core, [seen(i, FRONT) for i in range(4)])
    through = np.unique(keys_of_points(FRONT, CONFIG.voxels.space_m))
    effects = drive(core, [seen(4 + i, free=through) for i in range(2)])
    assert [d.cause for d in decisions(effects) if d.kind == "drop"] == ["looked through"]
    assert structure(core) == 0
    assert sum(len(submap.observed_space.free) for submap in core.snapshot().submaps) == len(through)


def test_the_segmenter_gets_the_structure_that_frames_showed():
    core = MapperCore(CONFIG)
    wall = np.unique(keys_of_points(box_surface((3.0, 0.0, 1.2), (0.1, 4.0, 2.4)), CONFIG.voxels.space_m))
    shown = space(structure=wall, floor_z_m=0.0)
    drive(core, [keyframe(i, [observation(0, FRONT)], seen=shown) for i in range(4)])
    prior = core.prior()
    assert prior.space.structure.tolist() == wall.tolist()
    assert prior.objects == ()
    assert structure(core) > len(wall)
