from importlib import resources
import numpy as np
import pytest
from hickory_stream.errors import ModelError
from hickory_stream.perception.affinity import pixel_network
from hickory_stream.perception.affinity.pixel_inputs import NUM_INPUTS, pixel_inputs
from hickory_stream.perception.affinity.pixel_network import NUM_OUTPUTS, ODDS_ZERO, THING, PixelNetwork
from hickory_stream.perception.models.network import Network, NetworkConfig
from hickory_stream.perception.surface import SurfaceConfig, surface_of
from tests.perception import small_graphs
from tests.perception.integer_graph import run_in_integers
from tests.perception.perception_scenes import Block, floor, looking, render

VIEW = looking((0.0, 0.0, 0.2), start=(-1.6, -0.2, 1.2))


@pytest.fixture(scope="module")
def graph():
    with resources.as_file(resources.files("hickory_stream.perception") / pixel_network.EMBEDDED) as path:
        yield path


@pytest.fixture(scope="module")
def box_surface():
    box = Block(low=(-0.25, -0.25, 0.0), high=(0.25, 0.25, 0.5), color=(190, 40, 40))
    frame, shown = render([floor(), box], VIEW)
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
