import numpy as np
from hickory_stream.shapes.reconstruct.completion import FREE, SOLID, solid_of

INNER = (slice(3, 17), slice(3, 17), slice(3, 17))


def seen_front(top_depth):
    """A block of which the front was seen, and so many layers of the top behind it."""
    states = np.zeros((20, 20, 20), np.uint8)
    states[:, :3, :] = FREE
    states[:, :, 17:] = FREE
    states[3:17, 3:5, 3:17] = SOLID
    states[3:17, 5 : 5 + top_depth, 15:17] = SOLID
    return states


def test_a_front_alone_ends_in_a_closing_face():
    solid = solid_of(seen_front(0), INNER, None, 0)
    assert solid[INNER][:, :2].mean() > 0.9
    assert not solid[:, 7:].any()


def test_front_and_top_continue_to_their_own_edges():
    solid = solid_of(seen_front(8), INNER, None, 0)
    assert solid[4:16, 4:12, 4:16].mean() > 0.95
    assert not solid[:, 14:].any()
    assert not solid[:, :3].any()


def test_a_plate_is_as_thick_as_its_edge():
    states = seen_front(10)
    states[:, 3:5, 3:10] = FREE
    solid = solid_of(states, INNER, None, 0)
    assert solid[5:15, 5:14, 12:15].mean() > 0.95
    assert not solid[5:15, 5:14, :10].any()


def test_a_sloping_front_has_no_wedge_behind_it():
    states = np.zeros((20, 20, 20), np.uint8)
    for z in range(3, 17):
        y = 3 + (z - 3) // 3
        states[:, :y, z] = FREE
        states[3:17, y : y + 2, z] = SOLID
    states[:, :, 17:] = FREE
    assert solid_of(states, INNER, None, 0).sum() < 1.3 * (states == SOLID).sum()


def test_seen_free_space_is_never_filled():
    states = seen_front(10)
    states[3:10, 5:16, 3:15] = FREE
    assert not (solid_of(states, INNER, None, 0) & (states == FREE)).any()


def seen_bed():
    """A slab over the support, layer 3: its sides and top are seen, and free space before and a bit under it."""
    states = np.zeros((40, 40, 30), np.uint8)
    states[:, :4, 3:] = FREE
    states[5:35, 4:35, 20:] = FREE
    states[5:35, 4, 9:20] = SOLID
    states[5:35, 4:35, 19] = SOLID
    states[5, 4:35, 9:20] = states[34, 4:35, 9:20] = SOLID
    states[:, 4:7, 3:9] = FREE
    states[5:8, :, 3:9] = states[32:35, :, 3:9] = FREE
    states[:5] = states[35:] = FREE
    for x in (5, 33):
        states[x : x + 2, 4:6, 3:9] = SOLID
    return states


BED = (slice(5, 35), slice(4, 35), slice(3, 20))


def test_nothing_is_filled_under_a_bed_and_its_feet_stay():
    solid = solid_of(seen_bed(), BED, 3, 3)
    assert not solid[10:30, 10:30, 3:8].any()
    assert solid[10:30, 10:30, 10:19].all()
    assert solid[5:7, 4:6, 3:9].all()


def test_sides_that_reach_the_support_are_filled_down_to_it():
    states = seen_bed()
    states[5:35, 4:35, 3:9] = 0
    states[5:35, 4, 3:9] = states[5, 4:35, 3:9] = states[34, 4:35, 3:9] = SOLID
    assert solid_of(states, BED, 3, 3)[12:28, 12:28, 3:8].mean() > 0.6


def test_a_gap_that_no_view_saw_is_bridged_to_the_support():
    states = seen_bed()
    states[:, :, 3:9] = 0
    assert solid_of(states, BED, 3, 6)[12:28, 12:28, 3:8].mean() > 0.9
