"""What image-text networks are given: our pixels and tokens against those of transformers.

Needs transformers (of the extra `export`; without torch, too). Run: pytest -m reference tests/reference
"""

import numpy as np
import pytest

transformers = pytest.importorskip("transformers", reason="needs the extra `export`: pip install -e '.[export]'")

from hickory_stream.perception.models.image_text import ImageTextNetwork  # noqa: E402
from hickory_stream.perception.models.image_text_pixels import pixels_of, read_preprocessing  # noqa: E402
from hickory_stream.perception.models.network import Network, NetworkConfig  # noqa: E402
from hickory_stream.perception.models.preprocessing import built_in_picture  # noqa: E402
from tests.perception.small_pairs import write_pair  # noqa: E402

pytestmark = [pytest.mark.reference, pytest.mark.timeout(600), pytest.mark.filterwarnings("default")]

PICTURE = built_in_picture()
CPU = NetworkConfig(provider="cpu", warm_up=False)
MERGES = ["a </w>", "m u", "mu g</w>", "w i", "wi n", "win d", "wind o", "windo w</w>", "o f</w>", "p h", "ph o"]


def processors():
    from transformers.models.clip.image_processing_pil_clip import CLIPImageProcessorPil
    from transformers.models.siglip.image_processing_pil_siglip import SiglipImageProcessorPil

    yield CLIPImageProcessorPil()
    yield CLIPImageProcessorPil(size={"shortest_edge": 240}, crop_size={"height": 224, "width": 200}, resample=2)
    yield SiglipImageProcessorPil()
    yield SiglipImageProcessorPil(size={"height": 384, "width": 256})


def test_pixels_are_those_of_the_package(tmp_path):
    worst = 0.0
    for processor in processors():
        processor.save_pretrained(tmp_path)
        how = read_preprocessing(tmp_path / "preprocessor_config.json")
        for height, width in ((400, 600), (224, 224), (60, 33), (37, 300), (399, 71)):
            picture = PICTURE[:height, :width]
            theirs = processor(picture, return_tensors="np")["pixel_values"]
            ours = pixels_of(picture, how)
            assert ours.shape == theirs.shape
            worst = max(worst, float(np.abs(ours - theirs).max()))
    print(f"pixels differ by at most {worst:.2g}")
    assert worst < 1e-5


@pytest.mark.parametrize("with_mask", [True, False])
def test_tokens_are_those_of_the_package(tmp_path, with_mask):
    letters = [*"abcdefghijklmnopqrstuvwxyz.,'0123456789"]
    vocabulary = [*letters, *(f"{letter}</w>" for letter in letters), *("".join(pair.split()) for pair in MERGES)]
    vocabulary = [*dict.fromkeys(vocabulary), "<|startoftext|>", "<|endoftext|>"]
    merges = [tuple(pair.split()) for pair in MERGES if all(part in vocabulary for part in pair.split())]
    tokenizer = transformers.CLIPTokenizer(
        vocab={token: i for i, token in enumerate(vocabulary)}, merges=merges, model_max_length=32
    )
    folder = write_pair(tmp_path, with_mask=with_mask)
    tokenizer.save_pretrained(folder)
    pair = ImageTextNetwork(
        Network(folder / "vision_model.onnx", CPU), Network(folder / "text_model.onnx", CPU),
        tokenizer=folder / "tokenizer.json", preprocessor=folder / "preprocessor_config.json",
        tokenizer_config=folder / "tokenizer_config.json",
    )  # fmt: skip
    texts = (
        "a photo of a mug.", "A Window", "it's 10 mugs", "", "x" * 100, "  two   spaces ",
        "caf\u00e9 \u2014 na\u00efve",
    )  # fmt: skip
    for text in texts:
        theirs = tokenizer(text, truncation=True, padding=False if with_mask else "max_length")["input_ids"]
        assert pair.tokens_of(text) == theirs, text
