"""Which of the space that nobody saw belongs to an object."""

import numpy as np

from hickory_stream.shapes.complete import FREE, SOLID, CompletionConfig, solid_of

CONFIG = CompletionConfig()
INNER = (slice(3, 17), slice(3, 17), slice(3, 17))


def seen_front(free_depth: int) -> np.ndarray:
    """A block of which the front was seen, and `free_depth` layers of nothing beside its box's left half."""
    states = np.zeros((20, 20, 20), np.uint8)
    states[:, :3, :] = FREE
    states[3:17, 3:5, 3:17] = SOLID
    states[3:10, 5 : 5 + free_depth, 3:17] = FREE
    return states


def test_a_box_of_which_only_the_front_was_seen_is_full() -> None:
    solid = solid_of(seen_front(0), INNER, None, 0, CONFIG)
    assert solid[INNER][1:-1, 1:-1, 1:-1].all()
    assert not solid[:, :3].any()


def test_where_much_was_seen_free_what_hides_behind_the_front_is_not_filled_to_the_end() -> None:
    states = seen_front(11)
    solid = solid_of(states, INNER, None, 0, CONFIG)
    assert (states[INNER] != FREE).mean() < CONFIG.full_share
    assert not (solid & (states == FREE)).any()
    assert solid[INNER].mean() < 0.45
