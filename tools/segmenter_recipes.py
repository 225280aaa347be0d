"""The recipe of each forest of the package: its training examples and its inputs."""
# `mixed`: two forests whose log-odds are averaged, one on our apartments and table-tops, with all inputs, and one on
# random rooms as well, which count as much as these, with inputs that know no sizes. `odds`: also what the network of
# affinities says of a pair; only scenes that the network was not trained on, for of those it is too sure.

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hickory_stream.evaluation.truth import Truth, load_truth
from hickory_stream.perception.affinity.pixel_network import PixelNetwork
from hickory_stream.perception.regions.trees import Trees, averaged
from tools.network_training.scenes import Scene, told
from tools.segmenter_growth import EVERY, Growth, train
from tools.segmenter_lessons import Lesson, lessons_of, lessons_of_rooms, lessons_of_scene
from tools.worlds.cache import cached_recording
from tools.worlds.recording_config import RecordingConfig

ROOMS = (0, 1)
"""Seeds of random rooms of the family `training`, `IMAGES` of each, for `mixed`."""
IMAGES = 300
LOGS = (
    *(("apartment", seed, walk) for seed, walk in ((24, 0), (25, 1), (26, 0), (27, 1), (28, 0))),
    *(("apartment", seed, walk) for seed, walk in ((29, 1), (30, 0), (31, 1), (32, 0))),
    *(("tabletop", seed, 0) for seed in (33, 34, 35)),
)
"""Scenes, seeds and walks; those of `tools/bench` are others."""
ODDS_LOGS = tuple(
    log for log in LOGS if log[:2] not in {("apartment", s) for s in (27, 28, 31, 32)} | {("tabletop", 35)}
)
ODDS_VIEWS = (
    *(Scene(kind="apartment", seed=seed, frames=16) for seed in range(400, 412)),
    *(Scene(kind="tabletop", seed=seed, frames=10) for seed in range(400, 412, 2)),
)
ODDS_ROOMS = tuple(Scene(kind="clutter-training", seed=seed, frames=48) for seed in range(200, 224, 2))
ODDS_SHARES = (1.0, 0.6, 0.3)
"""What logs, single views of own rooms, and random rooms weigh in `odds`."""
RATE_HZ = 1.5


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Grown:
    """A forest, and what its card tells of how it was grown."""

    trees: Trees
    told: dict[str, object]


def grown_mixed(seed: int, num_trees: int) -> Grown:
    """Return the mixture of a forest of sizes and of one of shapes."""
    rooms = [lesson for room in ROOMS for lesson in lessons_of_rooms(room, "training", IMAGES)]
    logs = [lesson for scene in LOGS for lesson in lessons_of(*recording(*scene))]
    growth = Growth(seed=seed, num_trees=num_trees)
    of_sizes, size_pairs = train([logs], growth)
    of_shapes, shape_pairs = train([rooms, logs[::EVERY]], Growth(seed=seed, num_trees=num_trees, with_sizes=False))
    return Grown(
        trees=averaged(of_sizes, of_shapes),
        told={
            "trained_on": [
                *(f"random rooms, family training, seed {room}: {IMAGES} images" for room in ROOMS),
                *(name_of(*scene) for scene in LOGS),
            ],
            "images_per_second": RATE_HZ,
            "images": [len(rooms), len(logs)],
            "pairs": {"forest_of_sizes": size_pairs, "forest_of_shapes": shape_pairs},
        },
    )


def grown_with_odds(seed: int, num_trees: int, network: PixelNetwork, folder: Path) -> Grown:
    """Return a forest that has the network's odds among its inputs; `folder` keeps rendered views."""
    kinds = [
        [lesson for scene in ODDS_LOGS for lesson in lessons_of(*recording(*scene), network=network)],
        _lessons_of_views(ODDS_VIEWS, folder, network),
        _lessons_of_views(ODDS_ROOMS, folder, network),
    ]
    trees, num_pairs = train(kinds, Growth(seed=seed, num_trees=num_trees, with_odds=True), ODDS_SHARES)
    return Grown(
        trees=trees,
        told={
            "trained_on": {
                "logs": [name_of(*scene) for scene in ODDS_LOGS],
                "views": told(ODDS_VIEWS),
                "rooms": told(ODDS_ROOMS),
            },
            "images_per_second": RATE_HZ,
            "images": [len(kind) for kind in kinds],
            "shares": ODDS_SHARES,
            "pairs": num_pairs,
        },
    )


def _lessons_of_views(scenes: Sequence[Scene], folder: Path, network: PixelNetwork) -> list[Lesson]:
    return [lesson for scene in scenes for lesson in lessons_of_scene(scene, folder, network)]


def recording(scene: str, seed: int, walk: int) -> tuple[Path, Truth]:
    print(f"recording {name_of(scene, seed, walk)}", file=sys.stderr, flush=True)
    config = RecordingConfig(
        scene=scene, seed=seed, walk_index=walk, seconds=None, rate_hz=RATE_HZ, width=640, height=480
    )
    log, _ = cached_recording(config)
    return log, load_truth(log.with_suffix(".truth"))


def name_of(scene: str, seed: int, walk: int) -> str:
    return f"{scene} {seed}, walk {walk}"
