from dataclasses import replace
import cv2
import numpy as np
import pytest
from hickory_stream.box_scene import PERIOD_NS, SCENE_CAMERA, START_NS, SceneBox, SceneSource, scene_pose
from hickory_stream.config import MapperConfig
from hickory_stream.errors import RecordingError
from hickory_stream.evaluation.truth import Truth, TruthFrame, TruthObject
from hickory_stream.events import SourceEnded
from hickory_stream.perception.perceive import PerceptionConfig, perceive
from hickory_stream.records import Phase
from tests.mapping.mapping_fixtures import drive
from tools.evaluation.oracle_ablation import TrueImages, TrueSegmenter, core_of, segmenter_of

# Two boxes of one colour that touch, and a third one apart; ids in the truth are not those of the images of the twin.
BOXES = (
    SceneBox(low=(-0.20, -0.40, 0.0), high=(0.15, 0.0, 0.35), rgb=(190, 80, 60)),
    SceneBox(low=(-0.20, 0.0, 0.0), high=(0.15, 0.40, 0.35), rgb=(190, 80, 60)),
    SceneBox(low=(-0.15, 0.60, 0.0), high=(0.15, 0.85, 0.55), rgb=(120, 170, 80)),
)
IDS = np.array([0, 12, 7, 31])
NUM_FRAMES = 7
PERSON = 900


@pytest.fixture(scope="module")
def frames():
    return [raw.decode() for raw in SceneSource(NUM_FRAMES, BOXES).frames()]


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    folder = tmp_path_factory.mktemp("truth")
    for i, instances in enumerate(SceneSource(NUM_FRAMES, BOXES).instances.values()):
        shown = IDS[instances].astype(np.uint16)
        shown[:4, :4] = PERSON
        cv2.imwrite(str(folder / f"{i}.png"), shown)
    return Truth(
        folder=folder,
        camera=SCENE_CAMERA,
        objects=tuple(
            TruthObject(id=int(i), kind="box", mesh="", world_from_object=np.eye(4), seen_fraction=0.6, frames=(0,))
            for i in sorted(IDS[1:])
        ),
        structure=(),
        frames=tuple(
            TruthFrame(
                index=i, stamp_ns=START_NS + i * PERIOD_NS, world_from_camera=scene_pose(i), instances=f"{i}.png"
            )
            for i in range(NUM_FRAMES)
        ),
    )


def segmented(rung, truth, frame):
    return TrueSegmenter(rung, TrueImages(truth), PerceptionConfig()).segment(frame)


def mapped(rung, truth, frames):
    """The objects of a map of layer 1."""
    config, images = MapperConfig(), TrueImages(truth)
    segmenter, core = segmenter_of(rung, images, config), core_of(rung, images, config)
    assert segmenter is not None
    for frame in frames:
        seen = perceive(frame, core.prior(), None, segmenter, config.perception, lattice=config.mapping.voxels)
        drive(core, [seen.event(frame)])
    drive(core, [SourceEnded(stamp_ns=frames[-1].stamp_ns)])
    return tuple(item for item in core.snapshot().objects if item.phase is not Phase.TENTATIVE)


def test_true_masks_are_the_truth_outside_of_our_structure(truth, frames):
    found = segmented("masks", truth, frames[0])
    shown = TrueImages(truth).at(frames[0].stamp_ns)
    assert found.structure.any()
    assert not found.instances[found.structure].any()
    free = ~found.structure
    for label in range(1, int(found.instances.max()) + 1):
        (owner,) = np.unique(shown[found.instances == label])
        assert owner > 0
        np.testing.assert_array_equal((found.instances == label)[free], (shown == owner)[free])


def test_true_structure_shows_nothing_and_a_passer_by_is_neither(truth, frames):
    found = segmented("structure", truth, frames[0])
    shown = TrueImages(truth).at(frames[0].stamp_ns)
    np.testing.assert_array_equal(found.structure, shown == 0)
    np.testing.assert_array_equal(found.instances > 0, shown > 0)
    assert (shown[:4, :4] == -1).all()
    assert not found.structure[:4, :4].any()
    assert not found.instances[:4, :4].any()


def test_an_image_full_of_things_has_no_mask_without_a_number(truth, frames):
    segmenter = TrueSegmenter("structure", _Full(), PerceptionConfig())
    assert np.unique(segmenter.segment(frames[0]).instances).tolist() == [1, 2]


class _Full:
    def at(self, stamp_ns):
        shown = np.full((SCENE_CAMERA.height, SCENE_CAMERA.width), 7, dtype=np.int32)
        shown[:, 100:] = 12
        return shown


def test_true_joins_keep_our_fragments_of_things(truth, frames):
    segmenter = TrueSegmenter("joins", TrueImages(truth), PerceptionConfig())
    pieces = segmenter._ours.fragments(frames[0])
    found = segmenter.segment(frames[0]).instances[:: pieces.surface.factor, :: pieces.surface.factor]
    found = found[: pieces.labels.shape[0], : pieces.labels.shape[1]]
    for label in range(1, int(pieces.labels.max()) + 1):
        assert len(np.unique(found[pieces.labels == label])) == 1, "a fragment is never divided"
    assert not found[pieces.labels == 0].any()
    assert 0 < int(found.max()) <= 3


def test_true_association_gives_things_that_touch_an_object_each(truth, frames):
    found = mapped("association", truth, frames)
    assert [(item.sightings, item.merged_ids) for item in found] == [(NUM_FRAMES, ())] * 3
    centers = np.array([item.box.center for item in found])
    true = np.array([np.add(box.low, box.high) / 2 for box in BOXES])
    # The sides that face away were not seen; another box would be 0.4 m off.
    apart_m = np.linalg.norm(true[:, None] - centers[None], axis=2)
    assert sorted(apart_m.argmin(axis=0)) == [0, 1, 2]
    assert (apart_m.min(axis=0) < 0.2).all()


def test_true_association_holds_where_things_pass_each_other(truth, frames):
    still = [_at(frame, frames[0].world_from_camera) for frame in frames]
    found = mapped("association", truth, still)
    assert [(item.sightings, item.merged_ids) for item in found] == [(NUM_FRAMES, ())] * 3


def _at(frame, world_from_camera):
    return replace(frame, world_from_camera=world_from_camera)


def test_a_frame_that_the_truth_does_not_have_is_refused(truth, tmp_path):
    with pytest.raises(RecordingError, match="not the truth of this log"):
        TrueImages(truth).at(START_NS + PERIOD_NS // 2)
