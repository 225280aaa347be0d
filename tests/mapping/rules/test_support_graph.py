import numpy as np
import pytest
from hickory_stream.geometry.boxes import intersection_volume_m3
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.voxels import keys_of_points
from hickory_stream.mapping.entities.observed_space import add, as_record, empty_space, known_space
from hickory_stream.mapping.rules.support_graph import Relation, Support, SupportGraph, attachment_of
from hickory_stream.mapping.rules.support_relations import is_inner_part, is_leg, is_on_foot
from tests.mapping.mapping_fixtures import box_surface, graph_of, space, track

SPACE_M = 0.05


def table(track_id=1):
    """A table whose top is at 0.74 m."""
    legs = [box_surface((x, y, 0.35), (0.06, 0.06, 0.7)) for x in (-0.5, 0.5) for y in (-0.3, 0.3)]
    return track(track_id, np.concatenate([box_surface((0, 0, 0.72), (1.2, 0.8, 0.04)), *legs]))


def mug(bottom_m, x=0.2, track_id=2):
    return track(track_id, box_surface((x, 0.1, bottom_m + 0.05), (0.08, 0.08, 0.1)))


def room(*, free=True, wall_x_m=0.9):
    """A room with its floor at 0 that is free, if one looked, up to a wall."""
    steps = np.arange(-1.0, 1.0, 0.025)
    grid = np.stack(np.meshgrid(steps, steps, np.arange(0.1, 1.5, 0.025), indexing="ij"), axis=-1).reshape(-1, 3)
    is_wall = np.abs(grid[:, 0] - wall_x_m) < 0.02
    open_keys, wall = (keys_of_points(points.astype(np.float32), SPACE_M) for points in (grid[~is_wall], grid[is_wall]))
    seen = space(free=open_keys if free else None, structure=wall, floor_z_m=0.0)
    return add(add(empty_space(SPACE_M), seen), seen)


def on(body, *others, floor_z_m=0.0):
    return graph_of([body, *others], floor_z_m=floor_z_m).rests_on(body)


def test_a_body_rests_on_the_highest_one_under_it_or_the_floor():
    found = on(mug(0.74), table())
    assert (found.body, found.relation, found.by) == (2, Relation.RESTS_ON, 1)
    assert found.height_m == pytest.approx(0.74, abs=0.01)
    assert on(mug(0.78), table()).height_m == pytest.approx(0.74, abs=0.01)  # partly seen
    assert on(mug(0.74, x=0.9), table()) is None
    found = on(mug(0.77), table(), track(3, box_surface((0.2, 0.1, 0.755), (0.3, 0.3, 0.03))))
    assert (found.by, found.height_m) == (3, pytest.approx(0.77, abs=0.01))
    found = on(table(), mug(0.74), floor_z_m=-0.02)
    assert found == Support(body=1, relation=Relation.RESTS_ON, by=None, height_m=-0.02)
    assert on(track(3, box_surface((0, 0, 2.0))), table()) is None
    assert on(table(), floor_z_m=None) is None


POT = track(1, box_surface((0.0, 0.0, 0.3), (0.3, 0.3, 0.6)))
BRANCH = track(2, box_surface((0.32, 0.0, 0.75), (0.16, 0.12, 0.12)))
PICTURE = track(3, box_surface((0.86, 0.0, 1.0), (0.04, 0.4, 0.3)))


def test_a_branch_hangs_from_its_pot_and_a_picture_leans():
    graph = graph_of([POT, BRANCH, PICTURE], room())
    assert graph.hangs_from(BRANCH) == Support(body=2, relation=Relation.HANGS_FROM, by=1)
    assert graph.hangs_from(BRANCH, [PICTURE]) is None
    assert graph.hangs_from(POT) is None
    assert graph.leans_on(PICTURE) == Support(body=3, relation=Relation.LEANS_ON, by=None)
    assert graph.leans_on(BRANCH) is None
    assert graph.hangs_from(PICTURE) is None


