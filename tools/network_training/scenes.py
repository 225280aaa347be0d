"""Which synthetic scenes are learnt from: mostly rooms of the broad generator, beside own ones."""

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from tools.network_training.frames import KeptFrames, Scene, TrueFrame, frames_of_scene
from tools.network_training.stages import Stage

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
