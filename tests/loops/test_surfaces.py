import numpy as np
from hickory_stream.loops.surfaces import registered
from tests.loops.loop_fixtures import air, off, room, shift, surface
from tools.evaluation.simulated_maps.loop_rooms import patch

DRIFT = shift(0.12, -0.08, 0.02, yaw_deg=3.0)


def test_a_room_seen_again_registers_to_a_centimetre():
    later = surface(room(), own_from_world=DRIFT, free=None, seed=1)
    fit = registered(surface(room()), later, np.eye(4), 0.3)
    way_m, angle_deg = off(fit.earlier_from_later, DRIFT)
    assert way_m < 0.015
    assert angle_deg < 0.3
    sigma_m = float(np.sqrt(np.trace(fit.covariance[3:, 3:])))
    assert 0.3 * way_m < sigma_m < 0.05
    assert fit.agreement > 0.95


def test_the_two_sides_of_a_wall_are_never_one_surface():
    thickness_m = 0.1
    here = [*room()[:1], patch([0, 3, 0], [4, 0, 0], [0, 0, 2], [0, -1, 0]), *room()[5:]]
    behind = [*room()[:1], patch([0, 3 + thickness_m, 0], [4, 0, 0], [0, 0, 2], [0, 1, 0]), *room()[5:]]
    fit = registered(surface(here), surface(behind, own_from_world=DRIFT, seed=1), np.eye(4), 0.3)
    assert off(fit.earlier_from_later, DRIFT)[0] < 0.3 * thickness_m


def test_along_a_bare_corridor_the_covariance_stays_wide():
    corridor = [
        patch([0, 0, 0], [8, 0, 0], [0, 1.5, 0], [0, 0, 1]),
        patch([0, 0, 0], [8, 0, 0], [0, 0, 2], [0, 1, 0]),
        patch([0, 1.5, 0], [8, 0, 0], [0, 0, 2], [0, -1, 0]),
    ]
    fit = registered(
        surface(corridor), surface(corridor, own_from_world=shift(0.0, 0.06), seed=1), shift(0.3, 0.0), 0.3
    )
    along_m, across_m, _ = fit.earlier_from_later[:3, 3]
    assert abs(along_m - 0.3) < 0.01
    assert abs(across_m + 0.06) < 0.02
    assert np.sqrt(np.linalg.eigvalsh(fit.covariance[3:, 3:])[-1]) > 1.0


def test_surface_in_free_space_of_the_other_speaks_against_a_fit():
    earlier, later = surface(room(), free=air()), surface(room(), seed=1, free=air())
    right = registered(earlier, later, np.eye(4), 0.3)
    assert right.agreement > 0.95
    empty = surface([*room()[:5]], free=air())
    moved = registered(empty, surface(room(), free=air(), seed=2), np.eye(4), 0.3)
    assert moved.agreement < right.agreement
    assert moved.num_known > moved.num_met


def test_where_no_surface_is_near_nothing_is_known():
    fit = registered(surface(room()), surface(room(), seed=1), shift(50.0, 0.0, 0.0), 0.3)
    assert fit.num_met == 0
    assert fit.agreement == 0.0
    assert np.allclose(fit.earlier_from_later, shift(50.0, 0.0, 0.0))
    assert np.linalg.eigvalsh(fit.covariance)[0] > 1.0


def test_the_same_surfaces_give_the_same_bytes():
    fits = [
        registered(surface(room()), surface(room(), own_from_world=DRIFT, seed=1), np.eye(4), 0.5) for _ in range(2)
    ]
    assert fits[0].earlier_from_later.tobytes() == fits[1].earlier_from_later.tobytes()
    assert fits[0].covariance.tobytes() == fits[1].covariance.tobytes()
