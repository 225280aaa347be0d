"""Which smaller tracks are parts of larger ones by how they are supported: legs, feet and inner parts."""

from __future__ import annotations

import numpy as np

from hickory_stream.mapping.support_relations import is_inner_part, is_leg, is_on_foot
from tests.mapping.mapping_fixtures import box_surface, track


def test_a_panel_between_the_legs_of_a_desk_is_a_part_of_it_unless_it_rests_on_something() -> None:
    top = box_surface((0.0, 0.0, 0.72), (0.6, 1.2, 0.04))
    legs = [box_surface((x, y, 0.35), (0.05, 0.05, 0.7)) for x in (-0.27, 0.27) for y in (-0.57, 0.57)]
    desk = track(1, np.concatenate([top, *legs]))
    panel = track(2, box_surface((-0.27, 0.0, 0.5), (0.02, 1.1, 0.36)))
    assert is_inner_part(panel, desk, [])
    bench = track(3, box_surface((-0.2, 0.0, 0.31), (0.3, 1.3, 0.02)))
    assert not is_inner_part(panel, desk, [bench])


def test_half_of_a_thing_and_what_is_mostly_outside_are_no_parts() -> None:
    box = track(1, box_surface((0.0, 0.0, 0.5), (0.4, 0.4, 1.0)))
    half = track(2, box_surface((0.0, 0.0, 0.65), (0.36, 0.36, 0.7)))
    third = track(4, box_surface((0.0, 0.0, 0.5), (0.28, 0.28, 0.8)))
    beside = track(3, box_surface((0.25, 0.0, 0.5), (0.2, 0.2, 0.2)))
    assert not is_inner_part(half, box, [])
    assert not is_inner_part(beside, box, [])
    assert is_inner_part(third, box, [], was_one=True)
    assert not is_inner_part(third, box, [])


def test_what_stands_on_a_board_of_a_shelf_is_no_part_of_it() -> None:
    boards = [box_surface((0.0, 0.0, z), (0.3, 0.8, 0.02)) for z in (0.05, 0.45, 0.85)]
    sides = [box_surface((0.0, y, 0.45), (0.3, 0.02, 0.9)) for y in (-0.4, 0.4)]
    shelf = track(1, np.concatenate([*boards, *sides]))
    car = track(2, box_surface((0.0, 0.1, 0.51), (0.2, 0.1, 0.1)))
    assert not is_inner_part(car, shelf, [])


def test_what_rests_on_a_third_thing_is_no_part_of_the_one_around_it() -> None:
    seat, back = box_surface((0, 0, 0.45), (0.4, 0.4, 0.04)), box_surface((0.19, 0, 0.75), (0.02, 0.4, 0.24))
    chair = track(1, np.concatenate([seat, back]))
    mug = track(2, box_surface((0.13, 0, 0.65), (0.08, 0.08, 0.1)))
    table = track(3, box_surface((-0.3, 0, 0.575), (0.96, 1.0, 0.04)))
    assert is_inner_part(mug, chair, [])
    assert not is_inner_part(mug, chair, [table])


def test_a_pedestal_is_a_leg_of_the_desk_over_it_and_a_bin_beside_it_is_none() -> None:
    side = box_surface((0.0, -0.59, 0.36), (0.6, 0.02, 0.72))
    desk = track(1, np.concatenate([box_surface((0.0, 0.0, 0.72), (0.6, 1.2, 0.04)), side]))
    assert is_leg(track(2, box_surface((0.0, 0.4, 0.34), (0.4, 0.3, 0.66))), desk)
    assert not is_leg(track(3, box_surface((0.0, 0.8, 0.34), (0.4, 0.3, 0.66))), desk)


def test_a_seat_has_its_foot_under_it_and_a_pot_on_a_counter_does_not() -> None:
    seat = track(1, box_surface((0.0, 0.0, 0.5), (0.46, 0.46, 0.1)))
    star, column = box_surface((0.0, 0.0, 0.05), (0.4, 0.4, 0.08)), box_surface((0.0, 0.0, 0.25), (0.04, 0.04, 0.36))
    foot = track(2, np.concatenate([star, column]))
    assert is_on_foot(seat, foot)
    counter = track(3, box_surface((0.0, 0.0, 0.44), (0.6, 1.4, 0.88)))
    pot = track(4, box_surface((0.0, 0.3, 0.96), (0.22, 0.22, 0.16)))
    assert not is_on_foot(pot, counter)
