from dataclasses import replace
import numpy as np
from hickory_stream.events import PosesCorrected, Publish, SourceEnded
from hickory_stream.geometry.rigid import apply, from_rotation_translation, invert, yaw_rotation
from hickory_stream.journal.record_codec import decode, encode
from hickory_stream.map_folder.codec import encode_snapshot
from hickory_stream.mapping.core import MapperCore
from hickory_stream.mapping.entities.cloud import is_packed
from hickory_stream.mapping.entities.submaps import SubmapConfig
from hickory_stream.mapping.rules.merge_history import tracks_in
from hickory_stream.mapping.steps.moved_submaps import moved_track
from tests.mapping.mapping_fixtures import SECOND_NS, VOXEL_M, box_surface, drive
from tests.mapping.test_submaps import CONFIG, at

HOME, LONELY = box_surface((0, 0, 0.1)), box_surface((0.9, 0.3, 0.1))
DRIFT = from_rotation_translation(yaw_rotation(0.2), np.array([0.8, 0.5, 0.0]))
"""Where the odometry has the world when the robot is back: what is at `x` it sees at `DRIFT x`."""


def drifted(points):
    return apply(DRIFT, points).astype(np.float32)


def out_and_back(*, sees_home):
    """A walk from two boxes to where nothing is, and back to the first one, with odometry that has drifted."""
    core = MapperCore(replace(CONFIG, submaps=SubmapConfig(travel_m=1.5)))
    drive(core, [at(i, 0.2 * i, HOME, LONELY) for i in range(4)])
    drive(core, [at(4 + i, 2.0 + 0.9 * i) for i in range(3)])
    back = (drifted(HOME),) if sees_home else ()
    drive(core, [at(7 + i, 0.1 * i, *back) for i in range(4)])
    return core


def placed(core):
    """The last submap where it lies in truth, the others where they were."""
    ids = tuple(submap.id for submap in core.snapshot().submaps)
    places = np.array([np.eye(4)] * (len(ids) - 1) + [invert(DRIFT)])
    return PosesCorrected(stamp_ns=20 * SECOND_NS, submap_ids=ids, world_from_submap=places)


def test_a_correction_joins_two_objects_with_both_histories():
    core = out_and_back(sees_home=True)
    assert [item.id for item in core.snapshot().objects] == [1, 2, 3]
    before = {item.id: item for item in core.snapshot().objects}
    effects = core.handle(placed(core))
    core.validate()
    (published,) = (effect for effect in effects if isinstance(effect, Publish))
    home, lonely = published.snapshot.objects
    assert (home.id, home.merged_ids, lonely.id) == (1, (3,), 2)
    assert home.first_seen_ns == before[1].first_seen_ns
    assert home.last_seen_ns == before[3].last_seen_ns
    assert np.allclose(home.box.center, before[1].box.center, atol=0.02)
    assert np.array_equal(lonely.points_world, before[2].points_world)


def test_a_corrected_track_elsewhere_is_compressed_again():
    core = out_and_back(sees_home=True)
    core.handle(placed(core))
    elsewhere, joins = core.state()["elsewhere"], core.state()["joins"]
    assert elsewhere
    assert joins
    assert all(is_packed(track.cloud) and is_packed(track.solid) for track in elsewhere.values())
    assert all(is_packed(track.cloud) for own in joins.values() for track in tracks_in(own))
    # What a keyframe has recognised stays at hand for a while.
    core = out_and_back(sees_home=False)
    core.handle(placed(core))
    (home, lonely) = core.state()["elsewhere"].values()
    drive(core, [at(12, 0.0, drifted(HOME))])
    assert not is_packed(home.cloud)
    assert is_packed(lonely.cloud)
    drive(core, [at(13 + i, 9.0 + 0.1 * i) for i in range(30)])
    assert is_packed(home.cloud)


def test_an_object_in_a_moved_submap_is_recognised_there():
    core = out_and_back(sees_home=False)
    core.handle(placed(core))
    assert [item.id for item in core.snapshot().objects] == [1, 2]
    drive(core, [at(12 + i, 0.1 * i, drifted(HOME)) for i in range(3)])
    core.validate()
    home, lonely = core.snapshot().objects
    assert (home.id, home.sightings, lonely.id, lonely.sightings) == (1, 7, 2, 4)
    assert np.allclose(home.box.center, [0, 0, 0.1], atol=0.03)
    decisions = drive(core, [SourceEnded(stamp_ns=30 * SECOND_NS)])
    assert [item.id for item in core.snapshot().objects] == [1, 2]
    assert any(isinstance(effect, Publish) for effect in decisions)


def test_two_tracks_of_one_thing_elsewhere_are_one_in_the_end():
    core, beside = out_and_back(sees_home=False), drifted(HOME + np.array([0.02, 0.0, 0.0]))
    drive(core, [at(11, 0.0, beside)])
    core.handle(placed(core))
    drive(core, [at(12 + i, 0.1 * i, beside) for i in range(3)])
    assert len(core.snapshot().objects) == 3, "seen once, it did not meet the other when that was moved"
    drive(core, [SourceEnded(stamp_ns=30 * SECOND_NS)])
    assert [item.id for item in core.snapshot().objects] == [1, 2]


def test_without_a_correction_the_way_back_makes_a_second_object():
    assert len(out_and_back(sees_home=True).snapshot().objects) == 3


def test_what_lies_elsewhere_takes_no_part_where_it_was():
    core = out_and_back(sees_home=False)
    core.handle(placed(core))
    drive(core, [at(12 + i, 0.1 * i, LONELY) for i in range(3)])
    core.validate()
    assert next(item for item in core.snapshot().objects if item.id == 2).sightings == 4
    assert len(core.snapshot().objects) == 3


def test_a_withdrawn_correction_restores_every_byte():
    core = out_and_back(sees_home=False)
    before = encode_snapshot(core.snapshot())
    correction = placed(core)
    core.handle(correction)
    assert encode_snapshot(core.snapshot()) != before
    core.handle(replace(correction, world_from_submap=np.array([np.eye(4)] * len(correction.submap_ids))))
    assert encode_snapshot(core.snapshot()) == before


def test_a_core_goes_on_from_its_state_with_what_lies_elsewhere():
    core = out_and_back(sees_home=False)
    core.handle(placed(core))
    again = MapperCore.from_state(core._config, decode(encode(core.state())))
    for each in (core, again):
        drive(each, [at(12 + i, 0.1 * i, drifted(HOME)) for i in range(3)])
    assert encode_snapshot(again.snapshot()) == encode_snapshot(core.snapshot())


def test_a_track_that_is_moved_is_the_same_seen_from_there():
    tracks = out_and_back(sees_home=False).state()["tracks"]
    track = tracks[1]
    moved = moved_track(track, DRIFT, VOXEL_M)
    assert np.allclose(moved.box.center, apply(DRIFT, track.box.center[None])[0], atol=VOXEL_M)
    assert [view.name for view in moved.views] == [view.name for view in track.views]
    for then, now in zip(track.views, moved.views, strict=True):
        assert np.allclose(now.world_from_camera, DRIFT @ then.world_from_camera)
    back = moved_track(moved, invert(DRIFT), VOXEL_M)
    assert np.allclose(back.box.center, track.box.center, atol=VOXEL_M)
    assert 0.7 * len(track.cloud.keys) < len(back.cloud.keys) <= len(track.cloud.keys)
