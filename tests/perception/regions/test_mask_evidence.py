from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.base.config_text import read_config
from hickory_stream.errors import ModelError
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.camera import backproject
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.geometry.rigid import apply
from hickory_stream.perception.choose import make_segmenter
from hickory_stream.perception.geometric_segmenter import GeometricConfig
from hickory_stream.perception.masks import InstanceMask
from hickory_stream.perception.perceive import PerceptionConfig, perceive
from hickory_stream.perception.regions.map_prior import MapPriorConfig, fragment_owners
from hickory_stream.perception.regions.mask_evidence import divided_by_masks, evidence_of, sampled_masks
from hickory_stream.perception.surface import surface_of
from hickory_stream.records import MapPrior, ObservedSpace, Phase, TrackedObject
from tests.perception.perception_scenes import CAMERA, Block, best_iou, floor, looking, render

RED = (190, 40, 40)
VIEW = looking((0.0, 0.0, 0.3), start=(-2.2, -0.3, 1.5))
TABLE = Block(low=(-0.4, -0.6, 0.69), high=(0.4, 0.6, 0.73), color=(170, 130, 80))
ABOVE = looking((0.0, 0.0, 0.7), start=(-1.5, -0.2, 1.6))


def masked(mask, score=0.9):
    ys, xs = np.nonzero(mask)
    box = (int(xs.min()), int(ys.min()), int(xs.max()) + 1, int(ys.max()) + 1)
    return InstanceMask(box_px=box, mask=mask[box[1] : box[3], box[0] : box[2]], score=score)


@pytest.fixture(scope="module")
def segmenter():
    return make_segmenter(PerceptionConfig())


def likelihood(masks, labels, before):
    """Return the probability that fragments 1 and 2 are one."""
    evidence, count = evidence_of(np.array(masks).reshape(-1, *labels.shape), labels), int(labels.max()) + 1
    return evidence.combined(np.array([before]), np.array([[1, 2]]), np.arange(count), count)[0]


def test_a_whole_joins_a_part_divides_and_geometry_decides_between_them():
    labels = np.ones((20, 20), np.int32)
    labels[:, 10:] = 2
    whole, part = np.ones(labels.shape, bool), labels == 1
    assert likelihood([], labels, 0.5) == 0.5
    assert likelihood([whole], labels, 0.1) > 0.5
    assert likelihood([part], labels, 0.9) < 0.5
    assert likelihood([whole, part], labels, 0.05) < 0.3 < 0.5 < likelihood([whole, part], labels, 0.95)


def test_a_fragment_is_divided_where_a_mask_ends_but_not_at_its_outline():
    labels = np.zeros((40, 40), np.int32)
    labels[4:36, 4:36] = 1
    half, nearly = np.zeros((2, 40, 40), bool)
    half[:, :20], nearly[5:36, 4:36] = True, True
    divided = divided_by_masks(labels, half[None])
    assert [len(np.unique(divided[4:36, x])) for x in (4, 19, 20, 35)] == [1, 1, 1, 1]
    assert (divided[10, 19], divided[10, 20]) == (1, 2)
    assert (divided_by_masks(labels, nearly[None]) == labels).all()


