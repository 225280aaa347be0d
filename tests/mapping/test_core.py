import ast
import inspect
import math
from dataclasses import replace
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hickory_stream.events import (
    CancelShape,
    ComputeFeatures,
    FeaturesReady,
    PoseJumped,
    PosesCorrected,
    Publish,
    RequestShape,
    ShapeFailed,
    SourceEnded,
    TimeJumped,
)
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.geometry.superquadric import volumes_m3
from hickory_stream.geometry.voxels import keys_of_points
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.mapping import core
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.core import MapperCore
from hickory_stream.mapping.entities.views import ViewConfig
from hickory_stream.mapping.rules.lifecycle import LifecycleConfig
from hickory_stream.mapping.rules.merging import MergeConfig
from hickory_stream.mapping.rules.shape_requests import RequestConfig
from hickory_stream.records import Phase, RejectedMask
from tests.mapping.mapping_fixtures import (
    SECOND_NS,
    VOXEL_M,
    box_surface,
    drive,
    feature,
    keyframe,
    observation,
    shape_ready,
    space,
    told,
)
from tests.strategies import radial_distance_m, unit_share

CONFIG = MappingConfig(
    voxels=Lattice(object_m=VOXEL_M),
    lifecycle=LifecycleConfig(confirm_s=2.0, dormant_s=4.0, tentative_s=8.0, phantom_s=4.0),
    merge=MergeConfig(min_together_s=1.5),
    requests=RequestConfig(first_sightings=3, max_in_flight=2, latency_s=1.5, kilopoint_s=0.0),
)
# Off the border between two of the eight sectors.
ANGLE_RAD = 0.3
A, B = box_surface((0, 0, 0.1)), box_surface((0.6, 0, 0.1))
# Two halves of a chest, side by side, and the whole of it.
LEFT, RIGHT = box_surface((0, 0, 0.1)), box_surface((0.2, 0, 0.1))
WHOLE = box_surface((0.1, 0, 0.1), (0.4, 0.2, 0.2))


def both(area_a=0.05, area_b=0.05):
    return observation(0, A, r_area=area_a), observation(1, B, r_area=area_b)


def frame(frame_index, *seen, stamp_s=None):
    stamp_ns = None if stamp_s is None else round(stamp_s * SECOND_NS)
    return keyframe(frame_index, seen, stamp_ns=stamp_ns, angle_rad=ANGLE_RAD)


def last_publish(effects):
    assert isinstance(effects[-1], Publish)
    return effects[-1]


def by_id(snapshot):
    return {tracked.id: tracked for tracked in snapshot.objects}


def requests(effects):
    return [effect for effect in effects if isinstance(effect, RequestShape)]


def kinds(effects, object_id):
    return [d.kind for e in effects if isinstance(e, Publish) for d in e.decisions if d.object_id == object_id]


def test_two_boxes_over_several_keyframes_give_these_effects():
    core = MapperCore(CONFIG)
    variances = {(0, 0): 0.5, (0, 1): 0.5, (1, 1): 0.4, (2, 0): 0.5}

    def step(*events):
        return told(drive(core, events, lambda f, i: variances[f, i]))

    # New: both have no best view, so that both bounds win; both are the first of their sector.
    assert step(frame(0, *both())) == [
        ("keep", 1, 0),
        ("keep", 2, 0),
        ("features", 0, (0, 1)),
        ("publish", ((1, "tentative"), (2, "tentative"))),
    ]
    # A tenth of the area: 0.1^0.3 = 0.50 < ln 1.5 / ln 2 = 0.58, the bound of A loses. B's wins, its score does not.
    assert step(frame(1, *both(area_a=0.005))) == [
        ("features", 1, (1,)),
        ("publish", ((1, "tentative"), (2, "tentative"))),
    ]
    # Confirmed. A is four times as large: best, and kept for its sector, so that the first view of it goes.
    assert step(frame(2, *both(area_a=0.2, area_b=0.005))) == [
        ("keep", 1, 2),
        ("features", 2, (0,)),
        ("request", 1, 1),
        ("request", 2, 2),
        ("drop", 0),
        ("publish", ((1, "active"), (2, "active"))),
    ]
    assert step(shape_ready(1, 1)) == []
    assert step(ShapeFailed(ticket=2, object_id=2, stamp_ns=0, reason="no points")) == []
    assert step(frame(3)) == [("publish", ((1, "active"), (2, "active")))]
    assert step(frame(8)) == [("publish", ((1, "dormant"), (2, "dormant")))]
    assert step(frame(9, observation(0, A, r_area=0.005))) == [("publish", ((1, "active"), (2, "dormant")))]
    assert step(TimeJumped(from_ns=9 * SECOND_NS, to_ns=0)) == []
    assert step(SourceEnded(stamp_ns=0)) == [("request", 3, 2), ("publish", ((1, "active"), (2, "dormant")))]


