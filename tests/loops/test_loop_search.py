from dataclasses import replace
import numpy as np
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import apply, compose, from_rotation_translation, invert, yaw_rotation
from hickory_stream.loops import search
from hickory_stream.loops.config import LoopConfig
from hickory_stream.loops.predictions import Predicted
from hickory_stream.loops.search import LoopQuery, search_loops
from hickory_stream.loops.surfaces import refined, registered
from hickory_stream.records import Keypoints, MapSnapshot
from tests.alignment.map_fixtures import frame, furniture, snapshot_of
from tests.loops.loop_fixtures import air, off, room, shift, surface
from tools.evaluation.simulated_maps.loop_rooms import box, patch

DRIFT = shift(0.12, -0.08, 0.02, yaw_deg=3.0)
CONFIG = LoopConfig()


def query(earlier, later, *, predicted=None, sigma_m=0.08, snapshot=None):
    known = Predicted(
        earlier_from_later=np.eye(4) if predicted is None else predicted, sigma_m=sigma_m, sigma_yaw_rad=0.02
    )
    return LoopQuery(later_id=3, surfaces={0: earlier, 3: later}, predicted={0: known}, snapshot=snapshot)


def test_a_room_that_is_entered_again_is_a_loop():
    (loop,) = search_loops(query(surface(room(), free=air()), surface(room(), own_from_world=DRIFT, seed=1)), CONFIG)
    assert (loop.earlier, loop.later, loop.method, loop.reason) == (0, 3, "surface", None)
    assert off(loop.earlier_from_later, DRIFT)[0] < 0.015


def test_another_room_and_too_little_surface_make_no_loop():
    elsewhere = surface(room(), own_from_world=shift(9.0, 0.0), seed=1)
    assert search_loops(query(surface(room()), elsewhere), CONFIG) == ()
    few = surface([patch([0, 0, 0], [0.5, 0, 0], [0, 0.5, 0], [0, 0, 1])])
    assert search_loops(query(surface(room()), few), CONFIG) == ()


def test_like_things_in_a_row_are_told_to_fit_elsewhere_as_well():
    floor = patch([-2, 0, 0], [10, 0, 0], [0, 3, 0], [0, 0, 1])
    wall = patch([-2, 3, 0], [10, 0, 0], [0, 0, 2], [0, -1, 0])
    row = [floor, wall, *(side for i in range(10) for side in box(-1.0 + 0.6 * i, 1.0, 0.3, 0.5))]
    (loop,) = search_loops(query(surface(row), surface(row, seed=1), sigma_m=0.4), CONFIG)
    assert "fits elsewhere" in loop.reason


def test_starts_that_come_to_one_place_are_refined_once(monkeypatch):
    starts = []

    def counted(earlier, later, predicted, near):
        starts.append(predicted)
        return refined(earlier, later, predicted, near)

    monkeypatch.setattr(search, "refined", counted)
    again = surface(room(), own_from_world=DRIFT, seed=1)
    (loop,) = search_loops(query(surface(room(), free=air()), again, sigma_m=0.15), CONFIG)
    assert loop.reason is None
    assert off(loop.earlier_from_later, DRIFT)[0] < 0.015
    assert len(starts) == 1


def test_what_lies_in_free_space_is_no_loop():
    empty = surface(room()[:5], free=air())
    full = [*room()[:5], *(side for i in range(5) for side in box(0.2 + 0.7 * i, 0.3 + 0.5 * (i % 2), 0.5, 1.8))]
    (loop,) = search_loops(query(empty, surface(full, seed=1)), replace(CONFIG, min_agreement=0.9))
    assert "free space" in loop.reason


