import numpy as np
import pytest
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.perception.structure.detection import StructureConfig
from hickory_stream.perception.structure.ground import GroundConfig, uneven_ground
from hickory_stream.perception.structure.room_structure import room_structure_of
from hickory_stream.perception.surface import SurfaceConfig, surface_of
from tests.perception.perception_scenes import CAMERA, Block, floor, looking, render

GREY = (130, 125, 120)


def block(x0, y0, x1, y1, top, foot=0.0):
    return Block(low=(x0, y0, foot), high=(x1, y1, top), color=(180, 60, 50))


def seen(things, *, at=(0.6, 0.0, 0.0), start=(-2.4, -0.2, 1.4), tilt_deg=0.0):
    """The room structure of a view, and which thing each of its pixels shows; a tilt makes the floor a slope."""
    frame, ids = render(things, looking(at, start=start))
    angle = np.radians(tilt_deg)
    c, s = np.cos(angle), np.sin(angle)
    tilt = from_rotation_translation(np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]), np.zeros(3))
    depth_m = np.where(frame.depth_m < 10.0, frame.depth_m, np.nan)
    frame = type(frame)(
        index=0, stamp_ns=0, rgb=frame.rgb, depth_m=depth_m, camera=frame.camera,
        world_from_camera=tilt @ frame.world_from_camera,
    )  # fmt: skip
    surface = surface_of(frame, SurfaceConfig(width_px=CAMERA.width))
    room = room_structure_of(surface, None, StructureConfig(), 0.03)
    return room, np.where(np.isfinite(surface.depth_m) & np.isfinite(surface.normals_world[..., 2]), ids, -1), surface


def share(room, ids, thing):
    return float(room.shown[ids == thing].mean())


def test_a_level_floor_is_one_plane_and_objects_are_no_ground():
    room, _, surface = seen([floor(), block(0.2, -0.5, 1.0, 0.3, 0.4), block(-0.3, 0.6, 0.4, 1.2, 0.15)])
    assert room.floor_z_m == pytest.approx(0.0, abs=0.01)
    nothing = np.zeros(surface.depth_m.shape, dtype=bool)
    found = uneven_ground(surface, nothing, room.floor_z_m, GroundConfig(), below_camera_m=0.25, least_m2=0.25)
    assert found is None


@pytest.mark.parametrize("tilt_deg", [-6.0, -3.0, 4.0, 8.0])
def test_a_slope_is_ground_and_a_box_on_it_is_not(tilt_deg):
    room, ids, _ = seen([floor(), block(0.2, -0.4, 0.7, 0.2, 0.45)], tilt_deg=tilt_deg)
    assert share(room, ids, 0) > 0.97
    assert share(room, ids, 1) < 0.12


@pytest.mark.parametrize(
    ("x0", "x1", "top", "foot", "eye"),
    [(0.3, 9.0, 0.13, 0.13, 1.4), (-9.0, 0.0, 0.14, 0.0, 1.54)],
    ids=["a pavement and the face of its kerb", "a road below the kerb that one stands on"],
)
def test_both_sides_of_a_kerb_are_ground_and_a_box_is_not(x0, x1, top, foot, eye):
    pavement = Block(low=(x0, -9.0, -1.0), high=(x1, 9.0, top), color=GREY)
    room, ids, _ = seen([floor(), pavement, block(1.2, -0.3, 1.7, 0.3, 0.5, foot=foot)], start=(-2.4, -0.2, eye))
    assert share(room, ids, 0) > 0.97
    assert share(room, ids, 1) > 0.97
    assert share(room, ids, 2) < 0.15


@pytest.mark.parametrize(
    ("top", "width"), [(0.16, 0.9), (0.5, 2.2), (0.75, 2.2)], ids=["a low box", "a bed", "a table"]
)
def test_what_is_no_step_or_has_no_room_to_stand_is_no_ground(top, width):
    room, ids, _ = seen([floor(), block(0.0, -width / 2, width, width / 2, top)])
    assert share(room, ids, 0) > 0.95
    assert share(room, ids, 1) < 0.15


def test_the_floor_of_uneven_ground_is_its_middle():
    pavement = Block(low=(-0.9, -9.0, -1.0), high=(9.0, 9.0, 0.13), color=GREY)
    room, _, _ = seen([floor(), pavement])
    assert room.floor_z_m == pytest.approx(0.13, abs=0.02)


def test_a_corner_in_view_of_known_ground_is_enough():
    kerb = Block(low=(0.2, 0.35, -1.0), high=(2.0, 0.95, 0.13), color=GREY)
    pavement = Block(low=(-9.0, -9.0, -1.0), high=(-0.6, 9.0, 0.14), color=GREY)
    room, ids, surface = seen([floor(), kerb, pavement], start=(-2.4, -0.2, 1.54))
    assert share(room, ids, 1) < 0.5, "alone it has no room to stand"
    known = (ids == 1) & np.isfinite(surface.depth_m)
    found = uneven_ground(surface, known, room.floor_z_m, GroundConfig(), below_camera_m=0.25, least_m2=0.25)
    assert np.median(np.abs(found.height_m[known])) < 0.02


@pytest.mark.parametrize("edge_m", [0.30, 0.34, 0.37, 0.41, 0.45])
def test_the_face_of_a_kerb_is_ground_anywhere_in_the_grid(edge_m):
    pavement = Block(low=(edge_m, -9.0, -1.0), high=(9.0, 9.0, 0.14), color=GREY)
    room, _, surface = seen([floor(), pavement])
    face = np.abs(surface.points_world[..., 0] - edge_m) < 0.02
    assert face.sum() > 100
    assert room.shown[face].mean() > 0.98
