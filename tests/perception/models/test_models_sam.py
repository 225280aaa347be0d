import numpy as np
import pytest
from onnx import TensorProto, helper, numpy_helper
from hickory_stream.errors import ModelError
from hickory_stream.perception.models.dinov2 import DinoConfig, DinoExtractor
from hickory_stream.perception.models.network import Network, NetworkConfig
from hickory_stream.perception.models.sam import Sam, SamConfig, pair_of
from tests.perception import small_graphs

CPU = NetworkConfig(provider="cpu")


def sam(folder, **config):
    files = pair_of(folder)
    config = SamConfig(**{"stability": 0.5, **config})
    return Sam(Network(files["encoder"], CPU), Network(files["decoder"], CPU), config)


def middle_and_size(mask):
    x0, y0, x1, y1 = mask.box_px
    return (x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0


@pytest.mark.parametrize("batched", [True, False])
def test_each_prompt_of_the_grid_has_its_masks(tmp_path, batched):
    # 128 x 64 px in a network of 64 px: half the size, padded below.
    pair = small_graphs.sam_pair(tmp_path, batched=batched, radii=(2, 1.8), ious=(0.95, 0.9))
    masks, num_not_finite = sam(pair, points_per_side=2).masks(np.zeros((64, 128, 3), np.uint8))
    assert num_not_finite == 0
    assert [mask.score for mask in masks] == pytest.approx([0.95] * 4)
    found = np.array([middle_and_size(mask) for mask in masks])
    assert found[:, :2] == pytest.approx(np.array([(32, 16), (96, 16), (32, 48), (96, 48)]), abs=1.5)
    assert found[:, 2:] == pytest.approx(np.full((4, 2), 32), abs=4)
    assert masks[0].mask.mean() == pytest.approx(np.pi / 4, abs=0.07)


def test_sam_2_stretches_where_sam_1_pads(tmp_path):
    pair = small_graphs.sam_pair(tmp_path, version=2, radii=(3,), ious=(0.95,))
    masks, _ = sam(pair, points_per_side=2).masks(np.zeros((64, 128, 3), np.uint8))
    expected = [(x, y, 48, 24) for y in (16, 48) for x in (32, 96)]
    np.testing.assert_allclose([middle_and_size(mask) for mask in masks], expected, atol=4)


def test_masks_of_low_iou_or_stability_are_left_out(tmp_path):
    rgb = np.zeros((64, 64, 3), np.uint8)
    pair = small_graphs.sam_pair(tmp_path)
    scores = {
        (iou, stability): {round(m.score, 2) for m in sam(pair, predicted_iou=iou, stability=stability).masks(rgb)[0]}
        for iou, stability in ((0.4, 0.5), (0.7, 0.5), (0.93, 0.5), (0.4, 0.8))
    }
    # The areas one logit above and below the threshold are those of squared radii that differ by 2.
    assert list(scores.values()) == [{0.95, 0.9, 0.5}, {0.95, 0.9}, {0.95}, {0.9, 0.5}]


@pytest.mark.parametrize(
    ("radii", "ious", "kept"),
    [((4, 4.2, 4), (0.9, 0.95, 0.92), [0.95]), ((5, 2, 3, 4), (0.99, 0.9, 0.9, 0.9), [0.9] * 3)],
    ids=["the best of like boxes", "of four masks not the one for several prompts"],
)
def test_which_masks_of_a_prompt_stay(tmp_path, radii, ious, kept):
    pair = small_graphs.sam_pair(tmp_path, radii=radii, ious=ious)
    masks, _ = sam(pair, points_per_side=1).masks(np.zeros((64, 64, 3), np.uint8))
    assert [mask.score for mask in masks] == pytest.approx(kept)


@pytest.mark.parametrize(
    "bad", [{"ious": (np.nan, 0.9)}, {"radii": (np.inf, 4), "ious": (0.9, 0.9)}], ids=["iou", "mask"]
)
def test_predictions_that_are_not_finite_are_left_out_and_counted(tmp_path, bad):
    pair = small_graphs.sam_pair(tmp_path, **{"radii": (4, 4), **bad})
    masks, num_not_finite = sam(pair, points_per_side=3).masks(np.zeros((64, 64, 3), np.uint8))
    assert num_not_finite == 9
    assert len(masks) == 9


@pytest.mark.parametrize("shape", [(1, 1), (1, 300), (480, 640)], ids=str)
def test_a_mask_may_cover_the_whole_of_any_image(tmp_path, shape):
    pair = small_graphs.sam_pair(tmp_path, radii=(99,), ious=(0.95,))
    masks, _ = sam(pair, points_per_side=2).masks(np.zeros((*shape, 3), np.uint8))
    assert len(masks) >= 1
    assert all(mask.mask.shape == shape and mask.mask.all() for mask in masks)


def test_pairs_of_another_kind_are_refused_with_what_they_have(tmp_path):
    pair = small_graphs.sam_pair(tmp_path)
    with pytest.raises(ModelError, match=r"one \*encoder\*.onnx and one \*decoder\*.onnx .*: none"):
        pair_of(tmp_path / "empty")
    dino = Network(small_graphs.dino(tmp_path / "dino.onnx"), CPU)
    encoder = Network(pair / "x.encoder.onnx", CPU)
    with pytest.raises(ModelError, match=r"no SAM decoder graph: expected point_coords .* found inputs image"):
        Sam(encoder, dino, SamConfig())
    second = small_graphs.sam_pair(tmp_path / "second", version=2)
    with pytest.raises(
        ModelError, match="no SAM encoder graph: expected the outputs image_embed, high_res_feats_0 for"
    ):
        Sam(encoder, Network(second / "x.decoder.onnx", CPU), SamConfig())


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
