"""Which of the space that nobody saw belongs to an object."""

import numpy as np
from hickory_stream.shapes.reconstruct.completion import FREE, SOLID, solid_of

INNER = (slice(3, 17), slice(3, 17), slice(3, 17))


def seen_front(free_depth: int) -> np.ndarray:
    """A block of which the front was seen, and `free_depth` layers of nothing beside its box's left half."""
    states = np.zeros((20, 20, 20), np.uint8)
    states[:, :3, :] = FREE
    states[3:17, 3:5, 3:17] = SOLID
    states[3:10, 5 : 5 + free_depth, 3:17] = FREE
    return states


def test_a_box_seen_from_the_front_is_filled_behind():
    solid = solid_of(seen_front(0), INNER, None, 0)
    assert solid[INNER][1:-1, 1:8, 1:-1].mean() > 0.95
    assert solid[INNER][1:-1, 1:-1, 1:-1].mean() > 0.75
    assert not solid[:, :3].any()


def test_seen_free_space_limits_the_filling():
    states = seen_front(11)
    solid = solid_of(states, INNER, None, 0)
    assert not (solid & (states == FREE)).any()
    assert solid[INNER].mean() < 0.45


def seen_bed() -> np.ndarray:
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
    states = seen_bed()
    solid = solid_of(states, BED, 3, 3, is_wide=True)
    assert not solid[10:30, 10:30, 3:8].any()
    assert solid[10:30, 10:30, 10:19].all()
    assert solid[5:7, 4:6, 3:9].all()


def test_a_narrow_or_many_footed_shape_is_filled_to_the_support():
    narrow = solid_of(seen_bed(), BED, 3, 3, is_wide=False)
    assert narrow[12:28, 12:28, 3:8].mean() > 0.6
    states = seen_bed()
    states[5:35, 4, 3:9] = states[5, 4:35, 3:9] = states[34, 4:35, 3:9] = SOLID
    closed = solid_of(states, BED, 3, 3, is_wide=True)
    assert closed[12:28, 12:28, 3:8].mean() > 0.6
