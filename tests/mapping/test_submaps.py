from dataclasses import replace
from functools import reduce
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hickory_stream.events import (
    FrameObserved,
    KeyframeRegistered,
    PoseJumped,
    PosesCorrected,
    Publish,
    RequestShape,
    SourceEnded,
)
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.geometry.rigid import apply, compose, from_rotation_translation, yaw_rotation
from hickory_stream.geometry.voxels import keys_of_points
from hickory_stream.journal.record_codec import decode, encode
from hickory_stream.map_folder.codec import encode_snapshot
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.core import MapperCore
from hickory_stream.mapping.entities.observed_space import add, as_record
from hickory_stream.mapping.entities.submaps import (
    SubmapConfig,
    after_pose_jump,
    first_submap,
    interrupted,
    longer,
    record_of_space,
    shown_space,
    travelled,
    with_keyframe,
    with_registration,
    with_seen,
)
from hickory_stream.mapping.rules.lifecycle import LifecycleConfig
from hickory_stream.mapping.rules.shape_requests import RequestConfig
from hickory_stream.records import SpaceObservation
from tests.mapping.mapping_fixtures import SECOND_NS, VOXEL_M, box_surface, drive, observation, shape_ready, space

CONFIG = MappingConfig(
    voxels=Lattice(object_m=VOXEL_M),
    lifecycle=LifecycleConfig(confirm_s=2.0, dormant_s=4.0, tentative_s=8.0, phantom_s=2.0),
    requests=RequestConfig(first_sightings=3, max_in_flight=2, latency_s=1.5),
    submaps=SubmapConfig(travel_m=1.5),
)
A, B, C = (box_surface((x, 0, 0.1)) for x in (0.0, 1.5, 3.0))
JUMP = from_rotation_translation(np.eye(3), np.array([0.3, 0.0, 0.0]))
ALONG_X = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0]])
MOVE = from_rotation_translation(yaw_rotation(0.4), np.array([1.0, -2.0, 0.1]))


def at(frame_index, x_m, *seen, space_seen=None):
    """A keyframe from (x_m, -2, 0.5) that shows these things."""
    return FrameObserved(
        frame_index=frame_index,
        stamp_ns=frame_index * SECOND_NS,
        world_from_camera=from_rotation_translation(np.eye(3), np.array([x_m, -2.0, 0.5])),
        observations=tuple(observation(i, points) for i, points in enumerate(seen)),
        space=space_seen or space(structure=keys_of_points(np.float32([[x_m, 1.0, 0.0]]), 0.05), floor_z_m=0.0),
    )


def walk(config=CONFIG):
    """A core after a walk of 4 m past three boxes, the second of which is seen from two submaps."""
    core = MapperCore(config)
    seen = [(A,), (A, B), (A, B), (B,), (B, C), (B, C), (C,), (C,), (C,)]
    drive(core, [at(i, 0.5 * i, *things) for i, things in enumerate(seen)])
    return core


def corrected(*places):
    ids, poses = tuple(i for i, _ in places), np.array([pose for _, pose in places]).reshape(-1, 4, 4)
    return PosesCorrected(stamp_ns=9 * SECOND_NS, submap_ids=ids, world_from_submap=poses)


def whose(snapshot):
    return [(item.id, item.submap_id) for item in snapshot.objects]


def camera_at(x_m):
    pose = np.eye(4)
    pose[0, 3] = x_m
    return pose


def test_an_object_belongs_to_its_first_submap():
    snapshot = walk().snapshot()
    assert [submap.id for submap in snapshot.submaps] == [0, 1, 2]
    assert whose(snapshot) == [(1, 0), (2, 0), (3, 1)]
    assert [item.sightings for item in snapshot.objects] == [3, 5, 5]


def test_submaps_change_nothing_of_a_map_but_whose_things_are():
    split, whole = walk().snapshot(), walk(replace(CONFIG, submaps=SubmapConfig())).snapshot()
    assert len(whole.submaps) == 1
    same = replace(split, objects=tuple(replace(item, submap_id=0) for item in split.objects))
    assert map_digest(same) == map_digest(whole)
    for name in ("free", "structure"):
        parts = [getattr(submap.observed_space, name) for submap in split.submaps]
        assert np.array_equal(np.sort(np.concatenate(parts)), getattr(whole.submaps[0].observed_space, name))


def test_prior_knowledge_of_perception_outlives_a_submap():
    split, whole = walk().prior(), walk(replace(CONFIG, submaps=SubmapConfig())).prior()
    split, whole = split.space, whole.space
    assert np.array_equal(split.structure, whole.structure)
    assert np.array_equal(split.free, whole.free)
    assert split.floor_z_m == whole.floor_z_m
    assert MapperCore(CONFIG).prior() is None


