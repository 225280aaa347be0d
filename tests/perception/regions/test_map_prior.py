from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.base.config_text import read_config
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.camera import backproject
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.geometry.rigid import apply
from hickory_stream.perception.choose import make_segmenter
from hickory_stream.perception.geometric_segmenter import GeometricConfig
from hickory_stream.perception.perceive import PerceptionConfig, perceive
from hickory_stream.perception.regions.map_prior import MapPriorConfig, fragment_owners
from hickory_stream.perception.surface import surface_of
from hickory_stream.records import MapPrior, ObservedSpace, Phase, TrackedObject
from tests.perception.perception_scenes import Block, floor, looking, render

POINTS_M = Lattice().object_m
NOWHERE = ObservedSpace(voxel_m=0.05, free=np.empty(0, np.int64), structure=np.empty(0, np.int64), floor_z_m=0.0)
VIEW = looking((0.0, 0.0, 0.3), start=(-2.2, -0.3, 1.5))
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
