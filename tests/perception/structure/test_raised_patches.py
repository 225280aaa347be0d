import numpy as np
import pytest
from hickory_stream.geometry.camera import Camera
from hickory_stream.perception.structure.raised_patches import NearPlane, raised_patches
from hickory_stream.perception.surface import Surface, lab_of

SHAPE = (60, 80)
# The back of a shelf, and the board beside it, the one over it.
PATCH, BOARDS = np.s_[20:40, 20:50], (np.s_[16:44, 14:20], np.s_[14:20, 20:50])
WOOD, PAINT = (120, 80, 40), (200, 205, 210)


def scene(*, noise_m=0.01, patch_rgb=WOOD, held=True):
    rgb = np.full((*SHAPE, 3), PAINT, dtype=np.uint8)
    rgb[PATCH] = patch_rgb
    for board in BOARDS if held else ():
        rgb[board] = WOOD
    nothing = np.zeros((*SHAPE, 3), dtype=np.float32)
    return Surface(
        factor=1, camera=Camera(width=80, height=60, fx=60.0, fy=60.0, cx=39.5, cy=29.5),
        depth_m=np.full(SHAPE, 2.0, dtype=np.float32), points_world=nothing, normals_world=nothing, lab=lab_of(rgb),
        sigma_m=np.full(SHAPE, noise_m, dtype=np.float32), world_from_camera=np.eye(4),
    )  # fmt: skip


def distances(off_m, noise_m=0.01):
    out = np.random.default_rng(3).normal(0, noise_m, SHAPE)
    out[PATCH] += off_m
    return out.astype(np.float32)


def structure_of(*, held=True):
    mask = np.ones(SHAPE, dtype=bool)
    for board in BOARDS if held else ():
        mask[board] = False
    return mask


def patch_share(found):
    """Return which shares of the patch and of the rest were found."""
    inside = np.zeros(SHAPE, dtype=bool)
    inside[PATCH] = True
    return float(found[inside].mean()), float(found[~inside].mean())


def found_in(surface, off_m, *, held=True, is_floor=False):
    structure = structure_of(held=held)
    plane = NearPlane(distance_m=distances(off_m, float(surface.sigma_m[0, 0])), near=structure, is_floor=is_floor)
    return raised_patches([plane], structure, surface)


def test_a_panel_two_sigma_before_the_wall_is_not_the_wall():
    inside, outside = patch_share(found_in(scene(), 0.022))
    assert inside > 0.9
    assert outside < 0.02


def test_a_foot_that_only_touches_its_leg_is_none_of_the_floor():
    surface = scene(held=False)
    structure = structure_of(held=False)
    structure[18:20, 30:33] = False  # the leg
    shares = []
    for is_floor in (True, False):
        plane = NearPlane(distance_m=distances(0.022), near=structure, is_floor=is_floor)
        shares.append(patch_share(raised_patches([plane], structure, surface))[0])
    assert shares[0] > 0.9
    assert shares[1] == 0.0


@pytest.mark.parametrize(
    ("surface", "off_m", "held"),
    [
        (scene(patch_rgb=PAINT), 0.022, True),  # a wave of the camera's: it has the colour of the wall
        (scene(held=False), 0.022, False),  # a picture: nothing holds it
        (scene(), 0.003, True),  # less than is told from the plane
        (scene(noise_m=0.06), 0.022, True),  # from afar nobody can tell
    ],
)
def test_what_is_no_part_of_a_thing_stays_structure(surface, off_m, held):
    assert patch_share(found_in(surface, off_m, held=held))[0] < 0.1


def test_a_raised_part_in_another_plane_is_structure():
    structure = structure_of()
    wall = NearPlane(distance_m=distances(0.022), near=structure, is_floor=False)
    floor = NearPlane(distance_m=np.zeros(SHAPE, dtype=np.float32), near=structure, is_floor=True)
    assert not raised_patches([wall, floor], structure, scene()).any()


def test_without_planes_nothing_stands_off():
    assert not raised_patches([], structure_of(), scene()).any()
