"""SAM with random weights at reduced size: our masks against segment-anything's automatic mask generator.

Needs the extra `export` and segment-anything; skipped without. Run: pytest -m reference tests/reference
"""

import sys
import types
import cv2
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the extra `export`: pip install -e '.[export]'")

from hickory_stream.perception.models.export import LEAST_IOU, ious  # noqa: E402 -- needs torch only where it is there
from hickory_stream.perception.models.network import Network, NetworkConfig  # noqa: E402
from hickory_stream.perception.models.preprocessing import built_in_picture  # noqa: E402
from hickory_stream.perception.models.sam import Sam, SamConfig  # noqa: E402

pytestmark = [pytest.mark.reference, pytest.mark.timeout(600), pytest.mark.filterwarnings("default")]

CPU = NetworkConfig(provider="cpu", warm_up=False)
SIDE, DIM = 256, 32
CHOICE = {"predicted_iou": 0.5, "stability": 0.8}


@pytest.fixture(scope="module")
def package():
    """The package, also where torchvision is not: four of its functions are then written out."""
    patch = pytest.MonkeyPatch()
    try:
        import torchvision  # noqa: F401
    except ImportError:
        from PIL import Image

        def area(boxes):
            return (boxes[:, 2:] - boxes[:, :2]).prod(dim=1)

        def nms(boxes, scores, _categories, iou_threshold):
            kept = []
            for i in torch.argsort(-scores, stable=True).tolist():
                low, high = torch.maximum(boxes[kept, :2], boxes[i, :2]), torch.minimum(boxes[kept, 2:], boxes[i, 2:])
                shared = (high - low).clamp(min=0).prod(dim=1)
                if not (shared / (area(boxes[kept]) + area(boxes[[i]]) - shared) > iou_threshold).any():
                    kept.append(i)
            return torch.tensor(kept, dtype=torch.long)

        def resize(image, size):
            return image.resize(size[::-1], Image.Resampling.BILINEAR)

        functions = {"batched_nms": nms, "box_area": area, "resize": resize, "to_pil_image": Image.fromarray}
        for name in ("", ".ops", ".ops.boxes", ".transforms", ".transforms.functional"):
            module = types.ModuleType(f"torchvision{name}")
            module.__dict__.update(functions)
            patch.setitem(sys.modules, module.__name__, module)
    yield pytest.importorskip("segment_anything")
    patch.undo()


@pytest.fixture(scope="module")
def sam(package):
    from segment_anything.modeling import ImageEncoderViT, MaskDecoder, PromptEncoder, Sam, TwoWayTransformer

    class Local(MaskDecoder):
        """Masks around places that depend on the prompt: those of random weights reach over the whole image."""

        def predict_masks(self, **given):
            masks, ious = super().predict_masks(**given)
            low = masks.shape[-1]
            center = low * torch.sigmoid(2 * given["sparse_prompt_embeddings"][:, 0, :8].reshape(-1, 4, 2))
            off = torch.arange(low) - center[..., None]
            return masks + 16 - (off[:, :, 0, :, None] ** 2 + off[:, :, 1, None, :] ** 2) / 3, ious

    torch.manual_seed(11)
    grid = SIDE // 16
    model = Sam(
        ImageEncoderViT(
            img_size=SIDE, embed_dim=48, depth=2, num_heads=3, out_chans=DIM, use_rel_pos=True, window_size=4,
            global_attn_indexes=(1,),
        ),
        PromptEncoder(
            embed_dim=DIM, image_embedding_size=(grid, grid), input_image_size=(SIDE, SIDE), mask_in_chans=16
        ),
        Local(
            num_multimask_outputs=3, transformer_dim=DIM,
            transformer=TwoWayTransformer(depth=2, embedding_dim=DIM, mlp_dim=64, num_heads=4),
        ),
    ).eval()  # fmt: skip
    for name, value in model.named_parameters():
        if "iou_prediction_head.layers.2.weight" in name:
            value.data *= 3
        if "iou_prediction_head.layers.2.bias" in name:
            value.data += 0.5
    return model


def exported(sam, folder, *, is_batched):
    """Encoder and decoder, with the names of the package's own export."""
    from segment_anything.utils.onnx import SamOnnxModel

    grid = SIDE // 16
    tensors = {
        "image_embeddings": torch.zeros(1, DIM, grid, grid), "point_coords": torch.zeros(2 if is_batched else 1, 2, 2),
        "point_labels": torch.ones(2 if is_batched else 1, 2), "mask_input": torch.zeros(1, 1, 4 * grid, 4 * grid),
        "has_mask_input": torch.zeros(1), "orig_im_size": torch.tensor([150.0, 200.0]),
    }  # fmt: skip
    axes = {0: "prompts", 1: "points"} if is_batched else {1: "points"}
    options = {"opset_version": 18, "dynamo": False}
    torch.onnx.export(
        sam.image_encoder, (torch.zeros(1, 3, SIDE, SIDE),), str(folder / "encoder.onnx"), input_names=["input_image"],
        output_names=["image_embeddings"], **options,
    )  # fmt: skip
    torch.onnx.export(
        SamOnnxModel(sam, return_single_mask=False), tuple(tensors.values()), str(folder / "decoder.onnx"),
        input_names=list(tensors), output_names=["masks", "iou_predictions", "low_res_masks"],
        dynamic_axes={"point_coords": axes, "point_labels": axes}, **options,
    )  # fmt: skip
    return Network(folder / "encoder.onnx", CPU), Network(folder / "decoder.onnx", CPU)


@pytest.mark.parametrize("is_batched", [False, True], ids=["one prompt a run", "batches"])
def test_masks_equal_the_automatic_mask_generators(package, sam, tmp_path, is_batched):
    encoder, decoder = exported(sam, tmp_path, is_batched=is_batched)
    ours = Sam(encoder, decoder, SamConfig(points_per_side=12, **CHOICE), warm_up=False)
    generator = package.SamAutomaticMaskGenerator(
        sam, points_per_side=12, pred_iou_thresh=CHOICE["predicted_iou"], stability_score_thresh=CHOICE["stability"]
    )
    for size in ((200, 150), (120, 180), (400, 300)):
        picture = cv2.resize(built_in_picture(), size, interpolation=cv2.INTER_AREA)
        theirs = [found["segmentation"] for found in generator.generate(picture)]
        masks, num_not_finite = ours.masks(picture)
        found = ious([whole(mask, picture.shape) for mask in masks], theirs)
        print(f"SAM, {size}: {len(theirs)} masks, IoU {found.mean():.5f}, worst {found.min():.4f}")
        assert num_not_finite == 0
        assert len(masks) == len(theirs) >= 5
        assert found.mean() >= LEAST_IOU
    assert (decoder.num_runs > 100) != is_batched


def whole(mask, shape):
    full = np.zeros(shape[:2], bool)
    x0, y0, x1, y1 = mask.box_px
    full[y0:y1, x0:x1] = mask.mask
    return full
