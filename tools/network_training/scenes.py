"""Which synthetic scenes are learnt from: mostly rooms of the broad generator, beside own ones."""
# The schedule of the training: steps, learning rate and batch size of each stage.

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from tools.network_training.frames import KeptFrames, Scene, TrueFrame, frames_of_scene


@dataclass(frozen=True, kw_only=True, slots=True)
class Stage:
    """So many steps of so many lessons; the rate rises, stays and falls."""

    # `rooms`: those of the broad scenes that are learnt from, from the first to before the last.
    steps: int
    batch: int
    rooms: tuple[int, int]
    rate: float = 2e-3
    rising: int = 100
    falling_share: float = 1 / 7

    def rate_at(self, step: int) -> float:
        falling = max(1.0, self.falling_share * self.steps)
        return self.rate * min(1.0, (step + 1) / self.rising, max(0.01, (self.steps - step) / falling))


@dataclass(frozen=True, kw_only=True, slots=True)
class Schedule:
    """Stages in turn; `precision` of the products in training."""

    stages: tuple[Stage, ...]
    seed: int = 0
    weight_decay: float = 1e-2
    precision: str = "bfloat16"
    told_every: int = 50
    kept_every: int = 100

    @property
    def steps(self) -> int:
        return sum(stage.steps for stage in self.stages)

    def at(self, step: int) -> tuple[Stage, int]:
        for stage in self.stages:
            if step < stage.steps:
                return stage, step
            step -= stage.steps
        raise IndexError(f"step {self.steps + step}; the schedule has {self.steps}")


_FRAMES = 48
OWN = (
    *(Scene(kind="apartment", seed=seed, frames=16) for seed in range(300, 315)),
    *(Scene(kind="tabletop", seed=seed, frames=10) for seed in range(350, 366, 2)),
)
BROAD = tuple(Scene(kind="clutter-training", seed=seed, frames=_FRAMES) for seed in range(112))
OWN_SHARE = 0.2
RENDERED_AT = {"clutter-training 0-47": "f4e6ad6", "clutter-training 48-111": "98c6798"}
"""The commits whose generators made the frames of the weights in the package: others may give other frames."""
HELD_OUT = (
    *(Scene(kind="apartment", seed=seed, frames=16) for seed in (315, 316)),
    Scene(kind="clutter-tuning", seed=0, frames=48),
)
"""Own rooms of other seeds, and random rooms of another family: nothing was trained on them."""


STAGES = (
    Stage(steps=4000, batch=4, rooms=(0, 48), falling_share=0),
    Stage(steps=4000, batch=8, rooms=(48, 112), rising=1, falling_share=1 / 3),
)
"""Of the weights in the package: larger batches from rooms not seen before, as the rate begins to fall."""


def drawn_frames(folder: Path) -> Callable[[np.random.Generator, Stage], TrueFrame]:
    """Return what draws the frame of a lesson; scenes are rendered when first drawn from and kept in `folder`."""
    own = [frame for scene in OWN for frame in frames_of_scene(scene, folder)]

    @cache
    def room(index: int) -> KeptFrames:
        return frames_of_scene(BROAD[index], folder)

    def frame_of(rng: np.random.Generator, stage: Stage) -> TrueFrame:
        if rng.random() < OWN_SHARE:
            return own[int(rng.integers(len(own)))]
        first, last = stage.rooms
        scene, frame = divmod(int(rng.integers((last - first) * _FRAMES)), _FRAMES)
        return room(first + scene)[frame]

    return frame_of


def told(scenes: Sequence[Scene]) -> dict[str, object]:
    """Return by kind the seeds of scenes and how many frames all of them have."""
    kinds = dict.fromkeys(scene.kind for scene in scenes)
    return {
        kind: {
            "seeds": [scene.seed for scene in scenes if scene.kind == kind],
            "frames": sum(scene.frames for scene in scenes if scene.kind == kind),
        }
        for kind in kinds
    }