def test_a_space_that_was_saved_supports_as_it_did():
    saved = known_space(as_record(room()))
    before, after = (graph_of([POT, BRANCH, PICTURE], state).edges() for state in (room(), saved))
    assert before == after


SEAT = track(1, box_surface((0.0, 0.0, 0.5), (0.46, 0.46, 0.1)))
FOOT = track(
    2, np.concatenate([box_surface((0, 0, 0.05), (0.4, 0.4, 0.08)), box_surface((0, 0, 0.25), (0.04, 0.04, 0.36))])
)
DESK = track(
    3, np.concatenate([box_surface((0, 0, 0.72), (0.6, 1.2, 0.04)), box_surface((0, -0.59, 0.36), (0.6, 0.02, 0.72))])
)
PEDESTAL = track(4, box_surface((0.0, 0.4, 0.34), (0.4, 0.3, 0.66)))


@pytest.mark.parametrize(("a", "b"), [(SEAT, FOOT), (FOOT, SEAT)])
def test_the_foot_is_part_of_the_seat_whichever_is_named_first(a, b):
    expected = Support(body=2, relation=Relation.PART_OF, by=1, reason="the lower is the foot of the upper")
    assert graph_of([SEAT, FOOT]).foot_of(a, b) == expected


def test_a_pedestal_is_part_of_the_desk_that_hides_its_upper_end():
    graph = graph_of([DESK, PEDESTAL])
    part = graph.part_of(PEDESTAL, DESK, [])
    assert (part.body, part.by, part.reason) == (4, 3, "the smaller stands under the larger like a leg")
    assert graph.hidden_by(PEDESTAL, DESK) == Support(body=4, relation=Relation.HIDDEN_BY, by=3)


def test_a_mug_on_a_table_is_neither_part_of_it_nor_hidden_by_it():
    graph = graph_of([table(), mug(0.74)])
    assert graph.part_of(mug(0.74), table(), [table()]) is None
    assert graph.hidden_by(mug(0.74), table()) is None


def test_a_former_part_stays_a_part_unless_it_rests_on_something():
    panel = track(5, box_surface((-0.27, 0.0, 0.5), (0.02, 1.0, 0.36)))
    graph = graph_of([DESK, panel])
    assert graph.still_part_of(panel, DESK, []) is not None
    board = track(6, box_surface((-0.27, 0.0, 0.29), (0.3, 1.2, 0.06)))
    assert graph.still_part_of(panel, DESK, [board]) is None


def test_the_edges_of_a_room_equal_those_asked_one_by_one():
    graph = graph_of([table(), mug(0.74)], floor_z_m=0.0)
    table_edge, mug_edge = graph.edges()
    assert (table_edge.body, table_edge.relation, table_edge.by) == (1, Relation.RESTS_ON, None)
    assert mug_edge == graph.rests_on(mug(0.74))
    assert graph.edges([2]) == (mug_edge,)
    whole = graph_of([SEAT, FOOT, *(track(i, apply(SHIFT, t.solid.points)) for i, t in ((3, DESK), (4, PEDESTAL)))])
    found = {(edge.body, edge.relation, edge.by) for edge in whole.edges()}
    assert found == {
        (1, Relation.RESTS_ON, 2),
        (2, Relation.PART_OF, 1),
        (4, Relation.PART_OF, 3),
        (4, Relation.HIDDEN_BY, 3),
    }


SHIFT = np.eye(4)
SHIFT[0, 3] = 3.0


def test_the_graph_follows_the_bodies_that_it_was_made_of():
    bodies = {1: table(), 2: mug(0.74)}
    graph = graph_of(bodies, floor_z_m=0.0)
    assert isinstance(graph, SupportGraph)
    del bodies[1]
    assert graph.rests_on(bodies[2]) is None


def test_a_branch_in_the_air_belongs_to_the_nearest_thing():
    host = attachment_of(BRANCH, [POT, BRANCH, track(3, box_surface((0.8, 0.0, 0.3), (0.2, 0.2, 0.6)))], room())
    assert host.id == POT.id


