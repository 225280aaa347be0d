"""Classes of pixels as evidence, for any segmenter: of the room for the map, of what moves by itself for a frame.

A class is wrong at outlines, and for whole regions now and then. Pixels of structure classes are votes for structure in
the observed space: a thing is part of the room where most votes on its surface, over views, say so
(`mapping.rules.fixtures`). Only masks of what moves by itself are rejected at once: its places do not add up.
"""

from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from hickory_stream.base.ranges import Ranged, number
from hickory_stream.errors import ConfigError
from hickory_stream.ports import Moving, Segmenter, SemanticModel, shared_by
from hickory_stream.records import Frame, MapPrior, RejectedMask, Segmentation, SemanticImage

# The classes of ADE20K and COCO that the paper excludes, by any of their names.
STRUCTURE = (
    *("wall", "floor", "ceiling", "ground", "earth", "grass", "road", "route", "sidewalk", "pavement", "stairs"),
    *("stairway", "steps", "door", "double door", "screen door", "window", "windowpane", "curtain", "column", "pillar"),
    # Without "glass", the name of a drinking glass in ADE20K.
    *("building", "edifice", "house", "fence", "sky", "light", "light source"),
)
DYNAMIC = ("person", "animal", "car", "dog", "cat", "bicycle", "bike", "motorbike", "minibike")


@dataclass(frozen=True, kw_only=True, slots=True)
class FilterConfig(Ranged):
    """Which classes are excluded as objects."""

    #: Names of classes that are part of the room; their pixels are votes for structure.
    structure: tuple[str, ...] = STRUCTURE
    #: Names of classes that move by themselves; their pixels are neither object nor structure.
    dynamic: tuple[str, ...] = DYNAMIC
    #: A mask with at least this share on a class that moves by itself is rejected.
    share: float = number(0.3, 0.001, 1, "share")
    #: So is a mask whose IoU with all pixels of such a class is at least this.
    iou: float = number(0.3, 0.001, 1, "IoU")


@dataclass(frozen=True, kw_only=True, slots=True)
class ExcludedClasses:
    """The ids of the excluded classes."""

    structure: frozenset[int]
    dynamic: frozenset[int]


class FilteredSegmenter:
    """A `Segmenter` with masks filtered by a semantic model; raises `ConfigError` for a class unknown to the model."""

    def __init__(self, segmenter: Segmenter, model: SemanticModel, config: FilterConfig) -> None:
        self._segmenter = segmenter
        self._model = model
        self._config = config
        self._excluded = excluded_classes(model.labels, config)
        self._thread = ThreadPoolExecutor(1, "classes")

    def share_runs(self) -> int:
        """Let frames of several threads share runs, if those of masks can; return how many share one."""
        num = shared_by(self._segmenter)
        if num > 1 and (num_classes := shared_by(self._model)) > 1:
            self._thread = ThreadPoolExecutor(2 * num_classes, "classes")
        return num

    def prepare(self, frame: Frame) -> tuple[object, SemanticImage]:
        """Return the results that need no map: the segmenter's own, and the classes of the pixels, side by side."""
        classes = self._thread.submit(self._model.classify, np.asarray(frame.rgb))
        return self._segmenter.prepare(frame), classes.result()

    def moved(self, prepared: object, world_from_camera: NDArray[np.float64]) -> object:
        """Return the result of `prepare` for another pose (4, 4) of the frame; None if it must be repeated."""
        if not isinstance(prepared, tuple) or not isinstance(self._segmenter, Moving):
            return None
        inner, semantics = prepared
        return self._segmenter.moved(inner, world_from_camera), semantics

    def segment(self, frame: Frame, prior: MapPrior | None = None, prepared: object = None) -> Segmentation:
        """Return the segmenter's segmentation without excluded classes."""
        inner, semantics = prepared if isinstance(prepared, tuple) else self.prepare(frame)
        segmentation = self._segmenter.segment(frame, prior, inner)
        return without_classes(segmentation, semantics, self._excluded, self._config)


def excluded_classes(labels: tuple[str, ...], config: FilterConfig) -> ExcludedClasses:
    """Return the ids of the configured classes, without case, by one of a label's names (`door, double door`).

    Raises:
        ConfigError: a name that is not a default one is missing from the table, or all names are.
    """
    structure, missing_structure = _ids_of(labels, config.structure)
    dynamic, missing_dynamic = _ids_of(labels, config.dynamic)
    unknown = sorted((missing_structure | missing_dynamic) - set(STRUCTURE) - set(DYNAMIC))
    if unknown or not structure | dynamic:
        what = f"no class is called {', '.join(unknown)}" if unknown else "none of the excluded classes is in it"
        raise ConfigError(
            f"the semantic model's table of {len(labels)} names: {what}; it has {', '.join(labels)[:600]}"
        )
    return ExcludedClasses(structure=structure, dynamic=dynamic)


def without_classes(
    segmentation: Segmentation, semantics: SemanticImage, excluded: ExcludedClasses, config: FilterConfig
) -> Segmentation:
    """Return a segmentation with its votes for structure, without instances on classes that move by themselves."""
    instances = segmentation.instances.copy()
    rejected = list(segmentation.rejected)
    count = len(semantics.labels)
    is_excluded = np.zeros(count + 1, dtype=bool)
    is_excluded[sorted(excluded.dynamic)] = True
    totals = np.bincount(semantics.classes.ravel() + 1, minlength=count + 1)[1:]
    for i, place in enumerate(scipy.ndimage.find_objects(segmentation.instances)):
        if place is None:
            continue
        mask = segmentation.instances[place] == i + 1
        on = np.bincount(semantics.classes[place][mask] + 1, minlength=count + 1)[1:] * is_excluded[:-1]
        reason = _why_excluded(on, totals, int(mask.sum()), semantics.labels, config)
        if reason is not None:
            rows, columns = place
            box_px = (columns.start, rows.start, columns.stop, rows.stop)
            rejected.append(RejectedMask(box_px=box_px, reason=reason, mask=mask))
            instances[place][mask] = 0
    is_structure = np.isin(semantics.classes, sorted(excluded.structure))
    is_dynamic = np.isin(semantics.classes, sorted(excluded.dynamic))
    labels = np.unique(instances)
    return replace(
        segmentation,
        instances=np.searchsorted(np.union1d(labels, [0]), instances).astype(np.int32),
        structure=(segmentation.structure | is_structure) & ~is_dynamic & (instances == 0),
        structure_shown=(segmentation.own_structure | is_structure) & ~is_dynamic,
        rejected=tuple(rejected),
    )


def _ids_of(labels: tuple[str, ...], names: Iterable[str]) -> tuple[frozenset[int], set[str]]:
    # The ids of the classes that have one of the names, and the names that no class has.
    wanted = {name.strip().lower() for name in names}
    ids, met = set(), set()
    for i, label in enumerate(labels):
        said = {part.strip().lower() for part in label.split(",")} & wanted
        if said:
            ids.add(i)
            met |= said
    return frozenset(ids), wanted - met


def _why_excluded(
    on: NDArray[np.int64], totals: NDArray[np.int64], area: int, labels: tuple[str, ...], config: FilterConfig
) -> str | None:
    most = int(on.argmax())
    if on[most] >= config.share * area:
        return f"{on[most] / area:.0%} of it is {labels[most]}"
    iou = on / np.maximum(totals + area - on, 1)
    most = int(iou.argmax())
    return f"overlaps {labels[most]} (IoU {iou[most]:.2f})" if iou[most] >= config.iou else None
