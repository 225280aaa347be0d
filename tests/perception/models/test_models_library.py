import json
import numpy as np
import pytest
from onnx import TensorProto, helper
from hickory_stream.errors import ModelError
from hickory_stream.perception.models import library
from hickory_stream.perception.models.network import Network, NetworkConfig, available_providers
from tests.perception import small_graphs


@pytest.fixture
def dino(tmp_path):
    return small_graphs.dino(tmp_path / "small.onnx")


def entry_of(file, **changes):
    known = {"name": "small", "kind": "dinov2", "file": "small.onnx", "sha256": library.sha256_of(file)}
    return library.ModelEntry(**{**known, "source": "a test", "licence": "CC0-1.0", "labels": ("a", "b"), **changes})


@pytest.fixture
def added(tmp_path, dino):
    """The folder and the entry of a model that was added."""
    library.add_model(tmp_path / "models", dino, entry_of(dino))
    return tmp_path / "models", entry_of(dino)


def test_what_is_added_is_found_with_all_that_is_known_of_it(added):
    folder, entry = added
    assert library.read_manifest(folder) == {"small": entry}
    assert library.find_model("small", "dinov2", folder=folder) == (entry, folder / "small.onnx")


def test_the_folder_is_named_by_the_environment(monkeypatch, tmp_path):
    monkeypatch.setenv("HICKORY_MODELS", str(tmp_path))
    assert library.models_folder() == tmp_path
    monkeypatch.delenv("HICKORY_MODELS")
    assert library.models_folder().parts[-2:] == ("hickory-stream", "models")


def test_a_missing_model_is_answered_with_how_to_get_it(tmp_path):
    with pytest.raises(
        ModelError,
        match=r"no model fastsam-s in .*fetch it with .*models get fastsam-s.*models add fastsam-s.onnx --kind fastsam",
    ):
        library.find_model("fastsam-s", "fastsam", folder=tmp_path)


def test_a_file_without_a_manifest_is_not_believed(tmp_path, dino):
    with pytest.raises(ModelError, match=r"no entry in manifest\.json; make one with `hickory-stream models add"):
        library.find_model("small", "dinov2", folder=tmp_path)


def test_a_file_that_was_changed_is_refused_with_both_hashes(added, dino):
    folder, entry = added
    (folder / "small.onnx").write_bytes(dino.read_bytes() + b"x")
    with pytest.raises(ModelError, match=rf"has sha256 [0-9a-f]{{64}}, manifest\.json says {entry.sha256}"):
        library.find_model("small", "dinov2", folder=folder)


def test_a_model_of_another_kind_or_without_its_file_is_refused(added):
    folder, _ = added
    with pytest.raises(ModelError, match="of kind dinov2, expected fastsam"):
        library.find_model("small", "fastsam", folder=folder)
    (folder / "small.onnx").unlink()
    with pytest.raises(ModelError, match="is missing, though"):
        library.find_model("small", "dinov2", folder=folder)


def test_a_file_of_another_model_is_not_replaced(added, dino):
    folder, _ = added
    with pytest.raises(ModelError, match="belongs to the model small"):
        library.add_model(folder, dino, entry_of(dino, name="other"))


@pytest.mark.parametrize("text", [
    "{", "[]", '{"format": 2, "models": {}}', '{"format": 1, "models": {"a": 3}}',
    '{"format": 1, "models": {"a": {"colour": "red"}}}',
    json.dumps({"format": 1, "models": {"a": {"kind": "dinov2", "file": "../a", "sha256": "0" * 64}}}),
    json.dumps({"format": 1, "models": {"a": {"kind": "cat", "file": "a", "sha256": "0" * 64}}}),
])  # fmt: skip
def test_a_manifest_that_is_none_is_refused_by_its_path(tmp_path, text):
    (tmp_path / library.MANIFEST).write_text(text)
    with pytest.raises(ModelError, match=r"manifest\.json"):
        library.read_manifest(tmp_path)


def test_a_home_that_is_no_folder_holds_no_models(tmp_path):
    (tmp_path / "home").write_text("")
    assert library.read_manifest(tmp_path / "home" / "models") == {}


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
