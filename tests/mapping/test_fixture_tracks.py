from dataclasses import replace
import numpy as np
from hickory_stream.events import Publish, RequestShape, SourceEnded
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.geometry.voxels import keys_of_points
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.core import MapperCore
from hickory_stream.mapping.entities.submaps import first_submap
from hickory_stream.mapping.map_state import MapState
from hickory_stream.mapping.rules.lifecycle import LifecycleConfig
from hickory_stream.mapping.rules.merging import MergeConfig, VoteBook, merge, why_one
from hickory_stream.records import ObjectKind, Phase
from tests.mapping.mapping_fixtures import SECOND_NS, VOXEL_M, box_surface, drive, keyframe, observation, space, track

CONFIG = MappingConfig(voxels=Lattice(object_m=VOXEL_M), lifecycle=LifecycleConfig(confirm_s=2.0, phantom_s=2.0))
WALL = box_surface((1.05, 0.0, 1.2), (0.1, 4.0, 2.4))
PICTURE = box_surface((0.985, 0.0, 1.5), (0.02, 0.6, 0.4))
BALL = box_surface((0.3, 0.0, 0.1), (0.2, 0.2, 0.2))
FIXTURE = ObjectKind.FIXTURE


def voxels(points):
    return np.unique(keys_of_points(points, CONFIG.voxels.space_m))


def seen(i, *points, free=None):
    found = [observation(j, own) for j, own in enumerate(points)]
    shown = replace(
        space(structure=voxels(WALL), free=free, floor_z_m=0.0),
        surface_keys=np.setdiff1d(voxels(PICTURE), voxels(WALL)),
    )
    return keyframe(i, found, seen=shown)


def test_a_picture_is_published_as_a_fixture_and_gets_a_shape():
    core = MapperCore(CONFIG)
    effects = drive(core, [seen(i, PICTURE, BALL) for i in range(5)] + [SourceEnded(stamp_ns=9_000_000_000)])
    assert {item.id: item.kind for item in core.snapshot().objects} == {1: FIXTURE, 2: ObjectKind.OBJECT}
    assert {effect.object_id for effect in effects if isinstance(effect, RequestShape)} == {1, 2}
    said = [d for effect in effects if isinstance(effect, Publish) for d in effect.decisions if d.kind == "kind"]
    # When it becomes a fixture, and both at the end.
    assert [(d.object_id, d.text.split()[0]) for d in said] == [(1, "fixture"), (1, "fixture"), (2, "object")]
    assert "at a wall" in said[0].text


def test_the_segmenter_gets_no_fixtures():
    core = MapperCore(CONFIG)
    drive(core, [seen(i, PICTURE, BALL) for i in range(5)])
    assert [item.id for item in core.prior().objects] == [2]


def test_a_fixture_that_is_seen_through_is_gone():
    core = MapperCore(CONFIG)
    drive(core, [seen(i, PICTURE) for i in range(4)])
    effects = drive(core, [seen(4 + i, free=np.setdiff1d(voxels(PICTURE), voxels(WALL))) for i in range(2)])
    drops = [d for effect in effects if isinstance(effect, Publish) for d in effect.decisions if d.kind == "drop"]
    assert [d.cause for d in drops] == ["looked through"]


def test_votes_do_not_join_an_object_and_a_wall_but_overlap_does():
    graph, config = MapState(submaps=first_submap(0.05)).support_graph(), MergeConfig()
    thing, wall = track(1, PICTURE, sightings=9), replace(track(2, WALL, sightings=9), kind=FIXTURE, is_attached=True)
    book = VoteBook().plus([(1, 2)], together_ns=9 * SECOND_NS)
    assert why_one(thing, wall, [], book, graph, 0.01, config) is None
    # A fixture by its size alone is joined as an object is.
    assert "seen as one" in why_one(thing, replace(wall, is_attached=False), [], book, graph, 0.01, config)
    piece = track(3, WALL[WALL[:, 1] < 0.0], sightings=9)
    assert "lies on the larger, fixture" in why_one(piece, wall, [], VoteBook(), graph, 0.01, config)
    # Its kind is judged again.
    assert merge(wall, piece, VOXEL_M).judged_points == 0


def test_a_track_of_the_room_of_an_earlier_version_is_tentative():
    assert Phase("room") is Phase.TENTATIVE
