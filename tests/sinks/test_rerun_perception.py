from dataclasses import replace
import numpy as np
from hickory_stream.geometry.camera import Camera
from hickory_stream.records import FrameReport, RejectedMask
from hickory_stream.sinks.rerun.frame import FeatureColors, rejected_items

REPORT = FrameReport(
    index=0, stamp_ns=0, keyframe_index=0, camera=Camera(width=40, height=30, fx=30.0, fy=30.0, cx=20.0, cy=15.0),
    world_from_camera=np.eye(4), color_bytes=None,
)  # fmt: skip


def test_rejected_masks_are_shown_in_place_with_reasons():
    masked = RejectedMask(box_px=(2, 3, 6, 5), reason="too small", mask=np.array([[1, 0, 0, 1], [0, 0, 0, 1]], bool))
    boxed = RejectedMask(box_px=(10, 10, 20, 20), reason="3.2 m long: structure")
    image, boxes = rejected_items(replace(REPORT, rejected=(masked, boxed)))
    pixels = np.frombuffer(image.archetypes[0].buffer.as_arrow_array().flatten().to_numpy(), np.uint16).reshape(30, 40)
    assert sorted(zip(*np.nonzero(pixels), strict=True)) == [(3, 2), (3, 5), (4, 5)]
    assert boxes.archetypes[0].labels.as_arrow_array().to_pylist() == ["too small", "3.2 m long: structure"]


def test_a_keyframe_without_rejected_masks_empties_the_last_ones():
    _, boxes = rejected_items(REPORT)
    assert len(boxes.archetypes[0].centers.as_arrow_array()) == 0


def test_features_show_only_where_computed_and_keep_colors():
    colors, rng = FeatureColors(), np.random.default_rng(0)
    patches = rng.normal(0, 1, (3, 4, 8)).astype(np.float32)
    assert colors.items(REPORT) == []
    (first,) = colors.items(replace(REPORT, patches=patches))
    colors.items(replace(REPORT, patches=rng.normal(3, 1, (3, 4, 8)).astype(np.float32)))
    (again,) = colors.items(replace(REPORT, patches=patches))
    blobs = [item.archetypes[0].blob.as_arrow_array().to_pylist() for item in (first, again)]
    assert blobs[0] == blobs[1]
