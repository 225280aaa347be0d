import itertools
import numpy as np
import pytest
from hickory_stream.perception.geometric_segmenter import GeometricConfig, GeometricSegmenter
from players import open_source
from tools.evaluation.masks.labelled_clouds import clouds_in, load_cloud, score_cloud
from tools.evaluation.masks.scores import total

# Rectangles around the things, drawn by hand on the colour images: x0, y0, x1, y1.
FRAMES = {
    0: {"table": (240, 300, 300, 460), "near chair": (165, 120, 235, 345), "far chair": (440, 140, 570, 165)},
    300: {"left mug": (64, 218, 100, 252), "right mug": (482, 292, 520, 330)},
}


@pytest.mark.parametrize("index", sorted(FRAMES))
def test_table_chairs_and_mugs_of_a_real_kitchen_are_instances(redkitchen, index):
    position = sorted(redkitchen.glob("*.color.jpg")).index(redkitchen / f"frame-{index:06d}.color.jpg")
    source = open_source(str(redkitchen))
    frame = next(itertools.islice(source.frames(), position, None)).decode()
    source.close()
    instances = GeometricSegmenter(GeometricConfig()).segment(frame).instances
    labels = {}
    for name, (x0, y0, x1, y1) in FRAMES[index].items():
        inside = instances[y0:y1, x0:x1]
        labels[name] = int(np.bincount(inside[inside > 0]).argmax()) if (inside > 0).any() else 0
        assert labels[name] > 0, f"nothing where the {name} is"
        assert (inside == labels[name]).mean() > 0.35, f"the {name} is in pieces"
    assert len(set(labels.values())) == len(labels)


def test_things_on_a_real_table_are_masks_of_their_own(mosd):
    score = total(score_cloud(load_cloud(path)) for path in clouds_in(mosd))
    assert score.f1 >= 0.8
    assert score.best_iou >= 0.75
