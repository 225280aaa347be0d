"""Oracle experiments: the same pipeline with more and more of it replaced by truth, to locate the loss."""
# Each rung keeps the one below: `ours`, `joins` of our fragments by the true object, true `masks`, true `structure`,
# `association` by the true object without merges.

from collections.abc import Mapping
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from hickory_stream.config import MapperConfig
from hickory_stream.errors import RecordingError
from hickory_stream.evaluation.truth import Truth, frame_at, instances_of
from hickory_stream.events import FrameObserved
from hickory_stream.mapping.core import MapperCore
from hickory_stream.mapping.entities.track import Track
from hickory_stream.mapping.rules.association import Match
from hickory_stream.perception.choose import make_segmenter
from hickory_stream.perception.fragments.over_segmentation import Fragments
from hickory_stream.perception.geometric_segmenter import GeometricSegmenter
from hickory_stream.perception.masks import enlarged_mask
from hickory_stream.perception.network_segmenter import NetworkSegmenter
from hickory_stream.perception.perceive import PerceptionConfig
from hickory_stream.perception.regions.join import Joined
from hickory_stream.records import Frame, MapPrior, Observation, Segmentation

Rung = Literal["ours", "joins", "masks", "structure", "association"]
RUNGS: tuple[Rung, ...] = get_args(Rung)


class TrueImages:
    """The true instance image of each frame, by stamp; the last one is cached, since several callers ask for it."""

    def __init__(self, truth: Truth) -> None:
        self._truth = truth
        self._stamps = np.array([frame.stamp_ns for frame in truth.frames], dtype=np.int64)
        self._things = np.array([item.id for item in truth.objects])
        self._last: tuple[int, NDArray[np.int32]] | None = None

    def at(self, stamp_ns: int) -> NDArray[np.int32]:
        """Return (H, W) the id of the object that each pixel shows, 0 for structure, -1 for pixels that show neither.

        Raises:
            RecordingError: the truth has no frame of this stamp, or its image cannot be read.
        """
        i = frame_at(self._stamps, stamp_ns)
        if i is None:
            raise RecordingError(
                f"{self._truth.folder} has no frame at {stamp_ns / 1e9:.3f} s: it is not the truth of this log"
            )
        last = self._last
        if last is None or last[0] != i:
            shown = instances_of(self._truth, self._truth.frames[i]).astype(np.int32)
            is_known = np.isin(shown, self._things) | (shown == 0)
            last = self._last = (i, np.where(is_known, shown, -1).astype(np.int32))
        return last[1]


class TrueSegmenter:
    """A segmenter with the true joins, masks, or masks and structure; the height of the floor stays ours."""

    def __init__(self, rung: Rung, images: TrueImages, config: PerceptionConfig) -> None:
        self._rung = rung
        self._images = images
        ours = make_segmenter(config)
        if not isinstance(ours, GeometricSegmenter | NetworkSegmenter):
            ours = GeometricSegmenter(config.geometric)  # the others have no fragments
        self._ours = ours

    def prepare(self, frame: Frame) -> object:
        return self._ours.prepare(frame)

    def segment(self, frame: Frame, prior: MapPrior | None = None, prepared: object = None) -> Segmentation:
        pieces = self._ours.fragments(frame, prior, prepared)
        shown = self._images.at(frame.stamp_ns)
        if self._rung == "joins":
            return self._ours.segmentation(frame, pieces, truly_joined(pieces, shown))
        if self._rung == "masks":
            size = (frame.camera.width, frame.camera.height)
            structure = enlarged_mask(pieces.room.structure, pieces.surface.factor, size)
        else:
            structure = shown == 0
        return Segmentation(
            instances=_dense(np.where(structure | (shown <= 0), 0, shown)),
            structure=structure,
            floor_z_m=pieces.room.floor_z_m,
        )


def truly_joined(pieces: Fragments, shown: NDArray[np.int32]) -> Joined:
    """Return the fragments, joined by the true object that most of their pixels show; fragments of none are dropped."""
    factor, labels = pieces.surface.factor, pieces.labels
    height, width = labels.shape
    ids, place = np.unique(shown[::factor, ::factor][:height, :width], return_inverse=True)
    count = int(labels.max(initial=0)) + 1
    votes = np.bincount(labels.ravel() * len(ids) + place.ravel(), minlength=count * len(ids)).reshape(count, len(ids))
    owners = np.maximum(ids[votes.argmax(axis=1)], 0)
    owners[0] = 0
    return Joined(labels=_dense(owners)[labels])


class TrueAssociation:
    """Matches every observation to the track of the true object that most of its mask shows; for one core only."""

    def __init__(self, images: TrueImages) -> None:
        self._images = images
        self._tracks: dict[int, int] = {}
        self._created = 0

    def __call__(self, event: FrameObserved, tracks: Mapping[int, Track]) -> list[Match]:
        # The core numbers new tracks in the order of the unmatched observations; nothing else creates a track here.
        assert max(tracks, default=0) <= self._created, "a track was made that this association knows nothing of"
        shown = self._images.at(event.stamp_ns)
        known = set(tracks)
        matches = []
        for observation in event.observations:
            owner = _owner(observation, shown)
            track_id = self._tracks.get(owner)
            is_new = track_id not in known
            if is_new:
                self._created += 1
                self._tracks[owner] = self._created
                known.add(self._created)
            matches.append(
                Match(
                    observation_index=observation.index,
                    track_id=None if is_new else track_id,
                    iou=float(not is_new),
                    lies_on=0.0,
                    is_part=False,
                    candidates=(),
                )
            )
        return matches


def segmenter_of(rung: Rung, images: TrueImages, config: MapperConfig) -> TrueSegmenter | None:
    return None if rung == "ours" else TrueSegmenter(rung, images, config.perception)


def core_of(rung: Rung, images: TrueImages, config: MapperConfig) -> MapperCore:
    associator = TrueAssociation(images) if rung == "association" else None
    return MapperCore(config.mapping, associator)


def _dense(ids: NDArray[np.int32]) -> NDArray[np.int32]:
    _, dense = np.unique(np.concatenate([[0], ids.ravel()]), return_inverse=True)
    return dense[1:].reshape(ids.shape).astype(np.int32)


def _owner(observation: Observation, shown: NDArray[np.int32]) -> int:
    x0, y0, x1, y1 = observation.box_px
    ids, counts = np.unique(shown[y0:y1, x0:x1][observation.mask], return_counts=True)
    return int(ids[np.argmax(counts)])
