"""The sightings of every true object in a run: its pixels in each keyframe, and their labels."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hickory_stream.evaluation.reach import reached_in
from hickory_stream.evaluation.truth import Truth, TruthObject, frame_at, instances_of, mesh_of, moved_mesh
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.inspection.keyframe_labels import LEAST_CODE, SeenAs, Where, area_px, seen_as
from hickory_stream.map_folder.history.recorded import RecordedKeyframe, recorded_steps
from hickory_stream.map_folder.history.track_histories import TrackHistories
from hickory_stream.records import MapSnapshot

# Parts of a true object that are a smaller share of it than this are not reported.
_LEAST_PART = 0.02
_LEAST_OTHER = 0.05
# This quantile of the mask sizes of a run is its detection limit: smaller objects are "too small".
_SMALLEST_MASKS = 0.02


@dataclass(frozen=True, kw_only=True, slots=True)
class Other:
    """Another true object (None for structure) in a mask, and its share of the mask."""

    truth_id: int | None
    share: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Part:
    """A part of a true object's pixels with one label, and its `share` of them.

    A mask has an `observation_index`, its track, its `purity` (share that shows the object) and `others`; a rejected
    mask has a `reason`.
    """

    where: Where
    share: float
    observation_index: int | None = None
    track_id: int | None = None
    purity: float | None = None
    others: tuple[Other, ...] = ()
    reason: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class Sighting:
    """A true object in one keyframe; `parts` with the largest first, `distance_m` to the object's centre."""

    frame: int
    keyframe: int
    stamp_ns: int
    num_px: int
    distance_m: float
    parts: tuple[Part, ...]

    def share(self, *where: Where) -> float:
        """Return the share of the object's pixels with one of these labels."""
        return sum(part.share for part in self.parts if part.where in where)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TruthSightings:
    """Sightings of true objects by id, the histories of tracks, and the size of the smallest masks.

    `masks_of` is, by track, the number of pixels of each true object in its masks; None for no object. `depth_on` is
    as of `reach.depth_on_objects`.
    """

    of_object: dict[int, tuple[Sighting, ...]]
    histories: TrackHistories
    num_keyframes: int
    smallest_mask_px: float
    masks_of: dict[int, dict[int | None, int]]
    depth_on: Counter[int]


def sightings_of_truth(path: Path, final: MapSnapshot, truth: Truth) -> TruthSightings:
    """Return the sightings of a truth in a run; the truth is in the map's world.

    Raises `MapFolderError` for the journal, `RecordingError` for an image of the truth.
    """
    stamps = np.array([frame.stamp_ns for frame in truth.frames], dtype=np.int64)
    middles = {item.id: middle(truth, item) for item in truth.objects}
    found: dict[int, list[Sighting]] = {item.id: [] for item in truth.objects}
    book, areas, num_keyframes = TrackHistories(), [], 0
    masks_of: dict[int, dict[int | None, int]] = {}
    depth_on: Counter[int] = Counter()
    for step in recorded_steps(path, final):
        keyframe = step.keyframe
        book.add(None if keyframe is None else keyframe.observed.frame_index, step.decisions)
        if keyframe is None:
            continue
        num_keyframes += 1
        areas += [area_px(observation) for observation in keyframe.observed.observations]
        at = frame_at(stamps, keyframe.observed.stamp_ns)
        if at is None:
            continue
        shown = _shown(truth, at, found)
        depth_on.update(reached_in(keyframe, shown))
        labels = seen_as(keyframe)
        codes = np.asarray(labels.codes)
        camera_from_map = invert(keyframe.map_from_odometry @ keyframe.observed.world_from_camera)
        table = _table(shown, codes)
        for truth_id in sorted(found.keys() & table.keys()):
            parts = _parts(truth_id, table, labels, keyframe, book)
            found[truth_id].append(
                Sighting(
                    frame=keyframe.observed.frame_index,
                    keyframe=keyframe.number,
                    stamp_ns=keyframe.observed.stamp_ns,
                    num_px=sum(table[truth_id].values()),
                    distance_m=float(np.linalg.norm(apply(camera_from_map, middles[truth_id][None])[0])),
                    parts=parts,
                )
            )
        _count_masks(masks_of, table, labels, keyframe, book)
    return TruthSightings(
        of_object={truth_id: tuple(sightings) for truth_id, sightings in found.items()},
        histories=book,
        num_keyframes=num_keyframes,
        smallest_mask_px=float(np.quantile(areas, _SMALLEST_MASKS)) if areas else 0.0,
        masks_of=masks_of,
        depth_on=depth_on,
    )


