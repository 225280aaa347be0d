"""Which synthetic scenes are learnt from: own rooms at first, then mostly the broad generator's."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tools.network_training.frames import Scene, frames_of_scene

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    import numpy as np

    from tools.network_training.frames import TrueFrame

OWN = (
    *(Scene(kind="apartment", seed=seed, frames=16) for seed in range(300, 315)),
    *(Scene(kind="tabletop", seed=seed, frames=10) for seed in range(350, 366, 2)),
)
BROAD = tuple(Scene(kind="clutter-training", seed=seed, frames=48) for seed in range(24))
STAGES = ((0, 0), (700, 4), (800, 10), (1000, 16), (1200, 24))
"""From which step so many of the broad scenes are learnt from: it began while they were still being rendered."""
OWN_SHARE = 0.2
RENDERED_AT = "e92539a"
"""The commit whose generators made the frames of the weights in the package: later ones give other frames."""
HELD_OUT = (
    *(Scene(kind="apartment", seed=seed, frames=16) for seed in (315, 316)),
    Scene(kind="clutter-tuning", seed=0, frames=48),
)
"""Own rooms of other seeds, and random rooms of another family: nothing was trained on them."""


def drawn_frames(folder: Path) -> Callable[[int, np.random.Generator], TrueFrame]:
    """Return what draws the frame of a lesson; scenes are rendered when they are first needed and kept in `folder`."""
    own = [frame for scene in OWN for frame in frames_of_scene(scene, folder)]
    broad: list[list[TrueFrame]] = []

    def frame_of(step: int, rng: np.random.Generator) -> TrueFrame:
        count = max(count for first, count in STAGES if first <= step)
        broad.extend(frames_of_scene(scene, folder) for scene in BROAD[len(broad) : count])
        if count == 0 or rng.random() < OWN_SHARE:
            return own[int(rng.integers(len(own)))]
        frames = broad[int(rng.integers(count))]
        return frames[int(rng.integers(len(frames)))]

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
