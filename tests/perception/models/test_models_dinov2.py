import numpy as np
import pytest
from onnx import TensorProto, helper, numpy_helper
from hickory_stream.errors import ModelError
from hickory_stream.perception.models.dinov2 import DinoConfig, DinoExtractor
from hickory_stream.perception.models.network import Network, NetworkConfig
from tests.perception import small_graphs

CPU = NetworkConfig(provider="cpu")


def extractor(file, **config):
    return DinoExtractor(Network(file, CPU), DinoConfig(**config))


def picture(height, width):
    return np.random.default_rng(2).integers(0, 255, (height, width, 3), np.uint8)


@pytest.mark.parametrize("size", [(28, 42), (480, 640), (1, 1), (15, 30)], ids=str)
@pytest.mark.parametrize("extra", [0, 1, 5])
def test_a_grid_of_unit_features_covers_an_image_of_any_size(tmp_path, size, extra):
    features = extractor(small_graphs.dino(tmp_path / "a.onnx", extra=extra)).extract(picture(*size))
    assert features.shape == (-(-size[0] // 14), -(-size[1] // 14), 3)
    assert features.dtype == np.float32
    assert np.linalg.norm(features, axis=-1) == pytest.approx(1.0, abs=1e-5)


def test_patches_are_in_their_places(tmp_path):
    rgb = np.zeros((28, 42, 3), np.uint8)
    rgb[14:, 28:] = (255, 0, 0)
    features = extractor(small_graphs.dino(tmp_path / "a.onnx")).extract(rgb)
    red = np.array([1 - 0.485, 0 - 0.456, 0 - 0.406]) / (0.229, 0.224, 0.225)
    assert features[1, 2] == pytest.approx(red / np.linalg.norm(red), abs=1e-5)
    assert features[0, 0] @ features[1, 1] == pytest.approx(1.0)


def test_a_reduced_image_has_larger_patches(tmp_path):
    reduced = extractor(small_graphs.dino(tmp_path / "a.onnx"), reduce=2)
    assert reduced.patch_px == 28
    assert reduced.dim == 3
    assert reduced.extract(picture(57, 56)).shape == (3, 2, 3)


def test_a_graph_of_one_size_says_which_when_it_gets_another(tmp_path):
    fixed = extractor(small_graphs.dino(tmp_path / "a.onnx", image=(1, 3, 28, 28)))
    assert fixed.extract(picture(28, 28)).shape == (2, 2, 3)
    with pytest.raises(ModelError, match="takes images of width 28 only, and the frames give 42"):
        fixed.extract(picture(28, 42))


def test_a_graph_of_other_patches_is_refused(tmp_path):
    with pytest.raises(ModelError, match="no DINOv2 graph: expected 16 patch tokens of 14 px"):
        extractor(small_graphs.dino(tmp_path / "a.onnx", patch=7))


def test_features_that_are_not_finite_are_refused(tmp_path):
    nodes = [
        helper.make_node("AveragePool", ["image"], ["pooled"], kernel_shape=[14, 14], strides=[14, 14]),
        helper.make_node("Constant", [], ["nan"], value=numpy_helper.from_array(np.float32(np.nan))),
        helper.make_node("Add", ["pooled", "nan"], ["map"]),
    ]
    file = small_graphs.save(tmp_path / "a.onnx", nodes, [("map", TensorProto.FLOAT, (1, 3, None, None))])
    with pytest.raises(ModelError, match="NaN or infinity on cpu"):
        extractor(file)