def test_time_of_observation_confirms_at_every_keyframe_rate():
    # From when until when each is seen, in seconds: two on the way, a glimpse, and one with a long pause.
    times_s = [[(0, 6)], [(1, 3)], [(1, 2.75)], [(0, 0.25), (6, 6)]]

    def confirmed(hz):
        core = MapperCore(CONFIG)
        for i in range(6 * hz + 1):
            is_seen = [any(first <= i / hz <= last for first, last in times) for times in times_s]
            things = [box_surface((0.6 * k, 0, 0.1)) for k in np.flatnonzero(is_seen)]
            drive(core, [frame(i, *[observation(k, points) for k, points in enumerate(things)], stamp_s=i / hz)])
        core.handle(SourceEnded(stamp_ns=6 * SECOND_NS))
        return {round(item.box.center[0] / 0.6): item.sightings for item in core.snapshot().objects}

    assert {hz: confirmed(hz) for hz in (1, 2, 4)} == {hz: {0: 6 * hz + 1, 1: 2 * hz + 1} for hz in (1, 2, 4)}


def test_time_counts_by_how_closed_the_outline_is():
    core = MapperCore(CONFIG)
    for i in range(4):
        drive(core, [frame(i, observation(0, A), replace(observation(1, B), drawn=0.8))])
    assert [item.phase for item in core.snapshot().objects] == [Phase.ACTIVE, Phase.TENTATIVE]
    drive(core, [frame(4, observation(0, B))])
    assert by_id(core.snapshot())[2].phase == Phase.ACTIVE


def test_jumps_and_corrections_have_their_own_decision_kinds():
    core = MapperCore(CONFIG)
    core.handle(TimeJumped(from_ns=9 * SECOND_NS, to_ns=0, kind="loop"))
    core.handle(PoseJumped(stamp_ns=0, after_from_before=from_rotation_translation(np.eye(3), np.array([0.4, 0, 0]))))
    core.handle(PosesCorrected(stamp_ns=0, submap_ids=(0,), world_from_submap=np.eye(4)[None]))
    effects = core.handle(SourceEnded(stamp_ns=SECOND_NS))
    assert kinds(effects, None) == ["time_jump", "pose_jump", "pose_correction"]
    assert last_publish(effects).decisions[1].text == "the odometry jumped by 0.40 m: submap 0 begins"


def test_every_decision_of_the_script_is_told_with_its_reason():
    core = MapperCore(CONFIG)
    effects = drive(core, [frame(i, *both()) for i in range(3)])
    assert kinds(effects, 1) == ["create", "view", "associate", "view", "associate", "phase", "view", "shape"]
    rejected = replace(frame(3), rejected=(RejectedMask(box_px=(1, 2, 3, 4), reason="too small"),))
    (decision,) = last_publish(drive(core, [rejected])).decisions
    assert (decision.kind, decision.object_id) == ("reject", None)
    assert "too small" in decision.text


def test_the_objects_of_the_observations_are_told_in_their_order():
    core = MapperCore(CONFIG)
    drive(core, [frame(0, *both())])
    swapped = [observation(0, B), observation(1, A), observation(2, box_surface((3, 0, 0.1)))]
    assert last_publish(drive(core, [frame(1, *swapped)])).object_ids == (2, 1, 3)


def test_a_request_carries_what_the_job_needs():
    core = MapperCore(CONFIG)
    events = [replace(frame(i, *both()), space=space(floor_z_m=0.0)) for i in range(3)]
    request = requests(drive(core, events, lambda f, i: 0.1 * (f + 1)))[0]
    tracked = core.snapshot().objects[0]
    assert request.due_ns == 2 * SECOND_NS + round(1.5 * SECOND_NS)
    assert request.views[0].name == tracked.best_view.name
    assert {view.name for view in request.views} == {view.name for view in tracked.views}
    assert np.array_equal(request.points_world, tracked.points_world)
    assert not request.points_world.flags.writeable
    assert request.support_z_m == 0.0


