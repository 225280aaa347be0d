from dataclasses import replace
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from onnx import TensorProto, helper
from hickory_stream.errors import ModelError
from hickory_stream.perception.choose import make_segmenter
from hickory_stream.perception.models.fastsam import FastSam, FastSamConfig, FastSamSegmenter
from hickory_stream.perception.models.network import Network, NetworkConfig
from hickory_stream.perception.models.preprocessing import letterbox_of, letterboxed
from hickory_stream.perception.models.yolo_masks import detections_of, suppressed
from hickory_stream.perception.perceive import PerceptionConfig
from hickory_stream.records import Frame
from tests.perception import small_graphs
from tests.perception.perception_scenes import CAMERA, Block, best_iou, floor, looking, render

CPU = NetworkConfig(provider="cpu")
SIDE, PROTO = 64, 16


def graph(path, boxes, scores=None, coefficients=None, prototypes=None):
    """A graph of two prototypes: 1 everywhere, and 1 in the left half, -1 in the right one."""
    count = len(boxes)
    if prototypes is None:
        halves = np.ones((PROTO, PROTO), np.float32)
        halves[:, PROTO // 2 :] = -1
        prototypes = np.stack([np.ones((PROTO, PROTO), np.float32), halves])
    scores = np.full((count, 1), 0.9) if scores is None else np.asarray(scores, float).reshape(count, -1)
    coefficients = np.tile([1.0, 0.0], (count, 1)) if coefficients is None else np.asarray(coefficients, float)
    boxes = np.asarray(boxes, float).reshape(-1, 4)
    return small_graphs.yolo(path, boxes, prototypes=prototypes, scores=scores, coefficients=coefficients, side=SIDE)


def masks_by(file, rgb, **config):
    return FastSam(Network(file, CPU), FastSamConfig(**config)).masks(rgb)


def test_a_box_of_the_network_is_that_part_of_the_image(tmp_path):
    # 128 x 64 in 64 x 64: half the size, 16 rows of grey above and below.
    masks, _ = masks_by(graph(tmp_path / "a.onnx", [(32, 32, 32, 16)]), np.zeros((64, 128, 3), np.uint8))
    assert [m.box_px for m in masks] == [(32, 16, 96, 48)]
    assert masks[0].mask.all()
    assert masks[0].score == pytest.approx(0.9)


def test_a_mask_is_where_the_sum_of_prototypes_is_positive(tmp_path):
    file = graph(tmp_path / "a.onnx", [(32, 32, 64, 32)], coefficients=[(0.0, 1.0)])
    (mask,), _ = masks_by(file, np.zeros((64, 128, 3), np.uint8))
    assert mask.box_px == (0, 0, 128, 64)
    assert mask.mask[:, :64].all()
    assert not mask.mask[:, 64:].any()


def test_the_worse_of_overlapping_boxes_of_a_class_goes(tmp_path):
    boxes = [(32, 32, 20, 20), (33, 32, 20, 20), (32, 33, 20, 20)]
    one = graph(tmp_path / "one.onnx", boxes, scores=[0.6, 0.9, 0.5])
    assert [m.score for m in masks_by(one, np.zeros((64, 64, 3), np.uint8), nms_iou=0.7)[0]] == [pytest.approx(0.9)]
    two = graph(tmp_path / "two.onnx", boxes, scores=[(0.6, 0), (0.9, 0), (0, 0.5)])
    scores = [m.score for m in masks_by(two, np.zeros((64, 64, 3), np.uint8), nms_iou=0.7)[0]]
    assert scores == [pytest.approx(0.9), pytest.approx(0.5)]


@given(st.data())
def test_suppression_keeps_the_best_and_nothing_that_overlaps(data):
    count = data.draw(st.integers(0, 30))
    corners = np.array(data.draw(st.lists(st.tuples(*[st.integers(0, 20)] * 4), min_size=count, max_size=count)))
    corners = corners.reshape(-1, 4)
    boxes = np.concatenate([corners[:, :2], corners[:, :2] + corners[:, 2:] + 1], axis=1).astype(np.float32)
    kept = suppressed(boxes, 0.5, 10)

    def iou(a, b):
        shared = np.prod(np.maximum(0, np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2])))
        return shared / (np.prod(a[2:] - a[:2]) + np.prod(b[2:] - b[:2]) - shared)

    assert list(kept) == sorted(kept)
    assert count == 0 or kept[0] == 0
    assert all(iou(boxes[i], boxes[j]) <= 0.5 for i in kept for j in kept if i < j)
    if len(kept) < 10:
        left_out = set(range(count)) - set(kept.tolist())
        assert all(any(iou(boxes[i], boxes[j]) > 0.5 for i in kept if i < j) for j in left_out)