def test_a_thing_seen_again_in_a_moved_map_keeps_the_records_of_its_views():
    core = walk()
    core.handle(corrected((0, MOVE), (1, MOVE), (2, MOVE)))
    before = core.snapshot().objects[-1]
    drive(core, [at(9, 4.0, C)])
    after = core.snapshot().objects[-1]
    assert (after.id, after.sightings) == (before.id, before.sightings + 1)
    assert {id(view) for view in before.views} & {id(view) for view in after.views}


_KEYS = st.lists(st.integers(0, 30), max_size=12).map(lambda keys: np.unique(np.int64(keys)))


@given(st.lists(st.tuples(st.sampled_from(["seen", "went"]), _KEYS, _KEYS), max_size=25))
@settings(deadline=None)
def test_every_voxel_is_in_one_submap_and_none_is_lost(steps):
    submaps, place = first_submap(0.05), 0.0
    for kind, free, structure in steps:
        if kind == "seen":
            surface = np.setdiff1d(free + 1, structure)
            seen = SpaceObservation(free_keys=free, structure_keys=structure, surface_keys=surface, floor_z_m=0.1)
            submaps = with_seen(submaps, seen)
        else:
            place += 1.0
            submaps = travelled(submaps, camera_at(place), 0, SubmapConfig(travel_m=1.5))
    judge, parts = as_record(submaps.space), [record_of_space(shown_space(state), None) for state in submaps.states]
    for name in ("free", "structure"):
        together = np.concatenate([getattr(part, name) for part in parts])
        assert np.array_equal(np.sort(together), getattr(judge, name))
    owned = [np.union1d(state.space.free, state.space.surface) for state in submaps.states]
    assert len(np.unique(np.concatenate(owned))) == sum(map(len, owned))


def test_a_voxel_that_an_open_submap_took_while_it_was_moved_apart_stays_with_the_earlier_one():
    keys, config = np.int64([5, 7]), SubmapConfig(travel_m=0.5)
    seen = SpaceObservation(free_keys=keys, structure_keys=keys[:0], surface_keys=keys[:0], floor_z_m=0.1)
    submaps = travelled(with_seen(first_submap(0.05), seen), camera_at(0.0), 0, config)
    submaps = travelled(submaps, camera_at(1.0), 0, config)
    both = replace(submaps.states[-1], space=submaps.states[0].space)
    submaps = travelled(replace(submaps, states=(*submaps.states[:-1], both)), camera_at(2.0), 0, config)
    assert len(submaps.states) == 3
    assert (submaps.owned.tolist(), submaps.owners.tolist()) == ([5, 7], [0, 0])


def test_the_way_is_not_measured_across_a_jump_of_the_stamps():
    def went(submaps, x_m):
        return travelled(submaps, camera_at(x_m), 0, SubmapConfig(travel_m=15.0, drift_m=100.0))

    there = reduce(went, [0.0, 7.0, 14.0], first_submap(0.05))
    assert len(went(interrupted(there), 0.0).states) == 1
    assert len(went(there, 0.0).states) == 2


def test_a_jump_closes_the_submap_and_objects_are_recognised():
    core = MapperCore(replace(CONFIG, submaps=SubmapConfig()))
    drive(core, [at(i, 0.0, A) for i in range(4)])
    before = core.snapshot().submaps[0].observed_space
    drive(core, [PoseJumped(stamp_ns=4 * SECOND_NS, after_from_before=JUMP), *(at(4 + i, 0.0, A, B) for i in range(3))])
    snapshot = core.snapshot()
    assert [submap.id for submap in snapshot.submaps] == [0, 1]
    assert whose(snapshot) == [(1, 0), (2, 1)]
    assert snapshot.objects[0].sightings == 7
    old, new = (submap.observed_space for submap in snapshot.submaps)
    assert old is before
    assert np.array_equal(new.structure, before.structure)


def test_a_jump_before_any_keyframe_leaves_no_empty_submap():
    core = MapperCore(CONFIG)
    drive(core, [PoseJumped(stamp_ns=0, after_from_before=JUMP), at(0, 0.0, A)])
    assert [submap.id for submap in core.snapshot().submaps] == [0]


def test_after_a_jump_an_unseen_object_is_not_looked_through():
    inside = space(free=np.unique(keys_of_points(A, 0.05)))
    through = [at(4 + i, 0.0, space_seen=inside) for i in range(4)]

    def ids(*events):
        core = MapperCore(CONFIG)
        drive(core, [*(at(i, 0.0, A) for i in range(4)), *events])
        return [item.id for item in core.snapshot().objects]

    jump = PoseJumped(stamp_ns=4 * SECOND_NS, after_from_before=JUMP)
    assert ids(*through) == []
    assert ids(jump, *through) == [1]
    assert ids(jump, at(4, 0.0, A), *(replace(f, frame_index=f.frame_index + 1) for f in through)) == []


