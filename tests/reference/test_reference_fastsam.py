"""FastSAM with random weights: our pre- and post-processing against ultralytics' own prediction code.

Needs the extra `export` (torch, ultralytics, transformers); skipped without. Run: pytest -m reference tests/reference
"""

import importlib.metadata
import sys
import types
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the extra `export`: pip install -e '.[export]'")

import hickory_stream.perception.models.export as export  # noqa: E402 -- needs torch only where it is there
from hickory_stream.perception.models.fastsam import FastSamConfig  # noqa: E402
from hickory_stream.perception.models.network import Network, NetworkConfig  # noqa: E402
from hickory_stream.perception.models.preprocessing import built_in_picture, letterbox_of, letterboxed  # noqa: E402

pytestmark = [pytest.mark.reference, pytest.mark.timeout(600), pytest.mark.filterwarnings("default")]

PICTURE = built_in_picture()
SIZES = [(640, 480), (600, 400), (480, 640), (333, 517)]


def resized(size):
    import cv2

    return cv2.resize(PICTURE, size, interpolation=cv2.INTER_AREA)


@pytest.fixture(scope="module")
def ultralytics(tmp_path_factory):
    """The package, also where torchvision is not: its own suppression in torch then takes the place of that one."""
    settings = tmp_path_factory.mktemp("ultralytics")
    patch = pytest.MonkeyPatch()
    patch.setenv("YOLO_AUTOINSTALL", "false")
    patch.setenv("YOLO_CONFIG_DIR", str(settings))
    version = importlib.metadata.version
    is_missing = not any(d.name == "torchvision" for d in importlib.metadata.distributions())
    if is_missing:
        stand_in = f"0.{int(torch.__version__.split('.')[1]) + 15}.0"
        patch.setattr(importlib.metadata, "version", lambda name: stand_in if name == "torchvision" else version(name))
    package = pytest.importorskip("ultralytics")
    if is_missing:
        from ultralytics.utils.nms import TorchNMS

        module = types.ModuleType("torchvision")
        module.ops = types.SimpleNamespace(nms=TorchNMS.nms)
        patch.setitem(sys.modules, "torchvision", module)
    yield package
    patch.undo()


@pytest.fixture(scope="module", params=[1, 3], ids=["one class", "three classes"])
def yolo(request, ultralytics, tmp_path_factory):
    """A YOLOv8-seg of the smallest size with random weights, saved as FastSAM's files are, and its graph."""
    from ultralytics import YOLO, FastSAM
    from ultralytics.nn.tasks import SegmentationModel

    torch.manual_seed(7)
    folder = tmp_path_factory.mktemp("yolo")
    network = YOLO("yolov8n-seg.yaml")
    args = network.model.args
    network.model = SegmentationModel("yolov8n-seg.yaml", nc=request.param, verbose=False)
    network.model.task, network.model.args = "segment", args
    head = network.model.model[-1]
    # Statistics of the picture itself, as after training: a random network without them gives the same everywhere.
    norms = [module for module in network.model.modules() if isinstance(module, torch.nn.BatchNorm2d)]
    momenta = [norm.momentum for norm in norms]
    for norm in norms:
        norm.momentum = 1.0
    with torch.no_grad():
        network.model.train()(torch.from_numpy(letterboxed(PICTURE, letterbox_of(600, 400, 640, 640))))
    for norm, momentum in zip(norms, momenta, strict=True):
        norm.momentum = momentum
    for branch in head.cv3:
        torch.nn.init.normal_(branch[-1].weight, 0, 0.15)
        torch.nn.init.constant_(branch[-1].bias, -1.0)
    for branch in head.cv2:
        torch.nn.init.normal_(branch[-1].weight, 0, 0.2)
    for branch in head.cv4:
        torch.nn.init.normal_(branch[-1].weight, 0, 0.3)
    weights = folder / "FastSAM-tiny.pt"
    network.save(weights)
    kind = FastSAM if request.param == 1 else YOLO
    file = folder / "graph.onnx"
    export.export_yolo(kind(str(weights)), file, 640)
    return kind(str(weights)), file


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_masks_of_a_yolo_graph_equal_the_packages_predictor(yolo, size):
    model, file = yolo
    picture = resized(size)
    config = FastSamConfig(confidence=0.3, nms_iou=0.7, max_masks=100)
    ours = export.fastsam_masks(file, picture, config)
    theirs = export.reference_fastsam_masks(model, picture, 640, config)
    found = export.ious(ours, theirs)
    print(f"{type(model).__name__}, {size}: {len(theirs)} masks, IoU {found.mean():.5f}, worst {found.min():.4f}")
    assert len(ours) == len(theirs) >= 10
    assert found.mean() >= export.LEAST_IOU
    assert np.mean(found >= export.LEAST_IOU) >= 0.95


def test_a_yolo_graph_takes_several_images_of_its_size(yolo):
    network = Network(yolo[1], NetworkConfig(provider="cpu", warm_up=False))
    assert network.inputs[0].shape == (None, 3, 640, 640)
    image = letterboxed(PICTURE, letterbox_of(600, 400, 640, 640))
    together = network.run(np.concatenate([image[..., ::-1], image, image]))
    for several, alone in zip(together, network.run(image), strict=True):
        np.testing.assert_allclose(several[[2]], alone, rtol=1e-3, atol=1e-3)