def test_no_detection_gives_no_mask(tmp_path):
    file = graph(tmp_path / "a.onnx", [(32, 32, 10, 10)], scores=[0.01])
    assert masks_by(file, np.zeros((64, 64, 3), np.uint8)) == ([], 0)


def test_a_detection_that_is_not_finite_is_left_out_and_counted():
    predictions = np.array([[32, 32, 8, 8, 0.9, 1], [20, np.nan, 8, 8, 0.9, 1], [9, 9, 8, 8, np.inf, 1]], np.float32).T
    found = detections_of(predictions, 1, confidence=0.4, nms_iou=0.9, max_masks=10)
    assert len(found.boxes) == 1
    assert found.num_not_finite == 2


@pytest.mark.parametrize("shape", [(1, 1), (1, 640), (480, 1), (3, 5)], ids=str)
def test_an_image_of_any_size_goes_through(tmp_path, shape):
    masks, _ = masks_by(graph(tmp_path / "a.onnx", [(32, 32, 64, 64)]), np.zeros((*shape, 3), np.uint8))
    assert [m.mask.shape for m in masks] == [shape]


@given(st.integers(1, 900), st.integers(1, 900), st.integers(1, 20), st.integers(1, 20))
def test_an_image_fits_the_networks_frame_and_corners_come_back(width, height, columns, rows):
    box = letterbox_of(width, height, 32 * columns, 32 * rows)
    assert 0 <= box.left <= box.left + box.inner_width <= box.frame_width
    assert 0 <= box.top <= box.top + box.inner_height <= box.frame_height
    inner = [box.left, box.top, box.left + box.inner_width, box.top + box.inner_height]
    assert box.to_image(np.array([inner], np.float32))[0] == pytest.approx([0, 0, width, height], abs=1e-3)


def test_around_the_image_is_grey():
    image = letterboxed(np.zeros((10, 20, 3), np.uint8), letterbox_of(20, 10, 32, 32))
    assert image.shape == (1, 3, 32, 32)
    assert image[0, 0, 0, 0] == pytest.approx(114 / 255)
    assert (image[0, :, 8:24] == 0).all()


def test_masks_decoded_at_a_stated_size_are_nearly_the_same(tmp_path):
    file = graph(tmp_path / "a.onnx", [(32, 32, 40, 20)], coefficients=[(0.0, 1.0)])
    rgb = np.zeros((240, 480, 3), np.uint8)
    ((full,), _), ((small,), _) = masks_by(file, rgb), masks_by(file, rgb, mask_px=120)
    a, b = np.zeros(rgb.shape[:2], bool), np.zeros(rgb.shape[:2], bool)
    for whole, mask in ((a, full), (b, small)):
        x0, y0, x1, y1 = mask.box_px
        whole[y0:y1, x0:x1] = mask.mask
    assert (a & b).sum() / (a | b).sum() > 0.95


def test_graphs_of_other_kinds_are_refused_with_what_they_have(tmp_path):
    tokens = small_graphs.dino(tmp_path / "dino.onnx")
    with pytest.raises(ModelError, match=r"no YOLOv8-seg graph: expected predictions .*; found .*tokens \(1, any, 3\)"):
        FastSam(Network(tokens, CPU), FastSamConfig())
    node = helper.make_node("Identity", ["image"], ["same"])
    grey = small_graphs.save(
        tmp_path / "grey.onnx", [node], [("same", TensorProto.FLOAT, (1, 1, 8, 8))], image=(1, 1, 8, 8)
    )
    with pytest.raises(ModelError, match=r"expected one image \(1, 3, H, W\)"):
        FastSam(Network(grey, CPU), FastSamConfig())


