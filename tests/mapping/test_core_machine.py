from copy import deepcopy
import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from hickory_stream import events
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.geometry.voxels import keys_of_points
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.core import MapperCore
from hickory_stream.mapping.rules.lifecycle import LifecycleConfig
from hickory_stream.mapping.rules.merging import MergeConfig
from hickory_stream.mapping.rules.shape_requests import RequestConfig
from tests.mapping import mapping_fixtures
from tests.strategies import unit_share

MAX_IN_FLIGHT = 2
CONFIG = MappingConfig(
    voxels=Lattice(object_m=mapping_fixtures.VOXEL_M),
    lifecycle=LifecycleConfig(confirm_s=1.0, tentative_s=3.0, dormant_s=2.0, archive_s=6.0, phantom_s=2.0),
    merge=MergeConfig(min_together_s=1.5),
    requests=RequestConfig(
        max_in_flight=MAX_IN_FLIGHT, first_sightings=2, min_gain=0.2, interval_s=1.0, max_failures=2
    ),
)


def points_at(site, kind, shift_m):
    """A box at one of four neighbouring places, half of it, or the box and its neighbour as one."""
    if kind == "pair":
        return mapping_fixtures.box_surface((0.22 * site + 0.11 + shift_m, 0, 0.1), (0.42, 0.2, 0.2))
    points = mapping_fixtures.box_surface((0.22 * site + shift_m, 0, 0.1))
    return points[points[:, 0] < 0.22 * site] if kind == "half" else points


sightings = st.lists(
    st.tuples(
        st.integers(0, 3), st.sampled_from(["box", "box", "box", "half", "pair"]),
        st.sampled_from([-0.01, 0.0, 0.0, 0.015]), unit_share, unit_share,
    ),
    max_size=3, unique_by=lambda sighting: sighting[0],
)  # fmt: skip


def arrays_of(value):
    """Every array within a record, however deep."""
    if isinstance(value, np.ndarray):
        return [value]
    if isinstance(value, tuple):
        return [array for item in value for array in arrays_of(item)]
    names = getattr(type(value), "__slots__", ())
    return [array for name in names if hasattr(value, name) for array in arrays_of(getattr(value, name))]


