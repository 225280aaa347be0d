from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.events import PosesCorrected, Publish, SourceEnded
from hickory_stream.geometry.lattice import STEPS_PER_M
from hickory_stream.geometry.rigid import apply, from_rotation_translation, invert, yaw_rotation
from hickory_stream.geometry.voxels import centers_of_keys, keys_of_points
from hickory_stream.journal.record_codec import decode, encode
from hickory_stream.map_folder.codec import encode_snapshot
from hickory_stream.map_folder.history.track_histories import TrackHistories
from hickory_stream.mapping.core import MapperCore
from hickory_stream.mapping.entities.cloud import Cloud, fuse, grown_since, is_packed
from hickory_stream.mapping.entities.submaps import SubmapConfig
from hickory_stream.mapping.rules.merge_history import tracks_in
from hickory_stream.mapping.steps.moved_submaps import moved_track
from tests.mapping.mapping_fixtures import SECOND_NS, VOXEL_M, box_surface, drive
from tests.mapping.test_submaps import CONFIG, at, with_shapes

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


def test_what_lies_elsewhere_takes_no_part_where_it_was():
    core = out_and_back(sees_home=False)
    core.handle(placed(core))
    drive(core, [at(12 + i, 0.1 * i, LONELY) for i in range(3)])
    core.validate()
    assert next(item for item in core.snapshot().objects if item.id == 2).sightings == 4
    assert len(core.snapshot().objects) == 3


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


def withdrawn(core):
    """Every submap where odometry has it: no loop is believed any more."""
    correction = placed(core)
    return replace(correction, world_from_submap=np.array([np.eye(4)] * len(correction.submap_ids)))


def objects_of(core):
    return {item.id: item for item in core.snapshot().objects}


@pytest.mark.parametrize("sees_home", [False, True])
def test_a_withdrawn_correction_restores_every_byte(sees_home):
    core = with_shapes(out_and_back(sees_home=sees_home))
    before = encode_snapshot(core.snapshot())
    assert any(item.shape is not None for item in core.snapshot().objects)
    core.handle(placed(core))
    assert [item.merged_ids for item in core.snapshot().objects] == [(3,) if sees_home else (), ()]
    corrected = encode_snapshot(core.snapshot())
    assert corrected != before
    core.handle(withdrawn(core))
    core.validate()
    assert encode_snapshot(core.snapshot()) == before
    core.handle(placed(core))
    core.validate()
    assert encode_snapshot(core.snapshot()) == corrected


def test_what_keyframes_saw_since_stays_with_the_one_they_saw():
    core = out_and_back(sees_home=True)
    before = objects_of(core)
    core.handle(placed(core))
    drive(core, [at(12 + i, 0.1 * i, drifted(HOME)) for i in range(3)])
    effects = core.handle(withdrawn(core))
    core.validate()
    after = objects_of(core)
    assert after.keys() == before.keys() == {1, 2, 3}
    for untouched in (1, 2):
        was, now = before[untouched], after[untouched]
        assert np.array_equal(now.points_world, was.points_world)
        assert (now.sightings, now.last_seen_ns, now.merged_ids) == (was.sightings, was.last_seen_ns, ())
        assert [view.name for view in now.views] == [view.name for view in was.views]
    assert (after[3].sightings, before[3].sightings) == (7, 4)
    assert after[3].last_seen_ns > before[3].last_seen_ns
    assert np.allclose(after[3].box.center, before[3].box.center, atol=0.02)
    assert {view.object_id for view in after[3].views} == {3}
    (published,) = (effect for effect in effects if isinstance(effect, Publish))
    assert {item.id for item in published.snapshot.objects} == {1, 2, 3}


def test_what_was_recognised_is_parted_from_what_was_seen_there():
    core = out_and_back(sees_home=False)
    before = objects_of(core)
    core.handle(placed(core))
    drive(core, [at(12 + i, 0.1 * i, drifted(HOME)) for i in range(3)])
    assert objects_of(core)[1].sightings == 7
    core.handle(withdrawn(core))
    core.validate()
    after = objects_of(core)
    assert after.keys() == {1, 2, 3}
    assert np.array_equal(after[1].points_world, before[1].points_world)
    assert (after[1].sightings, after[3].sightings) == (4, 3)
    assert np.allclose(after[3].box.center, drifted(HOME).mean(axis=0), atol=0.03)
    assert after[3].first_seen_ns > before[1].last_seen_ns


@pytest.mark.parametrize("shift_m", [0.05, 0.15])
def test_a_join_stands_while_later_corrections_move_it_a_little(shift_m):
    core = out_and_back(sees_home=True)
    core.handle(placed(core))
    correction = placed(core)
    off = from_rotation_translation(np.eye(3), np.array([shift_m, 0.0, 0.0]))
    places = np.array([*correction.world_from_submap[:-1], off @ invert(DRIFT)])
    core.handle(replace(correction, world_from_submap=places))
    core.validate()
    assert objects_of(core)[1].merged_ids == (3,)


@pytest.mark.parametrize("sees_home", [False, True])
def test_a_map_goes_on_alike_from_its_state_and_parts_alike(sees_home):
    core = out_and_back(sees_home=sees_home)
    core.handle(placed(core))
    again = MapperCore.from_state(core._config, decode(encode(core.state())))
    assert encode_snapshot(again.snapshot()) == encode_snapshot(core.snapshot())
    for each in (core, again):
        drive(each, [at(12 + i, 0.1 * i, drifted(HOME)) for i in range(3)])
    assert encode_snapshot(again.snapshot()) == encode_snapshot(core.snapshot())
    for each in (core, again):
        each.handle(withdrawn(each))
    assert encode_snapshot(again.snapshot()) == encode_snapshot(core.snapshot())
    assert len(core.snapshot().objects) == 3


def test_histories_say_that_a_track_was_merged_and_parted():
    core = out_and_back(sees_home=True)
    histories = TrackHistories()
    core.handle(placed(core))
    core.handle(withdrawn(core))
    effects = drive(core, [at(12, 0.1, drifted(HOME))])
    (published,) = (effect for effect in effects if isinstance(effect, Publish))
    histories.add(12, published.decisions)
    history = histories.by_id[3]
    assert history.ending is None
    assert any(turn.text.startswith("parted from #1: #1 of submap 0 does not lie there") for turn in history.turns)
    assert histories.final(3) == 3


def test_what_a_cloud_gained_is_what_was_fused_into_it():
    rng = np.random.default_rng(1)
    lattice = keys_of_points(np.array([[0.2 * i, -0.1 * i, 0.3] for i in range(60)]), VOXEL_M)
    first, second = (
        Cloud(
            keys=np.sort(rng.choice(lattice, 20, replace=False)), points=np.empty((20, 3), np.float32),
            colors=rng.uniform(0, 255, (20, 3)).astype(np.float32), hits=rng.integers(1, 9, 20).astype(np.int32),
        )
        for _ in range(2)
    )  # fmt: skip
    first, second = (replace(c, points=centers_of_keys(c.keys, VOXEL_M).astype(np.float32)) for c in (first, second))
    gained = grown_since(fuse(first, second), first, VOXEL_M)
    assert len(np.intersect1d(first.keys, second.keys)) > 0
    assert np.array_equal(gained.keys, second.keys)
    assert np.array_equal(gained.hits, second.hits)
    # The fused mean is off by half a step, times its hits, of which as few as one are the gain.
    assert np.allclose(gained.points, second.points, atol=8 / STEPS_PER_M)
    assert np.allclose(gained.colors, second.colors, atol=1e-2)