def segmenter_of(file):
    network = FastSam(Network(file, CPU), FastSamConfig(max_masks=3000))
    return FastSamSegmenter(network, make_segmenter(PerceptionConfig()))


def box_scene():
    view = looking((0.0, 0.0, 0.3), start=(-2.2, -0.3, 1.5))
    return render([floor(), Block(low=(-0.2, -0.2, 0.0), high=(0.2, 0.2, 0.4), color=(190, 40, 40))], view)


def in_network(box):
    """Return x, y, w, h in the network's frame of a box of the camera's image."""
    letterbox = letterbox_of(CAMERA.width, CAMERA.height, SIDE, SIDE)
    scale = letterbox.inner_width / CAMERA.width
    x0, y0, x1, y1 = (v * scale for v in box)
    return ((x0 + x1) / 2 + letterbox.left, (y0 + y1) / 2 + letterbox.top, x1 - x0, y1 - y0)


def test_the_mask_of_a_thing_is_an_instance_and_the_floor_is_not(tmp_path):
    frame, shown = box_scene()
    ys, xs = np.nonzero(shown == 1)
    thing = (xs.min(), ys.min(), xs.max() + 1, ys.max() + 1)
    ground = (0, CAMERA.height * 3 // 4, CAMERA.width, CAMERA.height)
    file = graph(tmp_path / "a.onnx", [in_network(thing), in_network(ground)])
    result = segmenter_of(file).segment(frame)
    assert result.instances.max() == 1
    assert best_iou(result.instances, shown == 1)[0] > 0.6
    assert not (result.structure & (result.instances > 0)).any()


def test_masks_are_the_same_at_another_pose_of_the_frame(tmp_path):
    frame, _ = box_scene()
    segmenter = segmenter_of(graph(tmp_path / "a.onnx", [(32, 32, 20, 20)]))
    turned = frame.world_from_camera.copy()
    turned[:3, 3] += (0.1, -0.2, 0.05)
    moved = replace(frame, world_from_camera=turned)
    ahead = segmenter.moved(segmenter.prepare(frame), turned)
    np.testing.assert_array_equal(ahead.base.surface.points_world, segmenter.prepare(moved).base.surface.points_world)
    one, other = segmenter.segment(moved, None, ahead), segmenter.segment(moved)
    assert (one.instances == other.instances).all()
    assert one.floor_z_m == other.floor_z_m


def test_a_network_that_gives_nan_leaves_geometry_and_says_so(tmp_path, caplog):
    frame, _ = box_scene()
    result = segmenter_of(graph(tmp_path / "a.onnx", [(np.nan, 30, 20, 20)])).segment(frame)
    assert result.instances.max() == 1
    assert result.rejected[-1].reason == "1 detections of the network are not finite"
    assert "NaN" in caplog.text


def test_three_thousand_masks_are_sorted_out(tmp_path):
    frame, _ = box_scene()
    rng = np.random.default_rng(4)
    boxes = np.concatenate([rng.uniform(8, 56, (3000, 2)), rng.uniform(2, 20, (3000, 2))], axis=1)
    file = graph(tmp_path / "a.onnx", boxes, scores=rng.uniform(0.5, 1, 3000))
    result = segmenter_of(file).segment(frame)
    count = int(result.instances.max())
    assert set(np.unique(result.instances)) == set(range(count + 1))
    assert all(r.reason for r in result.rejected)


def test_a_frame_of_one_pixel_has_no_instance(tmp_path):
    camera = type(CAMERA)(width=1, height=1, fx=1.0, fy=1.0, cx=0.0, cy=0.0)
    one = Frame(
        index=0, stamp_ns=0, rgb=np.zeros((1, 1, 3), np.uint8), depth_m=np.ones((1, 1), np.float32), camera=camera,
        world_from_camera=np.eye(4),
    )  # fmt: skip
    assert segmenter_of(graph(tmp_path / "a.onnx", [(32, 32, 64, 64)])).segment(one).instances.max() == 0
