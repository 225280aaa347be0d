import numpy as np
import pytest
from onnx import TensorProto
from hickory_stream.errors import ConfigError, ModelError
from hickory_stream.perception.models.network import Network, NetworkConfig
from hickory_stream.perception.models.semantic_graph import GraphSemantics, PanopticConfig
from hickory_stream.perception.semantic_filter import FilterConfig, excluded_classes, without_classes
from hickory_stream.records import Segmentation, SemanticImage
from tests.perception import small_graphs

CPU = NetworkConfig(provider="cpu")
LABELS = ("wall", "person, someone", "cup")
NAMED = FilterConfig(structure=("wall",), dynamic=("Person",))


def model_of(file, labels=LABELS, short_px=64, **panoptic):
    return GraphSemantics(Network(file, CPU), labels, short_px=short_px, panoptic=PanopticConfig(**panoptic))


def test_the_class_of_a_pixel_has_the_highest_score(tmp_path):
    rgb = np.zeros((96, 128, 3), np.uint8)
    rgb[:, :64, 0] = 255
    rgb[:48, 64:, 1] = 255
    rgb[48:, 64:, 2] = 255
    result = model_of(small_graphs.scores_by_color(tmp_path / "a.onnx")).classify(rgb)
    expected = rgb.argmax(axis=2)
    assert result.classes.shape == (96, 128)
    assert (result.classes == expected).mean() > 0.95


@pytest.mark.parametrize("size", [(1, 1), (1, 200), (333, 20)], ids=str)
def test_an_image_of_any_size_has_a_class_per_pixel(tmp_path, size):
    file = small_graphs.scores_by_color(tmp_path / "a.onnx")
    assert model_of(file).classify(np.full((*size, 3), 9, np.uint8)).classes.shape == size


def two_queries(path, masks=None):
    """A sure cup on the left, a sure wall on the right, and one query of no class."""
    logits = np.array([(0, 0, 9, 0), (9, 0, 0, 0), (0, 0, 0, 9)], np.float32)
    if masks is None:
        masks = np.full((3, 16, 16), -9, np.float32)
        masks[0, :, :8] = masks[1, :, 8:] = 9
    return small_graphs.queries(path, logits, masks)


@pytest.mark.parametrize("output", ["panoptic", "semantic"])
def test_queries_become_the_classes_of_their_masks(tmp_path, output):
    model = model_of(two_queries(tmp_path / "a.onnx"), output=output)
    classes = model.classify(np.zeros((64, 64, 3), np.uint8)).classes
    assert (classes[:, :30] == 2).all()
    assert (classes[:, 34:] == 0).all()


def test_a_query_that_others_leave_little_of_is_no_segment(tmp_path):
    masks = np.full((3, 16, 16), -9, np.float32)
    masks[0] = 9
    masks[1] = 3
    classes = model_of(two_queries(tmp_path / "a.onnx", masks)).classify(np.zeros((64, 64, 3), np.uint8)).classes
    assert set(np.unique(classes)) == {2}


def test_queries_that_are_not_finite_claim_nothing(tmp_path):
    file = small_graphs.queries(
        tmp_path / "a.onnx", np.full((2, 4), np.nan, np.float32), np.full((2, 8, 8), np.nan, np.float32)
    )
    for output in ("panoptic", "semantic"):
        assert (model_of(file, output=output).classify(np.zeros((20, 30, 3), np.uint8)).classes == -1).all()


def test_a_table_of_another_length_is_refused(tmp_path):
    with pytest.raises(ModelError, match="has 3 classes, the manifest names 1"):
        model_of(small_graphs.scores_by_color(tmp_path / "a.onnx"), labels=("wall",))
    with pytest.raises(ModelError, match="has 3 classes, the manifest names 4"):
        model_of(two_queries(tmp_path / "b.onnx"), labels=(*LABELS, "lid"))


def test_ids_of_no_class_are_no_class(tmp_path):
    ids = np.array([[[0, 2, np.nan, -5]]], np.float32)
    file = small_graphs.save(
        tmp_path / "a.onnx", small_graphs.anything("ids"), [("ids", TensorProto.FLOAT, ids.shape)],
        constants=[("ids_", ids)],
    )  # fmt: skip
    assert model_of(file).classify(np.zeros((1, 4, 3), np.uint8)).classes.tolist() == [[0, 2, -1, -1]]


def test_classes_are_found_by_any_of_their_names():
    found = excluded_classes(LABELS, NAMED)
    assert (found.structure, found.dynamic) == ({0}, {1})


def test_an_unknown_class_is_refused_and_defaults_may_be_absent():
    with pytest.raises(ConfigError, match=r"no class is called wal; it has wall, person"):
        excluded_classes(LABELS, FilterConfig(structure=("wal",)))
    assert excluded_classes(LABELS, FilterConfig()).structure == {0}
    with pytest.raises(ConfigError, match="none of the excluded classes"):
        excluded_classes(("cup",), FilterConfig())


def filtered(classes, instances, config=NAMED):
    segmentation = Segmentation(instances=instances, structure=np.zeros(instances.shape, bool))
    semantics = SemanticImage(classes=classes, labels=LABELS)
    return without_classes(segmentation, semantics, excluded_classes(LABELS, config), config)


def test_a_mask_is_rejected_from_the_stated_share_on():
    instances = np.zeros((10, 30), np.int32)
    instances[:, :10], instances[:, 10:20], instances[:, 20:] = 1, 2, 3
    classes = np.full((10, 30), 2, np.int32)
    classes[:3, :10] = 1
    classes[:2, 10:20] = 1
    result = filtered(classes, instances, FilterConfig(structure=("wall",), dynamic=("person",), share=0.3, iou=1.0))
    assert [r.reason for r in result.rejected] == ["30% of it is person, someone"]
    assert result.rejected[0].box_px == (0, 0, 10, 10)
    assert result.rejected[0].mask.all()
    assert set(np.unique(result.instances)) == {0, 1, 2}
    assert (result.instances[:, 10:20] == 1).all()


def test_a_mask_is_rejected_for_covering_the_whole_of_a_class():
    instances = np.ones((10, 10), np.int32)
    classes = np.full((10, 10), 2, np.int32)
    classes[:2] = 1
    config = FilterConfig(structure=(), dynamic=("person",), share=0.9, iou=0.2)
    assert [r.reason for r in filtered(classes, instances, config).rejected] == ["overlaps person, someone (IoU 0.20)"]


def test_a_mask_called_wall_in_one_frame_stays_and_its_pixels_are_votes():
    classes = np.zeros((10, 20), np.int32)
    instances = np.zeros((10, 20), np.int32)
    instances[:, :10] = 1
    result = filtered(classes, instances)
    assert (result.instances == instances).all()
    assert result.rejected == ()
    assert result.own_structure.all()
    assert not result.structure[:, :10].any()


def test_wall_pixels_become_structure_and_people_nothing():
    classes = np.full((10, 20), 2, np.int32)
    classes[:, :5], classes[:, 5:10] = 0, 1
    result = filtered(classes, np.zeros((10, 20), np.int32))
    assert result.structure[:, :5].all()
    assert not result.structure[:, 5:].any()