def test_a_confirmed_object_has_a_sketch_until_its_shape_comes():
    core = MapperCore(CONFIG)
    drive(core, [frame(i, *both()) for i in range(2)])
    assert {o.sketch for o in core.snapshot().objects} == {None}
    drive(core, [frame(2, *both())])
    for tracked in core.snapshot().objects:
        assert tracked.phase is Phase.ACTIVE
        assert tracked.sketch is not None
        # The boxes of the script are boxes.
        assert np.quantile(np.abs(radial_distance_m(tracked.sketch, tracked.points_world)), 0.9) <= VOXEL_M
        assert volumes_m3(tracked.sketch)[0] == pytest.approx(tracked.box.volume_m3, rel=0.3)
        assert tracked.superquadrics is tracked.sketch
    assert core.handle(shape_ready(2, 2)) == []
    with_shape = by_id(core.snapshot())[2]
    assert with_shape.sketch is None
    assert with_shape.superquadrics is with_shape.shape.fitted
    assert by_id(core.snapshot())[1].sketch is not None


def test_a_sketch_is_made_anew_when_much_more_was_seen():
    core = MapperCore(CONFIG)
    drive(core, [frame(i, observation(0, LEFT)) for i in range(3)])
    first = core.snapshot().objects[0].sketch
    drive(core, [frame(3, observation(0, LEFT))])
    assert core.snapshot().objects[0].sketch is first
    drive(core, [frame(i, observation(0, WHOLE)) for i in range(4, 12)])
    (tracked,) = core.snapshot().objects
    assert tracked.sketch is not None
    assert volumes_m3(tracked.sketch)[0] > 1.5 * volumes_m3(first)[0]


@pytest.mark.parametrize(
    ("ticket", "object_id"), [(99, 1), (2, 1), (1, 77), (1, 1)], ids=["unknown", "another's", "gone", "ended"]
)
def test_the_shape_of_a_ticket_that_is_not_open_is_ignored(ticket, object_id):
    core = MapperCore(CONFIG)
    drive(core, [frame(i, *both()) for i in range(3)])
    core.handle(ShapeFailed(ticket=1, object_id=1, stamp_ns=0, reason="nothing"))
    before = map_digest(core.snapshot())
    assert core.handle(shape_ready(ticket, object_id)) == []
    assert map_digest(core.snapshot()) == before


def halves(core):
    """Three keyframes that see the halves one at a time, and so never apart; both get a shape job."""
    return drive(core, [frame(i, observation(0, LEFT if i % 2 == 0 else RIGHT)) for i in range(6)])


def test_one_frame_over_two_tracks_does_not_merge_them():
    core = MapperCore(CONFIG)
    halves(core)
    before = by_id(core.snapshot())
    drive(core, [frame(6, observation(0, WHOLE))])
    after = by_id(core.snapshot())
    assert list(after) == [1, 2]
    for i in (1, 2):
        assert after[i].box.volume_m3 < 1.3 * before[i].box.volume_m3


def test_a_much_better_view_replaces_the_open_job_once():
    core = MapperCore(CONFIG)
    first = requests(drive(core, [frame(i, observation(0, A, r_area=0.002)) for i in range(3)]))
    assert [request.ticket for request in first] == [1]
    better = told(drive(core, [frame(3, observation(0, A, r_area=0.05))]))
    assert [effect for effect in better if effect[0] in ("cancel", "request")] == [("cancel", 1), ("request", 2, 1)]
    best = told(drive(core, [frame(4, observation(0, A, r_area=1.0))]))
    assert not [effect for effect in best if effect[0] in ("cancel", "request")]
    # What the first job made comes too late.
    assert core.handle(shape_ready(1, 1)) == []
    assert core.snapshot().objects[0].shape is None
    core.handle(shape_ready(2, 1))
    assert core.snapshot().objects[0].shape is not None


def test_halves_often_seen_as_one_merge_and_cancel_the_open_job():
    core = MapperCore(CONFIG)
    tickets = {request.object_id: request.ticket for request in requests(halves(core))}
    assert set(tickets) == {1, 2}
    effects = drive(core, [frame(6 + i, observation(0, WHOLE)) for i in range(3)])
    assert [effect for effect in effects if isinstance(effect, CancelShape)] == [CancelShape(ticket=tickets[2])]
    (one,) = core.snapshot().objects
    assert (one.id, one.merged_ids, one.phase) == (1, (2,), Phase.ACTIVE)
    assert one.box.contains(WHOLE, VOXEL_M).all()
    assert core.handle(shape_ready(tickets[2], 2)) == []
    assert core.snapshot().objects[0].shape is None
    core.handle(shape_ready(tickets[1], 1))
    assert core.snapshot().objects[0].shape is not None