def with_shapes(core):
    """The core after the shapes that it had asked for, and asks for at the end, have come."""
    asked = drive(core, [SourceEnded(stamp_ns=9 * SECOND_NS)])
    open_tickets = {(e.ticket, e.object_id) for e in asked if isinstance(e, RequestShape)}
    tracks = core.state()["tracks"]
    open_tickets |= {(t.shape_state.open_ticket, t.id) for t in tracks.values() if t.shape_state.open_ticket}
    drive(core, [shape_ready(ticket, object_id) for ticket, object_id in sorted(open_tickets)])
    return core


def test_a_correction_moves_a_submap_with_its_contents_only():
    core = with_shapes(walk())
    before = core.snapshot()
    (published,) = core.handle(corrected((0, MOVE)))
    assert isinstance(published, Publish)
    after = core.snapshot()
    assert [submap.id for submap in after.submaps if np.array_equal(submap.world_from_submap, MOVE)] == [0]
    for old, new in zip(before.objects, after.objects, strict=True):
        if old.submap_id != 0:
            assert new is old
            continue
        assert np.allclose(new.points_world, apply(MOVE, old.points_world), atol=1e-6)
        assert np.allclose(new.box.world_from_box, MOVE @ old.box.world_from_box)
        assert np.allclose(new.shape.world_from_object, MOVE @ old.shape.world_from_object)
        for name in ("fitted", "inflated"):
            theirs, ours = getattr(old.shape, name), getattr(new.shape, name)
            assert np.allclose(ours.world_from_local, MOVE @ theirs.world_from_local)
            assert np.array_equal(ours.semi_axes_m, theirs.semi_axes_m)
        assert new.shape.mesh_sha256 == old.shape.mesh_sha256
        assert new.shape.revision == old.shape.revision
        assert [v.name for v in new.views] == [v.name for v in old.views]
        assert new.best_view in new.views
        for theirs, ours in zip(old.views, new.views, strict=True):
            assert np.allclose(ours.world_from_camera, MOVE @ theirs.world_from_camera)
    for was, now in zip(before.submaps, after.submaps, strict=True):
        assert np.array_equal(was.observed_space.structure, now.observed_space.structure)


def test_the_identity_undoes_corrections_to_the_last_byte():
    core = with_shapes(walk())
    before = encode_snapshot(core.snapshot())
    core.handle(corrected((0, MOVE), (2, MOVE)))
    core.handle(corrected((1, MOVE), (0, MOVE @ MOVE)))
    assert encode_snapshot(core.snapshot()) != before
    core.handle(corrected(*((i, np.eye(4)) for i in range(3))))
    assert encode_snapshot(core.snapshot()) == before


def test_after_a_correction_frames_stay_in_the_odometry_world():
    plain, moved = walk(), walk()
    moved.handle(corrected((0, MOVE), (1, MOVE), (2, MOVE)))
    more = [at(9 + i, 4.0 - 0.5 * i, B, C) for i in range(3)]
    drive(plain, more)
    drive(moved, more)
    # The fourth began with the way back: it lies as the one that it goes on from.
    assert all(np.array_equal(s.world_from_submap, MOVE) for s in moved.snapshot().submaps)
    moved.handle(corrected(*((i, np.eye(4)) for i in range(len(moved.snapshot().submaps)))))
    assert encode_snapshot(moved.snapshot()) == encode_snapshot(plain.snapshot())


def test_unknown_or_double_submaps_or_bad_moves_are_refused():
    core = walk()
    before = encode_snapshot(core.snapshot())
    with pytest.raises(ValueError, match="no submap 7; the map has 0 to 2"):
        core.handle(corrected((0, MOVE), (7, MOVE)))
    assert encode_snapshot(core.snapshot()) == before
    with pytest.raises(ValueError, match="submap 0 is no rigid transform"):
        corrected((0, np.diag([2.0, 1.0, 1.0, 1.0])))
    with pytest.raises(ValueError, match="named twice"):
        corrected((0, MOVE), (0, MOVE))


def test_an_addition_to_space_follows_the_open_submaps_floor():
    seen = SpaceObservation(free_keys=np.int64([1, 2]), structure_keys=np.int64([5]), floor_z_m=0.0)
    step = replace(seen, free_keys=np.int64([2, 3]), floor_z_m=-0.2)
    one = with_seen(travelled(first_submap(0.05), camera_at(0.0), 0, SubmapConfig()), seen)
    two = with_seen(travelled(one, camera_at(20.0), 0, SubmapConfig()), step)
    assert [state.space.floor_z_m for state in two.states] == [0.0, two.space.floor_z_m]
    assert add(one.space, step).floor_z_m == two.space.floor_z_m
    assert after_pose_jump(two, np.eye(4), 0.2).space.floor_z_m is None


