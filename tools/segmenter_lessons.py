"""What the trees of the default segmenter learn from: the fragments of images, and what each of them shows in truth."""
# A lesson keeps counts instead of the image, and from these every way of joining its fragments can be scored.

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hickory_stream.evaluation.truth import Truth, instances_of
from hickory_stream.perception.affinity.pixel_network import PixelNetwork
from hickory_stream.perception.fragments.over_segmentation import Fragments
from hickory_stream.perception.geometric_segmenter import GeometricConfig, GeometricSegmenter
from hickory_stream.perception.masks import enlarged_mask
from hickory_stream.perception.regions.fragment_odds import FragmentOdds, fragment_odds
from hickory_stream.perception.regions.join import region_graph_of
from hickory_stream.perception.regions.region_graph import RegionGraph
from hickory_stream.perception.regions.trees import Trees
from hickory_stream.records import Frame, MapPrior, Segmentation
from hickory_stream.worlds.depth_camera import sensed_depth
from tools.evaluation.masks.first_layer import play_first_layer
from tools.evaluation.masks.scores import UNKNOWN, MaskScore, score_overlaps
from tools.network_training.frames import Scene, TrueFrame, frames_of_scene
from tools.network_training.lessons import drawn_camera

_MIN_SHARE = 0.002
_MIN_PIXELS = 16


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Lesson:
    """An image to learn from: its fragments, and how many pixels (fragments, owners) of each show which `owners`."""

    # Owner 0 is what is no thing. Row 0 is empty: what belongs to no fragment. `in_image` (owners,): all pixels of
    # each. `odds`: what the network of affinities says of the fragments, where it was asked.
    measures: RegionGraph
    shown: NDArray[np.float64]
    owners: NDArray[np.int64]
    in_image: NDArray[np.int64]
    odds: FragmentOdds | None = None


_NO_TREES = Trees(
    features=(), baseline=0.0, roots=np.zeros(0, np.int32), feature=np.zeros(0, np.int16), threshold=np.zeros(0),
    left=np.zeros(0, np.int32), right=np.zeros(0, np.int32), nan_left=np.zeros(0, np.bool_),
    value=np.zeros(0, np.float32),
)  # fmt: skip


class TrueMasks:
    """A segmenter that knows the truth: the maps of which lessons see the space depend on no trees."""

    def __init__(self, truth: Truth, network: PixelNetwork | None = None) -> None:
        self._truth = truth
        self._network = network
        self._stamps = np.array([frame.stamp_ns for frame in truth.frames])
        self._segmenter = GeometricSegmenter(GeometricConfig(), _NO_TREES)
        self.lessons: list[Lesson] = []

    def prepare(self, frame: Frame) -> object:
        return self._segmenter.prepare(frame)

    def segment(self, frame: Frame, prior: MapPrior | None = None, prepared: object = None) -> Segmentation:
        """Return the true instances of a frame where structure is not found; its fragments become a lesson."""
        pieces = self._segmenter.fragments(frame, prior, prepared)
        shown = true_instances(self._truth, int(np.argmin(np.abs(self._stamps - frame.stamp_ns))))
        self.lessons += lesson_of_pieces(pieces, shown, self._network)
        size = (frame.camera.width, frame.camera.height)
        structure = enlarged_mask(pieces.room.structure, pieces.surface.factor, size)
        _, instances = np.unique(np.where(structure | (shown <= 0), 0, shown), return_inverse=True)
        return Segmentation(
            instances=instances.reshape(shown.shape).astype(np.int32),
            structure=structure,
            floor_z_m=pieces.room.floor_z_m,
            rejected=(),
        )


def lessons_of(
    log: Path, truth: Truth, max_keyframes: int | None = None, network: PixelNetwork | None = None
) -> list[Lesson]:
    teacher = TrueMasks(truth, network)
    for _ in play_first_layer(log, segmenter=teacher, max_keyframes=max_keyframes):
        pass
    return teacher.lessons


def lessons_of_scene(scene: Scene, folder: Path, network: PixelNetwork) -> list[Lesson]:
    """Return the lessons of single views of a scene, without a map; rendered if they are not kept in `folder` yet."""
    # Depth has the defects that the scene's own camera has, or those of cameras drawn from its seed.
    segmenter = GeometricSegmenter(GeometricConfig(), _NO_TREES)
    rng = np.random.default_rng([scene.seed, 5])
    lessons: list[Lesson] = []
    for i, true in enumerate(frames_of_scene(scene, folder)):
        frame = Frame(
            index=i, stamp_ns=i, rgb=true.rgb,
            depth_m=_drawn_depth(true, rng) if true.sensed_m is None else true.sensed_m, camera=true.camera,
            world_from_camera=true.world_from_camera,
        )  # fmt: skip
        lessons += lesson_of_pieces(segmenter.fragments(frame), true.instances, network)
    return lessons


def _drawn_depth(true: TrueFrame, rng: np.random.Generator) -> NDArray[np.float32]:
    return sensed_depth(true.depth_m, true.cosine, true.camera.fx, drawn_camera(rng), rng)


def true_instances(truth: Truth, index: int) -> NDArray[np.int32]:
    """Return what each pixel of a true frame shows: an object, 0 for structure, `UNKNOWN` for a passer-by."""
    shown = instances_of(truth, truth.frames[index]).astype(np.int32)
    things = [item.id for item in truth.objects]
    return np.where(np.isin(shown, things) | (shown == 0), shown, UNKNOWN).astype(np.int32)


def true_groups(lesson: Lesson) -> NDArray[np.int64]:
    """Return (fragments,) the groups of fragments that show mostly one thing, 0 for those of no thing."""
    owners = np.maximum(lesson.owners[lesson.shown.argmax(axis=1)], 0)
    owners[0] = 0
    return np.asarray(np.unique(np.append(0, owners), return_inverse=True)[1][1:], dtype=np.int64)


def score_groups(lesson: Lesson, numbers: NDArray[np.int64]) -> MaskScore:
    """Return how the masks of groups compare with the truth; `numbers` (fragments,), group 0 is no mask."""
    shown = np.zeros((int(numbers.max()) + 1, len(lesson.owners)), dtype=np.int64)
    np.add.at(shown, numbers, lesson.shown.astype(np.int64))
    masks = shown[1:]
    size = lesson.measures.labels.size
    return score_overlaps(
        masks[masks.sum(axis=1) >= _MIN_PIXELS], lesson.owners, lesson.in_image, int(_MIN_SHARE * size), size
    )


def lesson_of_pieces(pieces: Fragments, shown: NDArray[np.int32], network: PixelNetwork | None = None) -> list[Lesson]:
    """Return the lesson of an image in pieces of which each pixel (H, W) shows what; none where there are no pieces."""
    said = None if network is None else network.odds(pieces.surface, None)
    measures = region_graph_of(pieces)
    if measures is None:
        return []
    labels, factor = pieces.labels, pieces.surface.factor
    height, width = labels.shape
    owners, place = np.unique(shown[::factor, ::factor][:height, :width], return_inverse=True)
    count = len(measures.regions.pixels)
    key = labels.ravel().astype(np.int64) * len(owners) + place.ravel()
    pixels = np.bincount(key, minlength=count * len(owners)).reshape(count, len(owners)).astype(np.float64)
    in_image = pixels.sum(axis=0).astype(np.int64)
    pixels[0] = 0.0
    odds = None if said is None else fragment_odds(labels, said)
    return [Lesson(measures=measures, shown=pixels, owners=owners.astype(np.int64), in_image=in_image, odds=odds)]
