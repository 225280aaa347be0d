import numpy as np
import pytest
from onnx import TensorProto, helper
from hickory_stream.errors import ModelError
from hickory_stream.perception.models.network import Network, NetworkConfig, available_providers
from tests.perception import small_graphs

CPU = NetworkConfig(provider="cpu")
IMAGE = np.zeros((1, 3, 28, 28), np.float32)


def test_a_network_says_what_it_runs_on_and_for_how_long(tmp_path):
    network = Network(small_graphs.dino(tmp_path / "a.onnx"), NetworkConfig(provider="auto"))
    assert network.provider in available_providers()
    network.warm_up(IMAGE)
    assert network.warm_up_s is not None
    assert network.num_runs == 0
    (tokens,) = network.run(IMAGE)
    assert tokens.shape == (1, 5, 3)
    assert network.num_runs == 1
    assert network.total_s == network.last_s > 0


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9], ids=["empty", "a third", "most"])
def test_a_truncated_file_is_refused_by_name(tmp_path, share):
    whole = small_graphs.dino(tmp_path / "a.onnx").read_bytes()
    (tmp_path / "cut.onnx").write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(ModelError, match=r"cut\.onnx .*export it"):
        Network(tmp_path / "cut.onnx", CPU)


def test_a_file_of_another_operator_set_is_refused(tmp_path):
    node = helper.make_node("Identity", ["image"], ["same"])
    file = small_graphs.save(tmp_path / "new.onnx", [node], [("same", TensorProto.FLOAT, None)], opset=999)
    with pytest.raises(ModelError, match="operator set that this onnxruntime does not know"):
        Network(file, CPU)


def test_a_missing_file_is_said_to_be(tmp_path):
    with pytest.raises(ModelError, match="is missing"):
        Network(tmp_path / "none.onnx", CPU)


@pytest.mark.skipif("cuda" in available_providers(), reason="this onnxruntime has CUDA")
@pytest.mark.parametrize("provider", ["cuda", "tensorrt"])
def test_an_unknown_provider_is_refused_with_the_known_ones(tmp_path, provider):
    with pytest.raises(ModelError, match=f"no provider {provider}, only cpu"):
        Network(small_graphs.dino(tmp_path / "a.onnx"), NetworkConfig(provider=provider))


def test_a_graph_that_fails_on_an_image_says_its_size(tmp_path):
    network = Network(small_graphs.dino(tmp_path / "a.onnx", image=(1, 3, 28, 28)), CPU)
    with pytest.raises(ModelError, match=r"fails on an image of 14 x 28"):
        network.run(IMAGE[..., :14])
