from dataclasses import replace
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hickory_stream.events import PosesCorrected
from hickory_stream.geometry.lazy_arrays import has_given_up
from hickory_stream.geometry.rigid import apply, from_rotation_translation, invert, yaw_rotation
from hickory_stream.geometry.voxels import cells_of_keys, centers_of_keys, contains, keys_of_points, sorted_unique
from hickory_stream.mapping.core import MapperCore
from hickory_stream.mapping.entities.observed_space import added, empty_space, structure_of
from hickory_stream.mapping.entities.submaps import SubmapState, first_submap
from hickory_stream.mapping.rules import space_agreement
from hickory_stream.records import SpaceObservation
from tests.mapping.mapping_fixtures import SECOND_NS, drive
from tests.mapping.test_submaps import CONFIG, at

V = 0.05
TURN = from_rotation_translation(yaw_rotation(0.3), np.array([0.02, -0.03, 0.01]))


def block(low, high, step_m=0.02):
    axes = [np.arange(a + step_m / 2, b, step_m) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def space_of(free, wall):
    solid = sorted_unique(keys_of_points(wall, V))
    empty = sorted_unique(keys_of_points(free, V))
    seen = SpaceObservation(
        free_keys=empty[~contains(solid, empty)], structure_keys=solid, surface_keys=solid, floor_z_m=None
    )
    return added(added(empty_space(V), seen, None), seen, None)


ROOM, WALL = block((0, 0, 0), (1, 1, 0.5)), block((1, 0, 0), (1.1, 1, 0.5))
CUPBOARD = block((0.4, 0.4, 0), (0.7, 0.7, 0.5))


def contradicted(space, later, later_from_here):
    outlines = (space_agreement.outline_of(one) for one in (space, later))
    return space_agreement.contradicted(*outlines, later_from_here, V)


def test_only_what_a_later_submap_saw_otherwise_is_contradicted():
    before = space_of(ROOM, np.concatenate([WALL, CUPBOARD]))
    after = space_of(apply(TURN, ROOM), apply(TURN, WALL))
    gone = contradicted(before, after, TURN)
    check_cupboard(centers_of_keys(gone, V).astype(np.float64))
    assert (~contains(gone, structure_of(before))).sum() >= len(np.unique(keys_of_points(WALL, V))), "the wall stays"
    # The other way round: where there was nothing a cupboard stands now.
    come = centers_of_keys(contradicted(after, before, invert(TURN)), V).astype(np.float64)
    check_cupboard(apply(invert(TURN), come))


def check_cupboard(points):
    """Check that voxels are those of the cupboard, but for free ones that the rim of the wall cuts."""
    inside = ((points > [0.39, 0.39, 0]) & (points < [0.71, 0.71, 0.5])).all(axis=1)
    assert (inside | (np.abs(points[:, 0] - 1.0) < V)).all()
    # What stands beside structure may be its rim.
    assert inside.sum() > 0.6 * len(np.unique(keys_of_points(CUPBOARD, V)))


@given(st.integers(0, 1000), st.floats(-3.0, 3.0), st.tuples(st.floats(-1.2, 1.2), st.floats(-1.2, 1.2)))
@settings(max_examples=25)
def test_only_what_lies_where_the_later_one_looked_is_compared(seed, yaw, off):
    rng = np.random.default_rng(seed)
    before, after = (space_of(rng.uniform(-1, 1, (800, 3)), rng.uniform(-1, 1, (300, 3))) for _ in range(2))
    after_from_before = from_rotation_translation(yaw_rotation(yaw), np.array([*off, 0.03]))
    found = contradicted(before, after, after_from_before)

    def there(keys):
        return keys_of_points(apply(after_from_before, centers_of_keys(keys, V).astype(np.float64)), V)

    structure, solid = structure_of(before), structure_of(after)
    near = {tuple(cell + step) for cell in cells_of_keys(solid) for step in np.ndindex(3, 3, 3)}
    is_beside = [tuple(cell + 1) in near for cell in cells_of_keys(there(structure))]
    opened = structure[contains(after.free, there(structure)) & ~np.array(is_beside)]
    filled = before.free[contains(solid, there(before.free))]
    assert found.tolist() == sorted({*opened.tolist(), *filled.tolist()})


def test_nothing_is_contradicted_by_itself_or_unseen():
    space = space_of(ROOM, np.concatenate([WALL, CUPBOARD]))
    assert len(contradicted(space, space, np.eye(4))) == 0
    far = from_rotation_translation(np.eye(3), np.array([5.0, 0.0, 0.0]))
    assert len(contradicted(space, space, far)) == 0
    assert len(contradicted(space, empty_space(V), np.eye(4))) == 0


def walked(*, is_corrected):
    """Two submaps of one place: in the first there is a cupboard, in the second, by odometry that drifted, none."""
    core = MapperCore(CONFIG)
    first, second = space_of(ROOM, np.concatenate([WALL, CUPBOARD])), space_of(apply(TURN, ROOM), apply(TURN, WALL))
    drive(core, [replace(at(i, 0.1 * i), space=_seen(first)) for i in range(3)])
    drive(core, [replace(at(3 + i, 2.0 + 0.1 * i), space=_seen(second)) for i in range(3)])
    if is_corrected:
        core.handle(_placed(invert(TURN)))
    return core


def _seen(space):
    solid = structure_of(space)
    return SpaceObservation(free_keys=space.free, structure_keys=solid, surface_keys=solid, floor_z_m=None)


def _placed(place):
    return PosesCorrected(stamp_ns=20 * SECOND_NS, submap_ids=(0, 1), world_from_submap=np.array([np.eye(4), place]))


def _structure_at(snapshot, points_world):
    """Return in how many submaps there is structure at some of the points."""
    found = 0
    for submap in snapshot.submaps:
        keys = keys_of_points(apply(invert(submap.world_from_submap), points_world), V)
        found += bool(contains(submap.observed_space.structure, keys).any())
    return found


def test_the_later_submap_wins_until_its_placement_is_withdrawn():
    core = walked(is_corrected=False)
    before = core.snapshot()
    inner = block((0.45, 0.45, 0.1), (0.65, 0.65, 0.4))
    assert _structure_at(before, inner) == 1
    core.handle(_placed(invert(TURN)))
    core.validate()
    after = core.snapshot()
    assert _structure_at(after, inner) == 0
    assert _structure_at(after, block((1.03, 0.2, 0.1), (1.07, 0.8, 0.4))) == 2
    core.handle(_placed(np.eye(4)))
    again = core.snapshot()
    for then, now in zip(before.submaps, again.submaps, strict=True):
        assert np.array_equal(then.observed_space.free, now.observed_space.free)
        assert np.array_equal(then.observed_space.structure, now.observed_space.structure)


def test_a_submap_that_ends_later_has_its_word_as_well():
    core = walked(is_corrected=True)
    assert _structure_at(core.snapshot(), WALL) == 2
    gone = space_of(apply(TURN, np.concatenate([ROOM, WALL])), np.empty((0, 3)))
    drive(core, [replace(at(10 + i, 4.0 + 0.1 * i), space=_seen(gone)) for i in range(3)])
    drive(core, [replace(at(14 + i, 6.0 + 0.1 * i), space=_seen(gone)) for i in range(2)])
    core.validate()
    first, *_ = core.snapshot().submaps
    assert not contains(
        first.observed_space.structure, keys_of_points(block((1.0, 0.3, 0.1), (1.04, 0.6, 0.3)), V)
    ).all()


def test_spaces_of_moved_submaps_are_compressed_and_read_briefly():
    core = walked(is_corrected=True)
    first = core.submaps[0]
    assert has_given_up(first.space)
    assert has_given_up(first.seen)
    for place in (np.eye(4), invert(TURN)):
        core.handle(_placed(place))
    assert len(core.snapshot().submaps[0].observed_space.free)
    assert not _is_at_hand(first.seen)
    assert not _is_at_hand(core.submaps[0].space)


@given(st.integers(0, 1000), st.lists(st.sampled_from([np.eye(4), TURN, invert(TURN)]), min_size=2, max_size=6))
@settings(max_examples=25)
def test_later_submaps_contradict_one_by_one_and_as_one(seed, places):
    rng = np.random.default_rng(seed)
    seen = [space_of(rng.uniform(-0.5, 0.5, (400, 3)), rng.uniform(-0.5, 0.5, (60, 3))) for _ in places]
    states = tuple(
        SubmapState(id=i, world_from_submap=place, space=space, seen=space, outdated=np.empty(0, np.int64))
        for i, (place, space) in enumerate(zip(places, seen, strict=True))
    )
    submaps = replace(first_submap(V), states=states)
    found = space_agreement.agreed_after_placement(submaps, submaps).states
    for i, state in enumerate(found):
        pairs = (contradicted(seen[i], seen[j], submaps.between(j, i)) for j in range(i + 1, len(places)))
        assert state.outdated.tolist() == sorted({key for keys in pairs for key in keys.tolist()})
    for j in range(1, len(places)):
        submaps = space_agreement.agreed_after(submaps, j)
    assert [state.outdated.tolist() for state in submaps.states] == [state.outdated.tolist() for state in found]


def _is_at_hand(space):
    try:
        object.__getattribute__(space, "free")
    except AttributeError:
        return False
    return True


def test_a_submap_of_which_only_a_later_one_sees_more_is_shown_by_the_same_record():
    core = walked(is_corrected=True)
    again = _seen(space_of(apply(TURN, ROOM), apply(TURN, WALL)))
    drive(core, [replace(at(10 + i, 4.0 + 0.1 * i), space=again) for i in range(2)])
    *before, _ = core.snapshot().submaps
    owned = core.submaps[1].space
    drive(core, [replace(at(12, 4.3), space=again)])
    assert core.submaps[1].space is not owned
    assert all(now is then for now, then in zip(core.snapshot().submaps[:-1], before, strict=True))


def test_unchanged_outdated_cells_are_the_same_array():
    core = walked(is_corrected=True)
    before, shown = core.submaps[0].outdated, core.snapshot().submaps[0].observed_space
    assert before is not None
    assert len(before)
    core.handle(_placed(invert(TURN)))
    assert core.submaps[0].outdated is before
    assert core.snapshot().submaps[0].observed_space is shown
    other = from_rotation_translation(np.eye(3), np.array([9.0, 0.0, 0.0]))
    core.handle(_placed(other))
    assert core.submaps[0].outdated is not None
    assert len(core.submaps[0].outdated) == 0
    assert core.snapshot().submaps[0].observed_space is not shown
