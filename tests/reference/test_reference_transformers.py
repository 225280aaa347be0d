"""DINOv2 and OneFormer with random weights: our pre- and post-processing against transformers' own.

Needs the extra `export` (torch, ultralytics, transformers); skipped without. Run: pytest -m reference tests/reference
"""

import dataclasses
import json
from types import SimpleNamespace
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the extra `export`: pip install -e '.[export]'")

import hickory_stream.perception.models.export as export  # noqa: E402 -- needs torch only where it is there
from hickory_stream.perception.models.dinov2 import DinoConfig, DinoExtractor  # noqa: E402
from hickory_stream.perception.models.library import read_manifest, sha256_of  # noqa: E402
from hickory_stream.perception.models.network import Network, NetworkConfig  # noqa: E402
from hickory_stream.perception.models.preprocessing import built_in_picture, normalised  # noqa: E402
from hickory_stream.perception.models.published import PUBLISHED, PublishedFile  # noqa: E402
from hickory_stream.perception.models.semantic_graph import PanopticConfig, best_classes, panoptic_classes, query_scores  # noqa: E402

pytestmark = [pytest.mark.reference, pytest.mark.timeout(600), pytest.mark.filterwarnings("default")]

PICTURE = built_in_picture()
CPU = NetworkConfig(provider="cpu", warm_up=False)


def test_features_of_a_dinov2_graph_are_those_of_the_package(tmp_path):
    import transformers

    torch.manual_seed(3)
    size = {"hidden_size": 96, "num_hidden_layers": 4, "num_attention_heads": 6, "image_size": 70, "patch_size": 14}
    model = transformers.Dinov2Model(transformers.Dinov2Config(**size)).eval()
    torch.nn.init.normal_(model.embeddings.position_embeddings)
    errors = [export.export_dino_model(model, tmp_path / "dino.onnx", PICTURE[:224, :322])]
    network = Network(tmp_path / "dino.onnx", CPU)
    extractor = DinoExtractor(network, DinoConfig(), warm_up=False)
    for height, width in ((224, 224), (140, 392), (14, 14)):
        picture = PICTURE[:height, :width]
        with torch.no_grad():
            tokens = model(torch.from_numpy(normalised(picture))).last_hidden_state[0, 1:].numpy()
        ours = extractor.extract(picture).reshape(tokens.shape)
        errors.append(float(np.abs(ours - tokens / np.linalg.norm(tokens, axis=-1, keepdims=True)).max()))
    image = normalised(PICTURE[:28, :42])
    several, alone = (network.run(np.repeat(image, num, axis=0))[0] for num in (3, 1))
    np.testing.assert_allclose(several[[2]], alone, rtol=1e-3, atol=1e-3)
    print(f"DINOv2: features differ by at most {max(errors):.2g}")
    assert max(errors) <= export.MOST_FEATURE_ERROR


@pytest.fixture
def segments(monkeypatch):
    """OneFormer's post-processing, also without torchvision: its resizing of tensors is torch's interpolation."""
    module = pytest.importorskip("transformers.models.oneformer.image_processing_pil_oneformer")
    if not hasattr(module, "tvF"):

        def resize(images, size, interpolation):
            return torch.nn.functional.interpolate(images, size, mode="bilinear", align_corners=False, antialias=True)

        functions = SimpleNamespace(resize=resize, InterpolationMode=SimpleNamespace(BILINEAR="bilinear"))
        monkeypatch.setattr(module, "tvF", functions, raising=False)
    return module.OneFormerImageProcessorPil


def queries(seed, num=20, num_classes=12, size=(30, 40)):
    """Return logits of queries that are blobs of sure classes, some unsure, some of no class."""
    rng = np.random.default_rng(seed)
    classes = rng.normal(0, 1, (num, num_classes + 1)).astype(np.float32)
    classes[np.arange(num), rng.integers(0, num_classes + 1, num)] += rng.uniform(0, 8, num).astype(np.float32)
    y, x = np.mgrid[: size[0], : size[1]]
    at = rng.uniform(0, 1, (num, 2)) * size
    radius = rng.uniform(3, 15, num)
    distance = np.hypot(y[None] - at[:, :1, None], x[None] - at[:, 1:, None])
    masks = (radius[:, None, None] - distance) * rng.uniform(0.2, 2, (num, 1, 1)) + rng.normal(0, 0.3, distance.shape)
    return classes, masks.astype(np.float32)