@pytest.mark.parametrize("factor", [1, 2, 3])
def test_a_mask_is_sampled_where_the_labels_are(factor):
    whole = np.random.default_rng(factor).random((24, 36)) < 0.3
    few = sampled_masks([masked(whole)], factor, (24 // factor, 36 // factor))
    assert (few[0] == whole[factor // 2 :: factor, factor // 2 :: factor][: 24 // factor, : 36 // factor]).all()


def test_masks_of_nothing_and_of_the_scene_are_no_evidence(segmenter):
    frame, _ = render([floor(), TABLE], ABOVE)
    nothing = InstanceMask(box_px=(3, 3, 3, 3), mask=np.zeros((0, 0), bool))
    scene = masked(np.ones((CAMERA.height, CAMERA.width), bool))
    alone, found = segmenter.segment(frame), segmenter.segment_with([nothing, scene], frame)
    assert (found.instances == alone.instances).all()
    assert (found.structure == alone.structure).all()


def test_a_mask_over_two_things_apart_in_depth_is_divided(segmenter):
    near = Block(low=(-0.7, -0.25, 0.0), high=(-0.5, 0.0, 0.35), color=RED)
    far = Block(low=(0.3, -0.1, 0.0), high=(0.6, 0.3, 0.6), color=(40, 60, 180))
    frame, shown = render([floor(), near, far], VIEW)
    found = segmenter.segment_with([masked(shown >= 1)], frame)
    (iou_near, label_near), (iou_far, label_far) = (best_iou(found.instances, shown == i) for i in (1, 2))
    assert min(iou_near, iou_far) > 0.8
    assert label_near != label_far


def test_a_mask_beyond_the_frame_is_refused(segmenter):
    frame, _ = render([floor(), TABLE], ABOVE)
    large = InstanceMask(box_px=(0, 0, CAMERA.width + 1, 5), mask=np.ones((5, CAMERA.width + 1), bool))
    with pytest.raises(ModelError, match="320x240"):
        segmenter.segment_with([large], frame)


POINTS_M = Lattice().object_m
NOWHERE = ObservedSpace(voxel_m=0.05, free=np.empty(0, np.int64), structure=np.empty(0, np.int64), floor_z_m=0.0)
CONFIG = MapPriorConfig()
GREY = (150, 150, 150)
LEFT = Block(low=(0.0, 0.0, 0.0), high=(0.4, 0.4, 0.4), color=GREY)
RIGHT = Block(low=(0.0, -0.4, 0.0), high=(0.4, 0.0, 0.4), color=GREY)


def known(points, number, **changes):
    tracked = TrackedObject(
        id=number, phase=Phase.ACTIVE, submap_id=0, sightings=9, first_seen_ns=0, last_seen_ns=1, points_world=points,
        colors=np.zeros(points.shape, dtype=np.uint8), box=gravity_aligned_box(points, 0.01), feature=None, views=(),
        best_view=None, shape=None, merged_ids=(),
    )  # fmt: skip
    return replace(tracked, **changes)


def prior(*objects):
    return MapPrior(space=NOWHERE, objects=objects, points_m=POINTS_M)


@pytest.fixture(scope="module")
def scene():
    """Two blocks of one colour with a common face: the frame, its surface, what each pixel shows, and their points."""
    frame, shown = render([floor(), LEFT, RIGHT], VIEW)
    surface = surface_of(frame, GeometricConfig().surface)
    f = surface.factor
    labels = np.maximum(shown, 0)[::f, ::f][: surface.depth_m.shape[0], : surface.depth_m.shape[1]].astype(np.int32)
    return frame, surface, labels, [surface.points_world[labels == i].astype(np.float32) for i in (1, 2)]


def probability(scene, map_prior, config=CONFIG, before=0.8):
    """The probability that the two blocks are one thing, with the map."""
    _, surface, labels, _ = scene
    owners = fragment_owners(labels, surface, map_prior, config)
    if owners is None:
        return before
    return float(owners.against(np.array([before]), np.array([[1, 2]]), np.arange(3), 3)[0])


def test_regions_on_two_objects_are_less_likely_one(scene):
    left, right = scene[3]
    likely = probability(scene, prior(known(left, 1), known(right, 2)))
    assert np.log(likely / (1 - likely)) == pytest.approx(np.log(0.8 / 0.2) - MapPriorConfig().apart_odds)


def test_a_frame_that_is_sure_decides_alone(scene):
    left, right = scene[3]
    assert probability(scene, prior(known(left, 1), known(right, 2)), before=1 - 1e-4) > 0.99


def test_regions_on_one_object_are_as_likely_as_in_the_frame(scene):
    left, right = scene[3]
    far = np.array([[9.0, 9.0, 1.0], [9.1, 9.1, 1.2]], dtype=np.float32)
    both = known(np.concatenate([left, right]), 1)
    assert probability(scene, prior(both, known(far, 2))) == 0.8
    assert probability(scene, prior(both, known(left + np.float32(5), 2), known(right + np.float32(5), 3))) == 0.8


@pytest.mark.parametrize("changes", [{"phase": Phase.TENTATIVE}, {"sightings": 2}])
def test_an_object_that_is_hardly_known_says_nothing(scene, changes):
    left, right = scene[3]
    assert probability(scene, prior(known(left, 1), known(right, 2, **changes))) == 0.8


def test_without_a_map_or_with_no_odds_nothing_changes(scene):
    left, right = scene[3]
    assert probability(scene, None) == 0.8
    assert probability(scene, prior()) == 0.8
    assert probability(scene, prior(known(left, 1), known(right, 2)), MapPriorConfig(apart_odds=0.0)) == 0.8


def test_a_mask_of_two_known_objects_is_cut():
    behind = replace(RIGHT, low=(0.06, -0.4, 0.0), high=(0.4, 0.0, 0.2))
    frame, shown = render([floor(), LEFT, behind], VIEW)
    points = apply(frame.world_from_camera, backproject(frame.depth_m, frame.camera)).astype(np.float32)
    left, right = points[shown == 1], points[shown == 2]
    config = read_config(PerceptionConfig, None, ("geometric.join.map_prior.apart_odds=8.0",))
    segmenter = make_segmenter(config)
    by_itself = perceive(frame, prior(), None, segmenter, config, lattice=Lattice())
    assert [observation.group for observation in by_itself.observations] == [0], "the frame takes the two for one"
    cut = perceive(frame, prior(known(left, 1), known(right, 2)), None, segmenter, config, lattice=Lattice())
    assert [observation.group for observation in cut.observations] == [1, 1]
    _, cut_off = sorted(cut.observations, key=lambda o: -o.points_world[:, 1].max())
    assert cut_off.points_world[:, 1].max() < 0.02, "it is of the right block alone"
