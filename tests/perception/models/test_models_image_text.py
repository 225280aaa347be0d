import json
import shutil
import numpy as np
import pytest
from hickory_stream.errors import ModelError
from hickory_stream.perception.models.image_text import ImageTextNetwork, published_files
from hickory_stream.perception.models.image_text_pixels import pixels_of, read_preprocessing
from hickory_stream.perception.models.network import Network, NetworkConfig
from tests.perception.small_pairs import PREPROCESSING, SIDE_PX, write_pair

CPU = NetworkConfig(provider="cpu", warm_up=False, threads=1)
BLUE = np.full((30, 50, 3), (10, 10, 240), np.uint8)


def opened(folder):
    files = published_files(folder)
    return ImageTextNetwork(
        Network(files["vision"], CPU), Network(files["text"], CPU), tokenizer=files["tokenizer"],
        preprocessor=files["preprocessor"], tokenizer_config=files.get("tokenizer-config"),
    )  # fmt: skip


def test_pictures_and_texts_have_unit_features_in_one_space(tmp_path):
    pair = opened(write_pair(tmp_path))
    blue, window, mug = pair.of_image(BLUE), pair.of_text("a photo of a window."), pair.of_text("a photo of a mug.")
    assert blue.dtype == np.float32
    assert [np.linalg.norm(part) for part in (blue, window, mug)] == pytest.approx([1, 1, 1])
    assert blue @ window > 0.99 > 0.1 > blue @ mug


@pytest.mark.parametrize(
    ("options", "tokens"),
    [
        ({}, [2, 3, 10]),
        # Of fixed length, and without a mask: as they were trained, filled up.
        ({"length": 5}, [2, 3, 10, 0, 0]),
        ({"with_mask": False}, [2, 3, 10, *[0] * 9]),
    ],
)
def test_texts_are_filled_up_where_the_graph_asks_for_it(tmp_path, options, tokens):
    pair = opened(write_pair(tmp_path, **options))
    assert pair.tokens_of("a photo window") == tokens
    assert len(pair.tokens_of("a " * 100)) == options.get("length", 12)
    assert pair.of_text("a photo window") == pytest.approx([0, 0, 1])


def test_published_files_are_found_and_missing_ones_are_named(tmp_path):
    folder = write_pair(tmp_path)
    (folder / "onnx").mkdir()
    for name in ("vision_model.onnx", "text_model.onnx"):
        shutil.move(folder / name, folder / "onnx" / name)
    assert published_files(folder)["text"] == folder / "onnx" / "text_model.onnx"
    (folder / "tokenizer_config.json").unlink()
    assert opened(folder).tokens_of("mug") == [12]
    (folder / "tokenizer.json").unlink()
    (folder / "preprocessor_config.json").unlink()
    with pytest.raises(ModelError, match=r"no tokenizer\.json, no preprocessor_config\.json"):
        published_files(folder)


@pytest.mark.parametrize(("name", "content", "complaint"), [
    ("tokenizer.json", "{}", "no tokenizer"), ("tokenizer_config.json", "[]", "no JSON object"),
    ("preprocessor_config.json", "{}", "no pre-processing"), ("preprocessor_config.json", "no", "no pre-processing"),
    ("preprocessor_config.json", json.dumps({**PREPROCESSING, "crop_size": 99}), "crop_size"),
    ("preprocessor_config.json", json.dumps({**PREPROCESSING, "size": 10**9}), "1 to 4096"),
    ("preprocessor_config.json", json.dumps({**PREPROCESSING, "resample": 17}), "resample 17"),
    ("preprocessor_config.json", json.dumps({**PREPROCESSING, "image_std": [1, 1, 0]}), "three finite"),
])  # fmt: skip
def test_files_that_say_nothing_are_refused_in_one_line(tmp_path, name, content, complaint):
    folder = write_pair(tmp_path)
    (folder / name).write_text(content)
    with pytest.raises(ModelError, match=complaint) as refused:
        opened(folder)
    assert "\n" not in str(refused.value)


def test_graphs_that_are_no_pair_are_refused(tmp_path):
    folder = write_pair(tmp_path)
    shutil.copy(folder / "vision_model.onnx", folder / "text_model.onnx")
    with pytest.raises(ModelError, match="input_ids"):
        opened(folder)
    with pytest.raises(ModelError, match="no token to fill texts up"):
        folder = write_pair(tmp_path / "unpadded", with_mask=False)
        (folder / "tokenizer_config.json").write_text("{}")
        opened(folder)


@pytest.mark.parametrize("size", [8, {"height": 8, "width": 8}])
def test_a_picture_is_resized_cropped_to_its_middle_and_scaled(tmp_path, size):
    rgb = np.zeros((24, 72, 3), np.uint8)
    rgb[:, 36:] = 255
    path = tmp_path / "p.json"
    path.write_text(json.dumps({**PREPROCESSING, "size": size, "image_mean": [0.5] * 3, "image_std": [0.5] * 3}))
    pixels = pixels_of(rgb, read_preprocessing(path))
    assert pixels.shape == (1, 3, SIDE_PX, SIDE_PX)
    # Black is -1 and white is 1; their border lies in the middle.
    assert pixels[0, :, :, 0] == pytest.approx(-1)
    assert pixels[0, :, :, -1] == pytest.approx(1)