@pytest.mark.parametrize("seed", range(5))
def test_classes_of_queries_equal_the_packages_processing(segments, seed):
    classes, masks = queries(seed)
    outputs = SimpleNamespace(
        class_queries_logits=torch.from_numpy(classes)[None], masks_queries_logits=torch.from_numpy(masks)[None]
    )
    config = PanopticConfig()
    panoptic = (
        panoptic_classes(classes, masks, (160, 120), config)
        == export.reference_classes(segments, outputs, (120, 160), config)
    ).mean()
    theirs = segments.post_process_semantic_segmentation(None, outputs, target_sizes=[(120, 160)])[0].numpy()
    semantic = (best_classes(query_scores(classes, masks), (160, 120)) == theirs).mean()
    print(f"OneFormer's queries, seed {seed}: panoptic {panoptic:.4%}, semantic {semantic:.4%} of the pixels agree")
    assert min(panoptic, semantic) >= export.LEAST_CLASS_AGREEMENT


def small_oneformer(num_classes=9):
    """A OneFormer of reduced size with random weights that is sure of its classes."""
    import transformers

    torch.manual_seed(5)
    backbone = transformers.SwinConfig(
        image_size=64, embed_dim=24, depths=[1, 1, 1, 1], num_heads=[2, 2, 2, 2], window_size=4,
        out_features=["stage1", "stage2", "stage3", "stage4"],
    )  # fmt: skip
    config = transformers.OneFormerConfig(
        backbone_config=backbone, num_queries=30, hidden_dim=64, conv_dim=64, mask_dim=64, encoder_feedforward_dim=64,
        dim_feedforward=64, encoder_layers=2, decoder_layers=2, num_attention_heads=4, is_training=False,
        num_labels=num_classes,
    )  # fmt: skip
    model = transformers.OneFormerForUniversalSegmentation(config).eval()
    for name, value in model.named_parameters():
        if "class_embed" in name and value.ndim == 2:
            torch.nn.init.normal_(value, 0, 1.5)
        if "class_embed" in name and value.ndim == 1:
            value.data[-1] = -8.0
    return model


def test_classes_of_a_oneformer_graph_are_those_of_the_package(segments, tmp_path):
    model = small_oneformer()
    task = torch.randint(1, 1000, (1, model.config.task_seq_len))
    labels = tuple(f"class {i}" for i in range(9))
    agreement = export.export_oneformer_model(model, task, labels, tmp_path / "one.onnx", PICTURE, (192, 128))
    from hickory_stream.perception.models.semantic_graph import GraphSemantics

    ours = GraphSemantics(
        Network(tmp_path / "one.onnx", CPU), labels, short_px=128, panoptic=PanopticConfig(), warm_up=False
    ).classify(PICTURE)
    named = np.unique(ours.classes)
    print(f"OneFormer: classes of {agreement:.3%} of the pixels agree; classes found: {named.tolist()}")
    assert agreement >= export.LEAST_CLASS_AGREEMENT
    assert (named >= 0).sum() >= 1


def test_published_folders_are_added_with_their_task(segments, tmp_path, monkeypatch, capsys):
    import transformers
    from hickory_stream.cli import main

    size = {"hidden_size": 48, "num_hidden_layers": 2, "num_attention_heads": 3, "image_size": 70, "patch_size": 14}
    transformers.Dinov2Model(transformers.Dinov2Config(**size)).save_pretrained(tmp_path / "dino")
    small_oneformer().save_pretrained(tmp_path / "one")
    ends = ["<|startoftext|>", "<|endoftext|>"]
    vocabulary = {part: i for i, part in enumerate([*ends, *"acehiknopst", *(f"{c}</w>" for c in "acehiknopst")])}
    (tmp_path / "one" / "vocab.json").write_text(json.dumps(vocabulary))
    (tmp_path / "one" / "merges.txt").write_text("#version: 0.2\n")
    tokenizer = transformers.CLIPTokenizer.from_pretrained(tmp_path / "one")
    processor = SimpleNamespace(tokenizer=tokenizer)
    theirs = transformers.OneFormerProcessor._preprocess_text(processor, ["the task is panoptic"], max_length=77)
    assert torch.equal(export.oneformer_task(tokenizer, 77), theirs)
    assert theirs.count_nonzero() == 18
    monkeypatch.setenv("HICKORY_MODELS", str(tmp_path / "models"))
    files = tuple(
        PublishedFile(name=path.name, num_bytes=path.stat().st_size, sha256=sha256_of(path))
        for path in (tmp_path / "dino").iterdir()
    )
    small = dataclasses.replace(PUBLISHED["dinov2-small"], files=files)
    monkeypatch.setitem(PUBLISHED, "dinov2-small", small)
    for name, options in (
        ("dinov2-small", ["get", "dinov2-small", "--from", tmp_path / "dino"]),
        ("one", ["add", tmp_path / "one", "--kind", "oneformer"]),
    ):
        assert main(["models", *map(str, options), "--json"]) == 0
        report = json.loads(capsys.readouterr().out)
        assert (report["name"], bool(report["compared"])) == (name, True)
    assert read_manifest(tmp_path / "models")["dinov2-small"].source == small.source
    assert not list((tmp_path / "models" / "downloads").iterdir())
