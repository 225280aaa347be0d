import dataclasses
from importlib import resources
import numpy as np
import onnx
import pytest
from onnx import numpy_helper
from hickory_stream.errors import ModelError
from hickory_stream.geometry.rigid import from_rotation_translation, yaw_rotation
from hickory_stream.perception.affinity import pixel_network
from hickory_stream.perception.affinity.pixel_inputs import CHANNELS, NUM_INPUTS, UNIT, ZERO, pixel_inputs
from hickory_stream.perception.affinity.pixel_network import NUM_OUTPUTS, ODDS_ZERO, THING, PixelNetwork
from hickory_stream.perception.models.network import Network, NetworkConfig
from hickory_stream.perception.surface import SurfaceConfig, surface_of
from tests.perception import small_graphs
from tests.perception.perception_scenes import Block, floor, looking, render

VIEW = looking((0.0, 0.0, 0.2), start=(-2.0, -0.2, 1.4))
BOX = Block(low=(-0.2, -0.2, 0.0), high=(0.2, 0.2, 0.4), color=(190, 40, 40))
BENDS = [i for i, name in enumerate(CHANNELS) if name.startswith("bend")]


def surface(things, view=VIEW):
    return surface_of(render(things, view)[0], SurfaceConfig())


def channel(inputs, name):
    return (inputs[CHANNELS.index(name)].astype(float) - ZERO) / UNIT


def test_a_floor_has_no_bend_looks_up_and_lies_at_its_height():
    inputs = pixel_inputs(surface([floor()]), 0.0)
    seen = inputs[0] != ZERO
    assert seen.mean() > 0.5
    assert np.abs(inputs[BENDS][:, seen].astype(int) - ZERO).max() <= 1
    assert channel(inputs, "normal_up")[seen].min() > 0.98
    assert channel(inputs, "height")[seen] == pytest.approx(-1.0, abs=0.05)


def test_a_box_on_a_floor_bends_at_its_foot_and_its_edges():
    inputs = pixel_inputs(surface([floor(), BOX]), 0.0)
    assert np.abs(channel(inputs, "bend_y_4")).max() > 1.0
    assert np.abs(channel(inputs, "bend_x_1")).max() > 1.0


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


NEAR = looking((0.0, 0.0, 0.2), start=(-1.6, -0.2, 1.2))


@pytest.fixture(scope="module")
def graph():
    with resources.as_file(resources.files("hickory_stream.perception") / pixel_network.EMBEDDED) as path:
        yield path


@pytest.fixture(scope="module")
def box_surface():
    box = Block(low=(-0.25, -0.25, 0.0), high=(0.25, 0.25, 0.5), color=(190, 40, 40))
    frame, shown = render([floor(), box], NEAR)
    return surface_of(frame, SurfaceConfig()), shown


def test_onnxruntime_gives_what_exact_integer_arithmetic_gives(graph, box_surface):
    surface, _ = box_surface
    seen = pixel_inputs(surface, 0.0)[None, :, 64:160, 96:224]
    noise = np.random.default_rng(3).integers(0, 256, (1, NUM_INPUTS, 64, 96)).astype(np.uint8)
    greatest = np.full((1, NUM_INPUTS, 32, 32), 255, np.uint8)
    network = Network(graph, NetworkConfig(provider="cpu", threads=1))
    for inputs in (seen, noise, greatest):
        np.testing.assert_array_equal(network.run(inputs)[0], run_in_integers(graph, inputs))


def test_no_pair_of_products_of_weights_exceeds_sixteen_bits(graph):
    import onnx
    from onnx import numpy_helper

    weights = [c for c in onnx.load(graph).graph.initializer if c.name.endswith("_weights")]
    assert len(weights) > 10
    for constant in weights:
        assert 2 * 255 * np.abs(numpy_helper.to_array(constant).astype(int)).max() < 2**15


def test_the_network_of_the_package_is_small(graph):
    assert graph.stat().st_size < 2e6
    assert graph.with_suffix(".json").is_file()


def test_odds_are_told_at_half_the_size_of_the_surface(box_surface):
    surface, _ = box_surface
    assert PixelNetwork().odds(surface, None).odds.shape == (NUM_OUTPUTS, 120, 160)


def test_a_box_is_a_thing_and_the_floor_is_not(box_surface):
    surface, shown = box_surface
    thing = PixelNetwork().odds(surface, 0.0).odds[THING].astype(int) - ODDS_ZERO
    few = shown[::2, ::2]
    assert np.median(thing[few == 1]) > 0 > np.median(thing[few == 0])


def test_a_graph_of_another_kind_is_refused(tmp_path):
    with pytest.raises(ModelError, match="affinity graph: expected bytes"):
        PixelNetwork(small_graphs.dino(tmp_path / "a.onnx"))


def run_in_integers(path, inputs):
    """Return the output of a graph of QLinearConv, Resize by two and Concat for (1, C, H, W) bytes."""
    graph = onnx.load(path).graph
    values = {c.name: numpy_helper.to_array(c) for c in graph.initializer}
    values[graph.input[0].name] = inputs
    for node in graph.node:
        given = [values.get(name) for name in node.input]
        if node.op_type == "QLinearConv":
            attributes = {a.name: onnx.helper.get_attribute_value(a) for a in node.attribute}
            out = _convolved(given, attributes["strides"][0], attributes["pads"][0])
        elif node.op_type == "Resize":
            out = given[0].repeat(2, axis=2).repeat(2, axis=3)
        else:
            assert node.op_type == "Concat", node.op_type
            out = np.concatenate(given, axis=1)
        values[node.output[0]] = out
    return values[graph.output[0].name]


def _convolved(given, stride, pad):
    x, x_scale, x_zero, w, w_scales, w_zeros, y_scale, y_zero, bias = given
    assert not w_zeros.any()
    around = [(0, 0), (0, 0), (pad, pad), (pad, pad)]
    padded = np.pad(x.astype(np.int64) - int(x_zero), around)
    side = w.shape[2]
    height, width = (-(-(n + 2 * pad - side + 1) // stride) for n in x.shape[2:])
    sums = np.broadcast_to(bias.astype(np.int64)[None, :, None, None], (1, len(w), height, width)).copy()
    for dy in range(side):
        for dx in range(side):
            part = padded[0, :, dy : dy + stride * height : stride, dx : dx + stride * width : stride]
            sums[0] += np.einsum("oi,ihw->ohw", w[:, :, dy, dx].astype(np.int64), part)
    # A product of single precision and a rounding to even: no other float.
    scales = (x_scale * w_scales / y_scale).astype(np.float32)
    scaled = sums.astype(np.float32) * scales[None, :, None, None]
    return np.clip(np.rint(scaled) + np.float32(y_zero), 0, 255).astype(np.uint8)
