import numpy as np
from hickory_stream.geometry.boxes import intersection_volume_m3
from hickory_stream.mapping.rules.support_relations import is_inner_part, is_leg, is_on_foot
from tests.mapping.mapping_fixtures import box_surface, track


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


def test_a_pedestal_is_a_leg_of_its_desk_and_a_speaker_is_not():
    side = box_surface((0.0, -0.59, 0.36), (0.6, 0.02, 0.72))
    desk = track(1, np.concatenate([box_surface((0.0, 0.0, 0.72), (0.6, 1.2, 0.04)), side]))
    assert is_leg(track(2, box_surface((0.0, 0.4, 0.34), (0.4, 0.3, 0.66))), desk)
    speaker = track(4, box_surface((0.0, 0.545, 0.4), (0.3, 0.3, 0.8)))
    # An early view took the foot of the speaker for the shelf's.
    foot = box_surface((0.0, 0.55, 0.02), (0.3, 0.3, 0.04))
    shelf = track(3, np.concatenate([box_surface((0.0, 0.0, 0.9), (0.4, 0.8, 1.8)), foot]))
    assert intersection_volume_m3(speaker.box, shelf.box) > 0.9 * speaker.box.volume_m3
    assert not is_leg(speaker, shelf)


def test_a_seat_has_its_foot_and_a_pot_on_a_counter_does_not():
    seat = track(1, box_surface((0.0, 0.0, 0.5), (0.46, 0.46, 0.1)))
    star, column = box_surface((0.0, 0.0, 0.05), (0.4, 0.4, 0.08)), box_surface((0.0, 0.0, 0.25), (0.04, 0.04, 0.36))
    assert is_on_foot(seat, track(2, np.concatenate([star, column])))
    counter = track(3, box_surface((0.0, 0.0, 0.44), (0.6, 1.4, 0.88)))
    assert not is_on_foot(track(4, box_surface((0.0, 0.3, 0.96), (0.22, 0.22, 0.16))), counter)
