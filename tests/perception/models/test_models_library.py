import json
import pytest
from hickory_stream.errors import ModelError
from hickory_stream.perception.models.library import (
    MANIFEST,
    ModelEntry,
    add_model,
    find_model,
    models_folder,
    read_manifest,
    sha256_of,
)
from tests.perception import small_graphs


@pytest.fixture
def dino(tmp_path):
    return small_graphs.dino(tmp_path / "small.onnx")


def entry_of(file, **changes):
    known = {"name": "small", "kind": "dinov2", "file": "small.onnx", "sha256": sha256_of(file)}
    return ModelEntry(**{**known, "source": "a test", "licence": "CC0-1.0", "labels": ("a", "b"), **changes})


def test_what_is_added_is_found_with_all_that_is_known_of_it(tmp_path, dino):
    folder = tmp_path / "models"
    entry = entry_of(dino)
    add_model(folder, dino, entry)
    assert read_manifest(folder) == {"small": entry}
    assert find_model("small", "dinov2", folder=folder) == (entry, folder / "small.onnx")


def test_the_folder_is_named_by_the_environment(monkeypatch, tmp_path):
    monkeypatch.setenv("HICKORY_MODELS", str(tmp_path))
    assert models_folder() == tmp_path
    monkeypatch.delenv("HICKORY_MODELS")
    assert models_folder().parts[-2:] == ("hickory-stream", "models")


def test_a_missing_model_is_answered_with_how_to_get_it(tmp_path):
    with pytest.raises(
        ModelError,
        match=r"no model fastsam-s in .*fetch it with .*models get fastsam-s.*models add fastsam-s.onnx --kind fastsam",
    ):
        find_model("fastsam-s", "fastsam", folder=tmp_path)


def test_a_file_without_a_manifest_is_not_believed(tmp_path, dino):
    with pytest.raises(ModelError, match=r"no entry in manifest\.json; make one with `hickory-stream models add"):
        find_model("small", "dinov2", folder=tmp_path)


def test_a_file_that_was_changed_is_refused_with_both_hashes(tmp_path, dino):
    folder = tmp_path / "models"
    entry = entry_of(dino)
    add_model(folder, dino, entry)
    (folder / "small.onnx").write_bytes(dino.read_bytes() + b"x")
    with pytest.raises(ModelError, match=rf"has sha256 [0-9a-f]{{64}}, manifest\.json says {entry.sha256}"):
        find_model("small", "dinov2", folder=folder)


def test_a_file_that_is_gone_is_said_to_be(tmp_path, dino):
    folder = tmp_path / "models"
    add_model(folder, dino, entry_of(dino))
    (folder / "small.onnx").unlink()
    with pytest.raises(ModelError, match="is missing, though"):
        find_model("small", "dinov2", folder=folder)


def test_a_model_of_another_kind_is_refused(tmp_path, dino):
    folder = tmp_path / "models"
    add_model(folder, dino, entry_of(dino))
    with pytest.raises(ModelError, match="of kind dinov2, expected fastsam"):
        find_model("small", "fastsam", folder=folder)


def test_a_file_of_another_model_is_not_replaced(tmp_path, dino):
    folder = tmp_path / "models"
    add_model(folder, dino, entry_of(dino))
    with pytest.raises(ModelError, match="belongs to the model small"):
        add_model(folder, dino, entry_of(dino, name="other"))


@pytest.mark.parametrize(
    "text",
    [
        "{",
        "[]",
        '{"format": 2, "models": {}}',
        '{"format": 1, "models": {"a": 3}}',
        '{"format": 1, "models": {"a": {"colour": "red"}}}',
        json.dumps({"format": 1, "models": {"a": {"kind": "dinov2", "file": "../a", "sha256": "0" * 64}}}),
        json.dumps({"format": 1, "models": {"a": {"kind": "cat", "file": "a", "sha256": "0" * 64}}}),
    ],
)
def test_a_manifest_that_is_none_is_refused_by_its_path(tmp_path, text):
    (tmp_path / MANIFEST).write_text(text)
    with pytest.raises(ModelError, match=r"manifest\.json"):
        read_manifest(tmp_path)


def test_a_home_that_is_no_folder_holds_no_models(tmp_path):
    (tmp_path / "home").write_text("")
    assert read_manifest(tmp_path / "home" / "models") == {}