def middle(truth: Truth, item: TruthObject) -> NDArray[np.float64]:
    """Return the middle (3,) of the bounds of a true object in the world."""
    vertices = moved_mesh(mesh_of(truth, item), item.world_from_object).vertices
    return np.asarray((vertices.min(axis=0) + vertices.max(axis=0)) / 2.0, dtype=np.float64)


def _shown(truth: Truth, at: int, known: dict[int, list[Sighting]]) -> NDArray[np.int64]:
    """Return (H, W) the true object that each pixel shows, 0 for none of those in `known`."""
    image = instances_of(truth, truth.frames[at]).astype(np.int64)
    return np.where(np.isin(image, list(known)), image, 0)


def _table(shown: NDArray[np.int64], codes: NDArray[np.int32]) -> dict[int, dict[int, int]]:
    """Return the number of pixels of each true object (0: none) by code, without zero counts."""
    height, width = min(shown.shape[0], codes.shape[0]), min(shown.shape[1], codes.shape[1])
    shown, shifted = shown[:height, :width], codes[:height, :width].astype(np.int64) - LEAST_CODE
    num_codes = int(shifted.max(initial=0)) + 1
    counts = np.bincount((shown * num_codes + shifted).ravel())
    table: dict[int, dict[int, int]] = {}
    for place in np.flatnonzero(counts).tolist():
        table.setdefault(place // num_codes, {})[place % num_codes + LEAST_CODE] = int(counts[place])
    return table


def _parts(
    truth_id: int, table: dict[int, dict[int, int]], labels: SeenAs, keyframe: RecordedKeyframe, book: TrackHistories
) -> tuple[Part, ...]:
    row = table[truth_id]
    total = sum(row.values())
    parts = []
    for code in sorted(row, key=lambda code: (-row[code], code)):
        share = row[code] / total
        if share < _LEAST_PART:
            continue
        where = labels.where(code)
        if where == "mask":
            of_mask = {i: other[code] for i, other in table.items() if code in other}
            size = sum(of_mask.values())
            observation = keyframe.observed.observations[code - 1]
            others = [
                Other(truth_id=i or None, share=px / size)
                for i, px in sorted(of_mask.items(), key=lambda pair: (-pair[1], pair[0]))
                if i != truth_id and px >= _LEAST_OTHER * size
            ]
            parts.append(
                Part(
                    where=where,
                    share=share,
                    observation_index=observation.index,
                    track_id=book.home(keyframe.observed.frame_index, observation.index),
                    purity=row[code] / size,
                    others=tuple(others),
                )
            )
        elif where == "rejected mask":
            reason = keyframe.observed.rejected[code - labels.num_masks - 1].reason
            parts.append(Part(where=where, share=share, reason=reason))
        else:
            parts.append(Part(where=where, share=share))
    return tuple(parts)


def _count_masks(
    masks_of: dict[int, dict[int | None, int]],
    table: dict[int, dict[int, int]],
    labels: SeenAs,
    keyframe: RecordedKeyframe,
    book: TrackHistories,
) -> None:
    for truth_id, row in table.items():
        for code, px in row.items():
            if 0 < code <= labels.num_masks:
                observation = keyframe.observed.observations[code - 1]
                track_id = book.home(keyframe.observed.frame_index, observation.index)
                if track_id is not None:
                    counts = masks_of.setdefault(track_id, {})
                    counts[truth_id or None] = counts.get(truth_id or None, 0) + px