class CoreUnderRandomEvents(RuleBasedStateMachine):
    def __init__(self):
        super().__init__()
        self.core = MapperCore(CONFIG)
        self.events = []
        self.effects = []
        self.published = []
        self.open = {}
        self.kept = set()
        self.dropped = set()
        self.num_frames = 0
        self.stamp_ns = 0

    def tell(self, event):
        effects = self.core.handle(event)
        self.core.validate()
        self.events.append(event)
        self.effects += effects
        for effect in effects:
            self.note(effect)
        return effects

    def note(self, effect):
        match effect:
            case events.KeepView(view=view):
                assert view.name not in self.kept
                self.kept.add(view.name)
            case events.DropView(name=name):
                assert name in self.kept - self.dropped
                self.dropped.add(name)
            case events.RequestShape():
                assert effect.object_id not in self.open.values()
                assert {view.name for view in effect.views} <= self.kept - self.dropped
                self.open[effect.ticket] = effect.object_id
            case events.CancelShape(ticket=ticket):
                del self.open[ticket]
            case events.Publish(snapshot=snapshot):
                self.published.append((snapshot, map_digest(snapshot)))

    # ---- what happens -----------------------------------------------------------------------------------------------

    @rule(
        seen=sightings, gap_s=st.sampled_from([0.25, 1.0, 5.0]), angle_rad=st.floats(0, 6),
        looked_through=st.sampled_from([None, None, 0, 1, 2, 3]),
    )  # fmt: skip
    def a_keyframe_comes(self, seen, gap_s, angle_rad, looked_through):
        self.stamp_ns += round(gap_s * mapping_fixtures.SECOND_NS)
        shown = [
            mapping_fixtures.observation(i, points_at(site, kind, shift), r_area=area)
            for i, (site, kind, shift, area, _) in enumerate(seen)
        ]
        free = None
        if looked_through is not None:
            free = keys_of_points(points_at(looked_through, "box", 0.0), CONFIG.voxels.space_m)
        event = mapping_fixtures.keyframe(
            self.num_frames, shown, stamp_ns=self.stamp_ns, seen=mapping_fixtures.space(free=free), angle_rad=angle_rad
        )
        self.num_frames += 1
        effects = self.tell(event)
        if isinstance(effects[-1], events.ComputeFeatures):
            asked = effects[-1]
            features = tuple(mapping_fixtures.feature(i, seen[i][4]) for i in asked.observation_indices)
            effects = self.tell(events.FeaturesReady(frame_index=asked.frame_index, features=features))
        assert len(effects[-1].object_ids) == len(seen)

    @precondition(lambda self: self.open)
    @rule(which=st.integers(0, 10), is_ready=st.booleans())
    def a_shape_job_ends(self, which, is_ready):
        ticket = sorted(self.open)[which % len(self.open)]
        object_id = self.open.pop(ticket)
        if is_ready:
            self.tell(mapping_fixtures.shape_ready(ticket, object_id))
            assert {o.id: o for o in self.core.snapshot().objects}[object_id].shape is not None
        else:
            self.tell(
                events.ShapeFailed(ticket=ticket, object_id=object_id, stamp_ns=self.stamp_ns, reason="no points")
            )

    @precondition(lambda self: self.num_frames > 0)
    @rule(to_s=st.sampled_from([0, 10_000]))
    def the_stamps_jump(self, to_s):
        before = [tracked.id for tracked in self.core.snapshot().objects]
        self.tell(events.TimeJumped(from_ns=self.stamp_ns, to_ns=to_s * mapping_fixtures.SECOND_NS))
        self.stamp_ns = to_s * mapping_fixtures.SECOND_NS
        assert [tracked.id for tracked in self.core.snapshot().objects] == before

    @precondition(lambda self: self.num_frames > 0)
    @rule(by_m=st.sampled_from([0.05, 0.4]))
    def the_odometry_jumps(self, by_m):
        jump = np.eye(4)
        jump[0, 3] = by_m
        before = [tracked.id for tracked in self.core.snapshot().objects]
        assert self.tell(events.PoseJumped(stamp_ns=self.stamp_ns, after_from_before=jump)) == []
        assert [tracked.id for tracked in self.core.snapshot().objects] == before

    @rule(which=st.integers(0, 10), by_m=st.sampled_from([0.0, 0.3]))
    def a_submap_is_placed_anew(self, which, by_m):
        place = np.eye(4)
        place[1, 3] = by_m
        submap_id = which % len(self.core.snapshot().submaps)
        (published,) = self.tell(
            events.PosesCorrected(stamp_ns=self.stamp_ns, submap_ids=(submap_id,), world_from_submap=place[None])
        )
        assert np.array_equal(published.snapshot.submaps[submap_id].world_from_submap, place)

    @rule()
    def the_core_goes_on_from_its_state(self):
        before = map_digest(self.core.snapshot())
        self.core = MapperCore.from_state(CONFIG, self.core.state())
        self.core.validate()
        assert map_digest(self.core.snapshot()) == before

    # ---- what always holds ------------------------------------------------------------------------------------------

    @invariant()
    def ids_are_unique_sorted_and_not_those_that_were_merged(self):
        objects = self.core.snapshot().objects
        ids = [tracked.id for tracked in objects]
        assert ids == sorted(set(ids))
        merged = [gone for tracked in objects for gone in tracked.merged_ids]
        assert len(merged) == len(set(merged))
        assert not set(ids) & set(merged)

    @invariant()
    def every_view_that_is_referred_to_was_kept_and_not_dropped(self):
        for tracked in self.core.snapshot().objects:
            assert {view.name for view in tracked.views} <= self.kept - self.dropped
            if tracked.best_view is not None:
                assert any(view is tracked.best_view for view in tracked.views)
            assert all(view.object_id == tracked.id for view in tracked.views)

    @invariant()
    def every_kept_view_is_either_needed_or_dropped(self):
        referred = {view.name for tracked in self.core.snapshot().objects for view in tracked.views}
        assert referred <= self.core.view_names()
        assert self.kept - self.dropped == self.core.view_names()

    @invariant()
    def no_more_jobs_are_open_than_allowed_and_only_for_objects_that_are_there(self):
        assert len(self.open) <= MAX_IN_FLIGHT
        assert set(self.open.values()) <= {tracked.id for tracked in self.core.snapshot().objects}

    @invariant()
    def a_box_contains_most_of_the_points_and_sightings_are_in_order(self):
        for tracked in self.core.snapshot().objects:
            assert tracked.box.contains(tracked.points_world, 1e-5).mean() >= 0.7
            assert tracked.sightings >= 1

    @invariant()
    def nothing_that_is_shown_can_be_written_to(self):
        arrays = arrays_of(self.core.snapshot())
        assert arrays
        assert not any(array.flags.writeable for array in arrays)

    @invariant()
    def memory_is_bounded_by_the_surface(self):
        # All that can ever be seen is 1.1 m of a row of boxes: its voxels, once for each object.
        num_cells = (1.2 / mapping_fixtures.VOXEL_M) * (0.24 / mapping_fixtures.VOXEL_M) ** 2
        assert all(len(tracked.points_world) <= num_cells for tracked in self.core.snapshot().objects)
        assert all(len(tracked.views) <= 8 + 1 for tracked in self.core.snapshot().objects)

    def teardown(self):
        self.the_end_asks_for_what_is_missing()
        assert all(map_digest(snapshot) == digest for snapshot, digest in self.published)
        self.the_same_events_give_the_same_effects()

    def the_end_asks_for_what_is_missing(self):
        self.tell(events.SourceEnded(stamp_ns=self.stamp_ns))
        self.every_view_that_is_referred_to_was_kept_and_not_dropped()
        self.every_kept_view_is_either_needed_or_dropped()
        failed = [event.object_id for event in self.events if isinstance(event, events.ShapeFailed)]
        for tracked in self.core.snapshot().objects:
            assert tracked.phase != "tentative"
            has_or_gets_one = tracked.shape is not None or tracked.id in self.open.values()
            assert has_or_gets_one or failed.count(tracked.id) >= CONFIG.requests.max_failures

    def the_same_events_give_the_same_effects(self):
        again = MapperCore(CONFIG)
        effects = [effect for event in self.events for effect in again.handle(deepcopy(event))]
        assert mapping_fixtures.told(effects) == mapping_fixtures.told(self.effects)
        digests = [map_digest(effect.snapshot) for effect in effects if isinstance(effect, events.Publish)]
        assert digests == [digest for _, digest in self.published]


CoreUnderRandomEvents.TestCase.settings = settings(
    max_examples=25, stateful_step_count=18, suppress_health_check=[HealthCheck.too_slow]
)
TestTheCoreKeepsItsInvariantsUnderRandomEvents = CoreUnderRandomEvents.TestCase
