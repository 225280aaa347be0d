"""Which synthetic scenes are learnt from: mostly rooms of the broad generator, beside own ones."""

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
BROAD = tuple(Scene(kind="clutter-training", seed=seed, frames=48) for seed in range(48))
OWN_SHARE = 0.2
RENDERED_AT = "f4e6ad6"
"""The commit whose generators made the frames of the weights in the package: later ones give other frames."""
HELD_OUT = (
    *(Scene(kind="apartment", seed=seed, frames=16) for seed in (315, 316)),
    Scene(kind="clutter-tuning", seed=0, frames=48),
)
"""Own rooms of other seeds, and random rooms of another family: nothing was trained on them."""


def drawn_frames(folder: Path) -> Callable[[np.random.Generator], TrueFrame]:
    """Return what draws the frame of a lesson; scenes are rendered once and kept in `folder`."""
    own = [frame for scene in OWN for frame in frames_of_scene(scene, folder)]
    broad = [frame for scene in BROAD for frame in frames_of_scene(scene, folder)]

    def frame_of(rng: np.random.Generator) -> TrueFrame:
        frames = own if rng.random() < OWN_SHARE else broad
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
