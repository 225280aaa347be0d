import dataclasses
import numpy as np
import pytest
from hickory_stream.geometry.rigid import from_rotation_translation, yaw_rotation
from hickory_stream.perception.affinity.pixel_inputs import CHANNELS, NUM_INPUTS, UNIT, ZERO, pixel_inputs
from hickory_stream.perception.surface import SurfaceConfig, surface_of
from tests.perception.perception_scenes import Block, floor, looking, render

VIEW = looking((0.0, 0.0, 0.2), start=(-2.0, -0.2, 1.4))
BOX = Block(low=(-0.2, -0.2, 0.0), high=(0.2, 0.2, 0.4), color=(190, 40, 40))
BENDS = [i for i, name in enumerate(CHANNELS) if name.startswith("bend")]


def surface(things, view=VIEW):
    return surface_of(render(things, view)[0], SurfaceConfig())


def channel(inputs, name):
    return (inputs[CHANNELS.index(name)].astype(float) - ZERO) / UNIT


def test_a_plane_has_no_bend_at_any_slant():
    inputs = pixel_inputs(surface([floor()]), 0.0)
    seen = inputs[0] != ZERO
    assert seen.mean() > 0.5
    assert np.abs(inputs[BENDS][:, seen].astype(int) - ZERO).max() <= 1


def test_a_box_on_a_floor_bends_at_its_foot_and_its_edges():
    inputs = pixel_inputs(surface([floor(), BOX]), 0.0)
    assert np.abs(channel(inputs, "bend_y_4")).max() > 1.0
    assert np.abs(channel(inputs, "bend_x_1")).max() > 1.0


def test_the_floor_looks_up_and_lies_at_the_height_of_the_floor():
    inputs = pixel_inputs(surface([floor()]), 0.0)
    seen = inputs[0] != ZERO
    assert channel(inputs, "normal_up")[seen].min() > 0.98
    assert channel(inputs, "height")[seen] == pytest.approx(-1.0, abs=0.05)


def test_an_unknown_floor_leaves_out_heights_only():
    known, unknown = (pixel_inputs(surface([floor(), BOX]), z) for z in (0.0, None))
    told = [i for i in range(NUM_INPUTS) if (known[i] != unknown[i]).any()]
    assert [CHANNELS[i] for i in told] == ["height", "has_height"]


def test_turning_the_world_changes_no_byte_by_more_than_one():
    one = surface([floor(), BOX])
    turn = from_rotation_translation(yaw_rotation(1.1), np.array([3.0, -2.0, 0.0]))
    frame, _ = render([floor(), BOX], VIEW)
    other = surface_of(dataclasses.replace(frame, world_from_camera=turn @ VIEW), SurfaceConfig())
    a, b = (pixel_inputs(s, 0.0).astype(int) for s in (one, other))
    assert np.abs(a - b).max() <= 1


def test_twice_the_focal_length_sees_the_same_bend():
    frame, _ = render([floor()], VIEW)
    near = surface_of(frame, SurfaceConfig())
    camera = dataclasses.replace(frame.camera, fx=2 * frame.camera.fx, fy=2 * frame.camera.fy)
    far = surface_of(render([floor()], VIEW, camera)[0], SurfaceConfig())
    a, b = (pixel_inputs(s, None) for s in (near, far))
    middle = (slice(80, 160), slice(100, 220))
    assert np.abs(b[BENDS][:, *middle].astype(int) - ZERO).max() <= 1
    lost = channel(a, "scale")[120, 160] - channel(b, "scale")[120, 160]
    assert lost == pytest.approx(np.log(2), abs=0.05)


def test_sides_are_padded_to_multiples_of_32():
    inputs = pixel_inputs(surface([floor(), BOX]), 0.0)
    assert inputs.shape == (NUM_INPUTS, 256, 320)
    assert (inputs[:, 240:] == ZERO).all()