def test_where_the_graph_knows_too_little_the_objects_tell():
    far = frame(40.0, 30.0, -20.0)
    items = furniture(14, seed=5)
    both = [snapshot_of(items, np.eye(4), seed=1), snapshot_of(items, far, seed=2)]
    objects = [*both[0].objects]
    objects += [replace(item, id=item.id + 100, submap_id=3) for item in both[1].objects]
    submaps = [both[0].submaps[0], replace(both[1].submaps[0], id=3)]
    snapshot = MapSnapshot(revision=1, stamp_ns=1, submaps=tuple(submaps), objects=tuple(objects))
    patches = [patch([-0.6, -0.6, 0], [7.8, 0, 0], [0, 7.8, 0], [0, 0, 1])]
    for place, half, _ in items:
        patches += box(place[0] - half[0], place[1] - half[0], 2 * half[0], 2 * half[2])
    earlier, later = surface(patches), surface(patches, own_from_world=far, seed=1)
    asked = query(earlier, later, sigma_m=20.0, snapshot=snapshot)
    loops = search_loops(asked, CONFIG)
    assert [loop.method for loop in loops] == ["objects"]
    assert loops[0].reason is None
    assert np.allclose(loops[0].earlier_from_later, invert(far), atol=0.05)
    assert search_loops(replace(asked, snapshot=None), CONFIG) == ()


CAMERA = Camera(width=640, height=480, fx=500.0, fy=500.0, cx=319.5, cy=239.5)
HERE = np.eye(4)
# z forward, y down, along x of the world.
LOOKING = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def poster(seed):
    """Points on the wall at x = 4, and what they look like."""
    rng = np.random.default_rng(seed)
    points = np.stack([np.full(80, 4.0), rng.uniform(0.8, 2.2, 80), rng.uniform(0.6, 1.8, 80)], axis=1)
    return points, rng.integers(0, 256, (80, 32), dtype=np.uint8)


def looks(poster, y_m, yaw_deg=0.0, own_from_world=HERE):
    """The keyframe of a camera that looks at a poster, in a frame of its own."""
    pose = from_rotation_translation(yaw_rotation(np.radians(yaw_deg)) @ LOOKING, np.array([1.0, y_m, 1.2]))
    points = apply(invert(pose), poster[0]).astype(np.float32)
    placed = compose(own_from_world, pose)
    return Keypoints(camera=CAMERA, world_from_camera=placed, descriptors=poster[1], points=points)


def after_jump(earlier, later, far, seen=1):
    """The search for a later submap anywhere, by a poster in both, or by another one in the later."""
    views = {0: [looks(poster(1), 1.4)], 3: [looks(poster(seen), 1.7, 5.0, far)]}
    return search_loops(replace(query(earlier, later, sigma_m=30.0), keypoints=views), CONFIG)


def test_where_the_graph_knows_too_little_a_keyframe_is_recognised():
    far = shift(40.0, -20.0, yaw_deg=130.0)
    both = surface(room(), free=air()), surface(room(), own_from_world=far, seed=1)
    (loop,) = after_jump(*both, far)
    assert (loop.earlier, loop.later, loop.method, loop.reason) == (0, 3, "appearance", None)
    assert off(loop.earlier_from_later, far)[0] < 0.015
    assert after_jump(*both, far, seen=2) == ()


def test_a_keyframe_says_where_it_is_along_a_bare_wall():
    """The surfaces of both leave one direction open."""
    wall = [patch([4, -4, 0], [0, 11, 0], [0, 0, 2], [-1, 0, 0]), patch([0, -4, 0], [4, 0, 0], [0, 11, 0], [0, 0, 1])]
    far = shift(12.0, 3.0, yaw_deg=-70.0)
    (loop,) = after_jump(surface(wall), surface(wall, own_from_world=far, seed=1), far)
    assert loop.reason is None
    assert off(loop.earlier_from_later, far)[0] < 0.03
    assert np.sqrt(np.linalg.eigvalsh(loop.covariance[3:, 3:])[-1]) < 0.1


def test_rooms_with_one_poster_are_told_apart_by_their_furniture():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        boxes = [(x, *rng.uniform((0.2, 0.5, 0.6), (2.0, 0.9, 1.6))) for x in (0.3, 1.6, 2.7)]
        own = [*room()[:5], *(side for each in boxes for side in box(*each))]
        (loop,) = after_jump(surface(room(), free=air()), surface(own, free=air(boxes), seed=1), np.eye(4))
        assert loop.method == "appearance"
        assert "free space" in loop.reason


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
