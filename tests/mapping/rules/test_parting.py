from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.events import Publish
from hickory_stream.geometry.lattice import STEPS_PER_M
from hickory_stream.geometry.rigid import from_rotation_translation, invert
from hickory_stream.geometry.voxels import centers_of_keys, keys_of_points
from hickory_stream.journal.record_codec import decode, encode
from hickory_stream.map_folder.codec import encode_snapshot
from hickory_stream.map_folder.history.track_histories import TrackHistories
from hickory_stream.mapping.core import MapperCore
from hickory_stream.mapping.entities.cloud import Cloud, fuse, grown_since
from tests.mapping.mapping_fixtures import VOXEL_M, drive, shape_ready
from tests.mapping.test_moved_submaps import DRIFT, HOME, at, drifted, out_and_back, placed


def withdrawn(core):
    """Every submap where odometry has it: no loop is believed any more."""
    correction = placed(core)
    return replace(correction, world_from_submap=np.array([np.eye(4)] * len(correction.submap_ids)))


def objects_of(core):
    return {item.id: item for item in core.snapshot().objects}


def with_shapes(core):
    """Give each object that has asked for one a shape of its own."""
    for track in core.state()["tracks"].values():
        if track.shape_state.open_ticket is not None:
            core.handle(shape_ready(track.shape_state.open_ticket, track.id))
    return core


def test_a_merge_is_undone_to_the_byte_without_a_keyframe_since():
    core = with_shapes(out_and_back(sees_home=True))
    before = encode_snapshot(core.snapshot())
    assert any(item.shape is not None for item in core.snapshot().objects)
    core.handle(placed(core))
    assert [item.merged_ids for item in core.snapshot().objects] == [(3,), ()]
    core.handle(withdrawn(core))
    core.validate()
    assert encode_snapshot(core.snapshot()) == before


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


def test_a_map_goes_on_alike_from_its_state_and_parts_alike():
    core = out_and_back(sees_home=True)
    core.handle(placed(core))
    drive(core, [at(12, 0.1, drifted(HOME))])
    again = MapperCore.from_state(core._config, decode(encode(core.state())))
    for each in (core, again):
        each.handle(withdrawn(each))
    assert encode_snapshot(again.snapshot()) == encode_snapshot(core.snapshot())
    assert len(core.snapshot().objects) == 3


def test_a_loop_that_is_found_again_joins_them_again():
    core = out_and_back(sees_home=True)
    core.handle(placed(core))
    joined = encode_snapshot(core.snapshot())
    core.handle(withdrawn(core))
    core.handle(placed(core))
    core.validate()
    assert encode_snapshot(core.snapshot()) == joined


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
            keys=np.sort(rng.choice(lattice, 20, replace=False)),
            points=np.empty((20, 3), np.float32),
            colors=rng.uniform(0, 255, (20, 3)).astype(np.float32),
            hits=rng.integers(1, 9, 20).astype(np.int32),
        )
        for _ in range(2)
    )
    first, second = (replace(c, points=centers_of_keys(c.keys, VOXEL_M).astype(np.float32)) for c in (first, second))
    gained = grown_since(fuse(first, second), first, VOXEL_M)
    assert len(np.intersect1d(first.keys, second.keys)) > 0
    assert np.array_equal(gained.keys, second.keys)
    assert np.array_equal(gained.hits, second.hits)
    # The fused mean is off by half a step, times its hits, of which as few as one are the gain.
    assert np.allclose(gained.points, second.points, atol=8 / STEPS_PER_M)
    assert np.allclose(gained.colors, second.colors, atol=1e-2)