def test_halves_seen_apart_as_often_as_together_stay_two():
    core = MapperCore(replace(CONFIG, merge=MergeConfig(min_together_s=0.75)))
    # One second each: the first keyframe has no time before it.
    apart = [frame(i, observation(0, LEFT), observation(1, RIGHT), stamp_s=0.5 * i) for i in range(3)]
    drive(core, [*apart, *[frame(i, observation(0, WHOLE), stamp_s=0.5 * i) for i in (3, 4)]])
    assert [tracked.id for tracked in core.snapshot().objects] == [1, 2]


def test_what_only_the_map_holds_apart_was_seen_together():
    # The frames by themselves see one thing, and are cut by what the map knew: three such seconds outweigh two.
    cut = [replace(observation(0, LEFT), group=1), replace(observation(1, RIGHT), group=1)]
    core = MapperCore(CONFIG)
    drive(core, [frame(i, observation(0, LEFT), observation(1, RIGHT)) for i in range(3)])
    effects = drive(core, [frame(3 + i, *cut) for i in range(3)])
    told = [d.text for e in effects if isinstance(e, Publish) for d in e.decisions if d.kind == "associate"]
    assert all("this frame alone has it as one with another mask" in text for text in told)
    (one,) = core.snapshot().objects
    assert (one.id, one.merged_ids) == (1, (2,))


def test_a_mistaken_merge_is_undone_with_both_histories():
    core = MapperCore(CONFIG)
    drive(core, [frame(i, observation(0, LEFT), observation(1, RIGHT)) for i in range(3)])
    before = by_id(core.snapshot())[2]
    drive(core, [frame(3 + i, observation(0, WHOLE)) for i in range(4)])
    assert [tracked.id for tracked in core.snapshot().objects] == [1]
    effects = drive(core, [frame(7 + i, observation(0, LEFT), observation(1, RIGHT)) for i in range(12)])
    left, again = core.snapshot().objects
    (split,) = (d for e in effects if isinstance(e, Publish) for d in e.decisions if d.kind == "split")
    assert "it was #2 before that was merged" in split.text
    assert (left.id, again.id) == (1, split.object_id)
    assert again.first_seen_ns == before.first_seen_ns == 0
    assert {view.name for view in before.views} <= {view.name for view in again.views}
    assert {view.object_id for view in again.views} == {again.id}
    assert not {view.name for view in left.views} & {view.name for view in again.views}
    assert np.allclose(left.box.center, LEFT.mean(axis=0), atol=0.01)
    assert np.allclose(again.box.center, RIGHT.mean(axis=0), atol=0.05)  # but for the face that they share


def test_a_host_that_regains_its_part_keeps_its_count():
    # The smaller one was there first: told apart again, it is the part, and the rest is what had been merged into it.
    small = box_surface((-0.02, 0, 0.1), (0.16, 0.2, 0.2))
    core = MapperCore(CONFIG)
    apart = observation(0, small), observation(1, RIGHT)
    drive(core, [frame(i, *apart) for i in range(3)])
    drive(core, [frame(3 + i, observation(0, WHOLE)) for i in range(4)])
    assert [tracked.id for tracked in core.snapshot().objects] == [1]
    is_split = False
    for i in range(7, 19):
        before = by_id(core.snapshot())
        effects = drive(core, [frame(i, *apart)])
        if len(before) == 1 and len(core.snapshot().objects) == 2:
            (split,) = (d for d in last_publish(effects).decisions if d.kind == "split")
            assert "it was #2 before that was merged" in split.text
            # The other mask, the larger one, was one more sighting of what then was both.
            is_split = True
            assert by_id(core.snapshot())[1].sightings == before[1].sightings + 1
    assert is_split
    own, other = core.snapshot().objects
    assert np.allclose(own.box.center, small.mean(axis=0), atol=0.02)
    assert np.allclose(other.box.center, RIGHT.mean(axis=0), atol=0.05)  # but for the face that they share


def test_touching_things_always_seen_apart_stay_two():
    # Five voxels wide: what is within a voxel of the other is a large share of them, and no vote all the same.
    left, right = (box_surface((x, 0, 0.05), (0.1, 0.1, 0.1)) for x in (0, 0.1))
    visible = [points[(points[:, 1] < -0.049) | (points[:, 2] > 0.099)] for points in (left, right)]
    core = MapperCore(CONFIG)
    drive(core, [frame(i, *[observation(k, points) for k, points in enumerate(visible)]) for i in range(12)])
    assert [tracked.id for tracked in core.snapshot().objects] == [1, 2]


