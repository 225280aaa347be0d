from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.box_scene import SceneSource
from hickory_stream.geometry.camera import Camera
from hickory_stream.perception.choose import make_segmenter
from hickory_stream.perception.perceive import PerceptionConfig
from hickory_stream.records import MapPrior, ObservedSpace
from hickory_stream.testing import InstanceSegmenter
from tests.engine.run_fixtures import NO_SHAPES, map_scene
from tests.examples.plane_segmenter import PlaneSegmenter
from tests.perception.perception_scenes import CAMERA, Block, best_iou, floor, looking, render

SIZES = {
    "whole": CAMERA,
    "odd": Camera(width=161, height=91, fx=140.0, fy=140.0, cx=80.0, cy=45.0),
    "one_pixel": Camera(width=1, height=1, fx=1.0, fy=1.0, cx=0.0, cy=0.0),
}
VIEW = looking((0.0, 0.0, 0.2), start=(-2.2, -0.3, 1.5))
LEFT = Block(low=(-0.15, 0.25, 0.0), high=(0.15, 0.55, 0.35), color=(190, 40, 40))
RIGHT = Block(low=(-0.15, -0.55, 0.0), high=(0.15, -0.25, 0.35), color=(40, 60, 190))
# Each frame has a stamp of its own: by it the twin in memory, which reads the truth, knows its instances.
SHOTS = {name: render([floor(), LEFT, RIGHT], VIEW, camera) for name, camera in SIZES.items()}
FRAMES = {name: replace(frame, stamp_ns=i) for i, (name, (frame, _)) in enumerate(SHOTS.items())}
TRUTH = {FRAMES[name].stamp_ns: np.maximum(shown, 0).astype(np.int32) for name, (_, shown) in SHOTS.items()}

SEGMENTERS = {
    "example": PlaneSegmenter,
    "geometric": lambda: make_segmenter(PerceptionConfig(segmenter="geometric")),
    "network": lambda: make_segmenter(PerceptionConfig(segmenter="network")),
    "twin": lambda: InstanceSegmenter({**TRUTH, **SceneSource(8).instances}),
}


@pytest.fixture(scope="module", params=sorted(SEGMENTERS))
def segmenter(request):
    return SEGMENTERS[request.param]()


def check(frame, result):
    """Hold a result against what `Segmentation` says of itself."""
    labels = np.unique(result.instances)
    assert result.instances.shape == result.structure.shape == frame.depth_m.shape
    assert labels.min() >= 0
    assert set(labels[labels > 0].tolist()) == set(range(1, int(labels.max()) + 1)), "numbered without gaps"
    assert not (result.structure & (result.instances > 0)).any(), "a pixel is of an instance or of the structure"
    assert result.floor_z_m is None or np.isfinite(result.floor_z_m)


@pytest.mark.parametrize("size", sorted(FRAMES))
def test_an_image_of_any_size_has_a_label_for_every_pixel(segmenter, size):
    check(FRAMES[size], segmenter.segment(FRAMES[size]))


def test_boxes_apart_are_instances_and_the_floor_is_structure(segmenter):
    frame, shown = FRAMES["whole"], TRUTH[FRAMES["whole"].stamp_ns]
    result = segmenter.segment(frame)
    (iou_left, label_left), (iou_right, label_right) = (best_iou(result.instances, shown == i) for i in (1, 2))
    assert min(iou_left, iou_right) > 0.7
    assert label_left != label_right
    is_near_floor = (shown == 0) & (frame.depth_m < 4.0)
    assert result.structure[is_near_floor].mean() > 0.9
    assert result.floor_z_m == pytest.approx(0.0, abs=0.03)


def test_a_frame_gives_the_same_labels_prepared_ahead_or_not(segmenter):
    frame = FRAMES["whole"]
    with ThreadPoolExecutor(1) as ahead:
        prepared = ahead.submit(segmenter.prepare, frame).result()
    results = [segmenter.segment(frame, None, prepared), segmenter.segment(frame), segmenter.segment(frame)]
    assert len({(found.instances.tobytes(), found.structure.tobytes()) for found in results}) == 1


def test_a_map_that_knows_nothing_yet_is_a_prior_like_none(segmenter):
    nothing = np.zeros(0, np.int64)
    space = ObservedSpace(voxel_m=0.05, free=nothing, structure=nothing, floor_z_m=None)
    result = segmenter.segment(FRAMES["whole"], MapPrior(space=space, objects=(), points_m=0.01))
    check(FRAMES["whole"], result)
    assert result.instances.max() >= 2


def test_a_frame_without_depth_shows_no_structure(segmenter):
    frame = FRAMES["whole"]
    blind = replace(frame, depth_m=np.full_like(frame.depth_m, np.nan))
    result = segmenter.segment(blind, None, segmenter.prepare(blind))
    check(blind, result)
    assert not result.structure.any()


def test_a_run_with_it_gives_the_same_map_twice(segmenter, tmp_path):
    runs = [
        map_scene(tmp_path, *NO_SHAPES, name=name, source=SceneSource(4), segmenter=segmenter) for name in ("a", "b")
    ]
    assert len({run.digest for run in runs}) == 1
    assert runs[0].snapshots[-1].objects