@pytest.mark.parametrize(
    ("body", "others", "state"),
    [
        (BRANCH, [POT, track(3, box_surface((0.32, 0.0, 0.34), (0.3, 0.3, 0.68)))], room()),
        (BRANCH, [POT], room(wall_x_m=0.42)),
        (BRANCH, [POT], room(free=False)),
        (BRANCH, [track(3, box_surface((0.8, 0.0, 0.3), (0.2, 0.2, 0.6)))], room()),
        (track(2, box_surface((0.3, 0.0, 0.2), (0.2, 0.2, 0.1))), [POT], room()),
    ],
    ids=["it stands on something", "it hangs on a wall", "nobody saw what is below", "nothing is near", "the floor is"],
)
def test_a_supported_or_lone_track_stays_itself(body, others, state):
    assert attachment_of(body, [*others, body], state) is None


def test_a_panel_between_legs_is_a_part_and_a_bin_there_is_not():
    top = box_surface((0.0, 0.0, 0.72), (0.6, 1.2, 0.04))
    legs = [box_surface((x, y, 0.35), (0.05, 0.05, 0.7)) for x in (-0.27, 0.27) for y in (-0.57, 0.57)]
    desk = track(1, np.concatenate([top, *legs]))
    panel = track(2, box_surface((-0.27, 0.0, 0.5), (0.02, 1.1, 0.36)))
    bin_ = track(3, box_surface((0.0, 0.0, 0.15), (0.25, 0.25, 0.3)))
    assert is_inner_part(panel, desk, [])
    assert not is_inner_part(bin_, desk, [])


def test_what_stands_on_a_board_of_a_shelf_is_no_part_of_it():
    boards = [box_surface((0.0, 0.0, z), (0.3, 0.8, 0.02)) for z in (0.05, 0.45, 0.85)]
    sides = [box_surface((0.0, y, 0.45), (0.3, 0.02, 0.9)) for y in (-0.4, 0.4)]
    shelf = track(1, np.concatenate([*boards, *sides]))
    assert not is_inner_part(track(2, box_surface((0.0, 0.1, 0.51), (0.2, 0.1, 0.1))), shelf, [])


def test_what_goes_on_upwards_beside_a_patch_is_no_support_of_it():
    # The side of a car goes on around its lamp; behind a box on a shelf there is a back, but before it there is room.
    car = track(1, box_surface((0.0, 0.0, 0.8), (4.0, 1.8, 1.2)))
    lamp = track(2, box_surface((2.0, 0.4, 0.8), (0.06, 0.3, 0.3)))
    assert is_inner_part(lamp, car, [])
    shelf = track(1, np.concatenate([
        box_surface((0.0, 0.0, 0.45), (0.3, 0.8, 0.02)), box_surface((-0.15, 0.0, 0.9), (0.02, 0.8, 0.9)),
    ]))  # fmt: skip
    assert not is_inner_part(track(2, box_surface((-0.02, 0.0, 0.61), (0.2, 0.2, 0.3))), shelf, [])


def test_a_pedestal_is_a_leg_of_its_desk_and_a_speaker_is_not():
    assert is_leg(PEDESTAL, DESK)
    speaker = track(4, box_surface((0.0, 0.545, 0.4), (0.3, 0.3, 0.8)))
    # An early view took the foot of the speaker for the shelf's.
    foot = box_surface((0.0, 0.55, 0.02), (0.3, 0.3, 0.04))
    shelf = track(3, np.concatenate([box_surface((0.0, 0.0, 0.9), (0.4, 0.8, 1.8)), foot]))
    assert intersection_volume_m3(speaker.box, shelf.box) > 0.9 * speaker.box.volume_m3
    assert not is_leg(speaker, shelf)


def test_a_seat_has_its_foot_and_a_pot_on_a_counter_does_not():
    assert is_on_foot(SEAT, FOOT)
    counter = track(3, box_surface((0.0, 0.0, 0.44), (0.6, 1.4, 0.88)))
    assert not is_on_foot(track(4, box_surface((0.0, 0.3, 0.96), (0.22, 0.22, 0.16))), counter)