def test_the_history_of_a_duplicate_continues_in_the_kept_track():
    core = MapperCore(CONFIG)
    half = A[A[:, 0] < -0.06]
    rest = A[A[:, 0] > 0.06]
    drive(core, [frame(0, observation(0, half)), frame(1, observation(0, rest)), frame(2, observation(0, A))])
    # The whole is matched to neither half by its box alone; once it is seen again and again, all is one.
    effects = drive(core, [frame(3 + i, observation(0, A)) for i in range(5)])
    (one,) = core.snapshot().objects
    assert one.first_seen_ns == 0
    assert one.last_seen_ns == 7 * SECOND_NS
    assert {one.id, *one.merged_ids} == set(range(1, 2 + len(one.merged_ids)))
    assert {view.object_id for view in one.views} == {one.id}
    assert last_publish(effects).object_ids == (one.id,)


def test_an_object_returns_under_its_own_id():
    core = MapperCore(replace(CONFIG, lifecycle=replace(CONFIG.lifecycle, archive_s=20.0)))
    drive(core, [frame(i, observation(0, A)) for i in range(3)])
    phases = []
    for i, seen in [(9, ()), (10, (observation(0, A),)), (40, ()), (41, (observation(0, A),))]:
        drive(core, [frame(i, *seen)])
        phases += [(tracked.id, str(tracked.phase)) for tracked in core.snapshot().objects]
    assert phases == [(1, "dormant"), (1, "active"), (1, "archived"), (1, "active")]


def looked_through(frame_index):
    free = keys_of_points(np.concatenate([A, A + np.float32(0.01)]), CONFIG.voxels.space_m)
    return replace(frame(frame_index), space=space(free=free))


def test_an_object_whose_place_is_seen_through_is_dropped():
    core = MapperCore(CONFIG)
    (request,) = requests(drive(core, [frame(i, observation(0, A)) for i in range(3)]))
    assert told(drive(core, [looked_through(i) for i in (3, 4, 5)])) == [("publish", ((1, "active"),))] * 3
    effects = drive(core, [looked_through(6)])
    assert told(effects) == [("cancel", request.ticket), ("drop", 0), ("publish", ())]
    assert kinds(effects, 1) == ["drop"]


def test_an_object_that_is_seen_again_was_not_looked_through():
    core = MapperCore(CONFIG)
    drive(core, [frame(i, observation(0, A)) for i in range(3)])
    for i in range(3, 12, 3):
        drive(core, [looked_through(i), looked_through(i + 1), frame(i + 2, observation(0, A))])
    assert [tracked.id for tracked in core.snapshot().objects] == [1]


def test_an_object_that_grows_into_a_wall_becomes_a_fixture():
    core = MapperCore(CONFIG)
    wall = box_surface((0, 0, 1.4), (2.8, 0.04, 2.8))
    left, right = wall[wall[:, 0] < 0.3], wall[wall[:, 0] > -0.3]
    drive(core, [frame(0, observation(0, left)), frame(1, observation(0, left)), frame(2, observation(0, right))])
    drive(core, [frame(3, observation(0, wall)), frame(4, observation(0, right))])
    assert [item.kind for item in core.snapshot().objects] == ["fixture"]
    drive(core, [frame(5, observation(0, A + np.float32([0, 3, 0])))])
    assert [item.kind for item in core.snapshot().objects] == ["fixture", "object"]


def test_the_end_drops_tentative_tracks_and_asks_for_all_shapes():
    core = MapperCore(replace(CONFIG, requests=replace(CONFIG.requests, first_sightings=99)))
    places = [box_surface((0.6 * i, 0, 0.1)) for i in range(4)]
    drive(core, [frame(i, *[observation(k, points) for k, points in enumerate(places)]) for i in range(3)])
    drive(core, [frame(3, observation(0, box_surface((0, 3, 0.1))))])
    assert told(core.handle(SourceEnded(stamp_ns=3 * SECOND_NS))) == [
        *[("request", i, i) for i in (1, 2, 3, 4)],
        ("drop", 3),
        ("publish", tuple((i, "active") for i in (1, 2, 3, 4))),
    ]


