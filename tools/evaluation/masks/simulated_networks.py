"""Masks and classes as the paper's networks give them, behind the ports: a simulator spoils the truth of a log.

The simulator is a file of the shared folder, imported at run time. Each frame has draws of its own, from the seed and
the stamp: a frame's masks do not depend on the frames before it.
"""

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import RecordingError
from hickory_stream.evaluation.truth import Truth
from hickory_stream.perception.choose import make_segmenter
from hickory_stream.perception.masks import InstanceMask
from hickory_stream.perception.models.fastsam import FastSamSegmenter
from hickory_stream.perception.perceive import PerceptionConfig
from hickory_stream.perception.semantic_filter import FilteredSegmenter
from hickory_stream.ports import Segmenter
from hickory_stream.records import Frame, MapPrior, Segmentation, SemanticImage
from tools.evaluation.oracle_ablation import TrueImages

SIMULATOR = "simulated_masks.py"
# What each step of the ladder adds to the errors of the step before; a rate that no step named is 0.
_OUTLINES, _HABITS, _CLASSES = "outlines", "habits", "classes"
_STEPS: dict[str, tuple[str, ...]] = {
    "exact": (), _OUTLINES: (), "parts": ("whole_in_pieces", "part_shown"), "merges": ("merged_per_thing",),
    "misses": ("missed_small", "missed_medium", "missed_large"), "room": ("room_piece_shown",), _HABITS: (),
    _CLASSES: (),
}  # fmt: skip
LADDER = tuple(_STEPS)
# All but habits; all with rates that are half again as high, at most 0.9.
WITHOUT_HABITS, OTHER_RATES = "no_habits", "other_rates"
_RATES = tuple(name for step in _STEPS.values() for name in step)
_THING, _ROOM = "thing", "wall"
_LEAST_PX = 60


def segmenter_with_errors(shared: Path, truth: Truth, rung: str, seed: int, config: PerceptionConfig) -> Segmenter:
    """Return the segmenter of a log with the errors of a rung; raises `RecordingError` without a simulator."""
    return SimulatedSegmenter(SimulatedNetwork(simulator(shared), TrueImages(truth), rung, seed), config)


def simulator(folder: Path) -> ModuleType:
    """Return the simulator of a shared folder; raises `RecordingError` if there is none."""
    path = folder / SIMULATOR
    spec = importlib.util.spec_from_file_location("simulated_masks", path)
    if spec is None or spec.loader is None or not path.is_file():
        raise RecordingError(f"{path} is not there: masks of networks cannot be simulated")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # its dataclasses look their module up
    spec.loader.exec_module(module)
    return module


class SimulatedNetwork:
    """The segmenter's and the semantic network of one log on a rung of the ladder; `stamp_ns` is the current frame."""

    labels = (_THING, _ROOM)

    def __init__(self, made_by: Any, images: TrueImages, rung: str, seed: int) -> None:
        self.stamp_ns = 0
        self._made_by, self._images, self._rung, self._seed = made_by, images, rung, seed
        steps = LADDER if rung in (WITHOUT_HABITS, OTHER_RATES) else LADDER[: LADDER.index(rung) + 1]
        rates, had = made_by.MaskErrors(), {name for step in steps for name in _STEPS[step]}
        factor = 1.5 if rung == OTHER_RATES else 1.0
        self._errors = replace(rates, **{n: min(0.9, factor * getattr(rates, n)) if n in had else 0.0 for n in _RATES})
        has_habits = _HABITS in steps and rung != WITHOUT_HABITS
        self._habits = made_by.Habits(seed, self._errors) if has_habits else None
        self.has_classes = _CLASSES in steps

    def masks(self, rgb: NDArray[np.uint8]) -> tuple[list[InstanceMask], int]:
        """Return the masks of the current frame, and that none is non-finite."""
        shown = self._images.at(self.stamp_ns)
        if self._rung == LADDER[0]:
            ids, areas = np.unique(shown, return_counts=True)
            found = [(shown == i, 0.9) for i in ids[(ids > 0) & (areas >= _LEAST_PX)]]
        else:
            found = self._made_by.simulated_masks(shown, rgb, self._rng(), self._errors, self._habits)
        return [_cut_out(mask, score) for mask, score in found], 0

    def classify(self, rgb: NDArray[np.uint8]) -> SemanticImage:
        """Return which pixels of the current frame are called room."""
        shown = self._images.at(self.stamp_ns)
        said = self._made_by.simulated_classes(shown, shown == 0, self._rng(1))
        return SemanticImage(classes=said.astype(np.int32), labels=self.labels)

    def _rng(self, *stream: int) -> np.random.Generator:
        return np.random.default_rng([self._seed, self.stamp_ns, *stream])


class SimulatedSegmenter:
    """The `Segmenter` of a simulated network: the product's pipeline for masks, and its filter if it has classes."""

    def __init__(self, network: SimulatedNetwork, config: PerceptionConfig) -> None:
        self._network = network
        # It gives masks of an image, as the real network does.
        made = FastSamSegmenter(network, make_segmenter(replace(config, segmenter="network")))  # type: ignore[arg-type]
        self._product: Segmenter = made
        if network.has_classes:
            self._product = FilteredSegmenter(made, network, config.semantic.exclude)

    def prepare(self, frame: Frame) -> object:
        self._network.stamp_ns = frame.stamp_ns
        return self._product.prepare(frame)

    def segment(self, frame: Frame, prior: MapPrior | None = None, prepared: object = None) -> Segmentation:
        return self._product.segment(frame, prior, self.prepare(frame) if prepared is None else prepared)


def _cut_out(mask: NDArray[np.bool_], score: float) -> InstanceMask:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    box = (int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1)
    return InstanceMask(box_px=box, mask=mask[box[1] : box[3], box[0] : box[2]], score=float(score))