def test_a_jump_leaves_open_what_it_is_long_where_the_camera_is():
    """A turn about the origin moves a camera that is 20 m away; of an unknown jump (the identity) all is open."""
    far = travelled(first_submap(0.05), camera_at(20.0), 0, SubmapConfig())
    turned = from_rotation_translation(yaw_rotation(0.02), np.zeros(3))
    small, later, unknown = (
        after_pose_jump(far, jump, gap_s).states[-1] for jump, gap_s in ((turned, 0.2), (turned, 4.0), (np.eye(4), 0.2))
    )
    assert 0.2 <= small.jump_m < 0.3
    assert 0.01 <= small.jump_rad < 0.1
    assert small.jump_m + 1.0 < later.jump_m < unknown.jump_m
    assert unknown.jump_rad >= 3.0


def test_a_floor_found_to_be_a_table_is_none_in_older_submaps():
    seen = SpaceObservation(free_keys=np.int64([1, 2]), structure_keys=np.int64([5]), floor_z_m=0.0)
    one = with_seen(travelled(first_submap(0.05), camera_at(0.0), 0, SubmapConfig()), seen)
    two = with_seen(travelled(one, camera_at(20.0), 0, SubmapConfig()), replace(seen, floor_z_m=-0.5))
    assert [state.space.floor_z_m for state in two.states] == [-0.5, -0.5]


def registered(covariance, x_m, *, corrects=True):
    """A keyframe at (x_m, -2, 0.5), whose surface says nothing along the map's x."""
    pose = at(0, x_m).world_from_camera
    return KeyframeRegistered(
        frame_index=0, stamp_ns=0, how="fits", odometry_from_camera=pose, map_from_camera=pose,
        map_from_odometry=np.eye(4), covariance=covariance, corrects=corrects, num_against=0, is_anchor=True,
        spread_per_m=0.0025, fit=0.9, degenerate=ALONG_X,
    )  # fmt: skip


def test_a_submap_keeps_the_covariance_of_its_worst_keyframe():
    narrow, wide = np.diag([1e-6] * 3 + [1e-4] * 3), np.diag([1e-6] * 3 + [1e-2] * 3)
    submaps = first_submap(0.05)
    for covariance in (narrow, wide, narrow):
        submaps = with_registration(submaps, registered(covariance, 0.0))
    assert submaps.states[0].registered is not None
    assert np.array_equal(submaps.states[0].registered, wide)
    loose = with_registration(submaps, registered(narrow, 0.0, corrects=False))
    loose = with_registration(loose, registered(narrow, 0.0))
    assert loose.states[0].registered is None


def test_a_submap_adds_up_the_unobserved_path():
    submaps = first_submap(0.05)
    for i in range(5):
        seen = replace(at(i, 0.25 * i), degenerate=ALONG_X if i < 3 else ALONG_X[:0])
        submaps = with_keyframe(with_registration(submaps, registered(np.eye(6), 0.25 * i)), seen, SubmapConfig())
    (submap,) = submaps.states
    assert submap.unfixed is not None
    assert np.allclose(submap.unfixed, np.diag([0.0, 0, 0, 1.0, 0, 0]))
    assert np.allclose(submap.blind, np.diag([0.0, 0, 0, 0.5, 0, 0]))
    assert decode(encode(submap)).blind.tobytes() == submap.blind.tobytes()


EAST, TURNS = np.eye(6)[[3]], np.eye(6)[[2]]
STEP = from_rotation_translation(yaw_rotation(0.1), np.array([0.3, 0.4, 0.0]))


def test_path_length_adds_up_along_blind_directions_only():
    lengths, pose = None, np.eye(4)
    for directions in (EAST, EAST, TURNS, EAST[:0]):
        after = compose(pose, STEP)
        lengths = longer(lengths, directions, pose, after)
        pose = after
    assert lengths[3, 3] == pytest.approx(1.0)
    assert lengths[2, 2] == pytest.approx(0.1)
    assert np.count_nonzero(lengths) == 2


def test_a_slanted_direction_has_a_length_and_a_first_step_none():
    askew = np.array([[0.0, 0.0, 0.0, 0.6, 0.8, 0.0]])
    lengths = longer(None, askew, np.eye(4), STEP)
    assert lengths is not None
    assert np.allclose(lengths @ askew[0], 0.5 * askew[0])
    assert longer(None, EAST, None, STEP) is None
    assert longer(None, EAST[:0], np.eye(4), STEP) is None
