"""Lessons in batches, made by several processes ahead of the training that takes them."""
# What a step learns from follows from the seed and the number of the step alone, however many processes there are.

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data import DataLoader, Dataset

from tools.network_training.frames import TrueFrame
from tools.network_training.lessons import lesson_of
from tools.network_training.stages import Schedule, Stage

_USUAL_AREA_PX = 400.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Batch:
    """`inputs` (B, NUM_INPUTS, H, W) bytes; `labels` (B, H / 2, W / 2) int32; what each pixel counts, float32 alike."""

    inputs: torch.Tensor
    labels: torch.Tensor
    weights: torch.Tensor

    def to(self, device: str) -> "Batch":
        inputs, labels, weights = (v.to(device, non_blocking=True) for v in (self.inputs, self.labels, self.weights))
        return Batch(inputs=inputs, labels=labels, weights=weights)


class _OfSteps(Dataset[Batch]):
    def __init__(self, frame_of: Callable[[np.random.Generator, Stage], TrueFrame], schedule: Schedule) -> None:
        self._frame_of = frame_of
        self._schedule = schedule

    def __len__(self) -> int:
        return self._schedule.steps

    def __getitem__(self, step: int) -> Batch:
        rng = np.random.default_rng([self._schedule.seed, step])
        stage, _ = self._schedule.at(step)
        lessons = [lesson_of(self._frame_of(rng, stage), rng) for _ in range(stage.batch)]
        return Batch(
            inputs=torch.from_numpy(np.stack([lesson.inputs for lesson in lessons])),
            labels=torch.from_numpy(np.stack([lesson.labels for lesson in lessons])),
            weights=torch.from_numpy(np.stack([_weights(lesson.labels) for lesson in lessons])),
        )


def batches(
    frame_of: Callable[[np.random.Generator, Stage], TrueFrame], schedule: Schedule, first: int, processes: int
) -> Iterator[Batch]:
    """Yield the batch of each step from `first` on, made by other processes if `processes` is over 0."""
    dataset = _OfSteps(frame_of, schedule)
    if processes > 0 and first < schedule.steps:
        dataset[first]  # compiles the kernels once, for all processes
    loader = DataLoader(
        dataset,
        batch_size=None,
        sampler=range(first, schedule.steps),
        num_workers=processes,
        prefetch_factor=2 if processes > 0 else None,
        multiprocessing_context="fork" if processes > 0 else None,
    )
    return iter(loader)


def _weights(labels: NDArray[np.int32]) -> NDArray[np.float32]:
    _, place, pixels = np.unique(labels, return_inverse=True, return_counts=True)
    weights = np.clip(np.sqrt(_USUAL_AREA_PX / pixels), 0.3, 3.0)
    return np.asarray(weights[place].reshape(labels.shape), dtype=np.float32)