@pytest.mark.parametrize("to_s", [0, 9999])
def test_a_jump_of_the_stamps_keeps_the_map_and_its_clock(to_s):
    core = MapperCore(CONFIG)
    drive(core, [frame(i, observation(0, A), stamp_s=100 + i) for i in range(3)])
    # Unseen for three seconds before the jump and for one and a half after it: dormant after more than four in all.
    drive(core, [frame(3, stamp_s=105), TimeJumped(from_ns=105 * SECOND_NS, to_ns=to_s * SECOND_NS)])
    unseen = [frame(4 + i, stamp_s=to_s + after_s) for i, after_s in enumerate((0, 0.9, 1.5))]
    phases = ("active", "active", "dormant")
    assert told(drive(core, unseen)) == [("publish", ((1, phase),)) for phase in phases]
    drive(core, [frame(7, observation(0, A), stamp_s=to_s + 2)])
    (tracked,) = core.snapshot().objects
    assert (tracked.id, tracked.phase, tracked.sightings) == (1, Phase.ACTIVE, 4)


def test_features_and_keyframes_out_of_turn_are_refused():
    core = MapperCore(CONFIG)
    with pytest.raises(ValueError, match="features of frame 3 were not asked for"):
        core.handle(FeaturesReady(frame_index=3, features=()))
    core.handle(frame(4, observation(0, A)))
    with pytest.raises(ValueError, match="features of frame 3 were not asked for"):
        core.handle(FeaturesReady(frame_index=3, features=(feature(0, 0.5),)))
    with pytest.raises(ValueError, match="frame 5 came before the features of frame 4"):
        core.handle(frame(5))


@settings(max_examples=20)
@given(
    st.lists(st.tuples(unit_share, unit_share, unit_share, unit_share), min_size=1, max_size=8),
    st.sampled_from(["s_score", "initial", "max_area"]),
)
def test_lazy_features_give_the_same_best_views(factors, strategy):
    core = MapperCore(replace(CONFIG, views=ViewConfig(strategy=strategy)))
    events, variances, scores = [], {}, {1: [], 2: []}
    for i, (area_a, area_b, depth, variance) in enumerate(factors):
        seen = [observation(0, A, r_area=area_a, r_depth=depth), observation(1, B, r_area=area_b, r_depth=1 - depth)]
        events.append(frame(i, *seen))
        for one, s in zip(seen, (variance, 1 - variance), strict=True):
            variances[i, one.index] = s
            all_scores = {
                "s_score": math.log1p(768.0 * s) * one.r_area**0.3 * one.r_depth**0.5,
                "initial": -i,
                "max_area": one.r_area,
            }
            scores[one.index + 1].append(all_scores[strategy])
    effects = drive(core, events, lambda f, i: variances[f, i])
    num_computed = sum(len(e.observation_indices) for e in effects if isinstance(e, ComputeFeatures))
    for tracked in core.snapshot().objects:
        best = max(scores[tracked.id])
        assert tracked.best_view.score == pytest.approx(best, rel=1e-12, abs=1e-15)
        assert tracked.best_view.frame_index == scores[tracked.id].index(best)
    assert dict(last_publish(effects).metrics)["core/features_saved"] == pytest.approx(
        1 - num_computed / (2 * len(factors))
    )


def test_an_endless_look_at_equal_things_does_not_grow_the_map():
    core = MapperCore(CONFIG)

    def size_after(frames):
        last = last_publish(drive(core, [frame(i, *both()) for i in frames]))
        num_points = sum(len(tracked.points_world) for tracked in last.snapshot.objects)
        num_views = sum(len(tracked.views) for tracked in last.snapshot.objects)
        return len(last.snapshot.objects), num_points, num_views, len(last.decisions)

    assert size_after(range(20)) == size_after(range(20, 80))


def test_a_track_keeps_its_best_view_and_one_per_direction():
    core = MapperCore(CONFIG)
    rng = np.random.default_rng(3)
    for i in range(60):
        seen = observation(0, A, r_area=float(rng.uniform(0.01, 0.4)))
        drive(core, [keyframe(i, [seen], angle_rad=0.37 * i)], lambda f, i: (f * 7 % 10) / 10)
    (tracked,) = core.snapshot().objects
    assert len(tracked.views) <= 8 + 1


def test_the_core_is_a_dispatcher_of_fewer_than_250_lines():
    text = inspect.getsource(core)
    assert len(text.splitlines()) < 250
    numbers = [node.value for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Constant)]
    assert [value for value in numbers if type(value) in (int, float) and value not in (0, 1, 3)] == []
