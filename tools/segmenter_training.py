"""Grow the trees that join fragments into things, from synthetic rooms and their truth.

Each image falls into fragments, and their true owners say which pairs are one thing. Everything is drawn from seeds.
Needs the optional group `train`, but no torch: the network that is in the package is asked for odds.
"""
# Only scenes that the network was not trained on: of those it is too sure.

import argparse
import hashlib
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import sklearn
from numpy.typing import NDArray

from hickory_stream.base.caches import cache_root
from hickory_stream.base.json_text import dumps_exactly
from hickory_stream.evaluation.truth import Truth, load_truth
from hickory_stream.perception.affinity import pixel_network
from hickory_stream.perception.affinity.pixel_network import PixelNetwork
from hickory_stream.perception.regions.join import JoinConfig, rounds
from hickory_stream.perception.regions.trees import EMBEDDED, Trees
from tools.evaluation.masks.scores import MaskScore, total
from tools.network_training.scenes import HELD_OUT as HELD_OUT_VIEWS
from tools.network_training.scenes import Scene, told
from tools.segmenter_growth import Growth, train
from tools.segmenter_lessons import Lesson, lessons_of, lessons_of_scene, score_groups, true_groups
from tools.worlds.cache import cached_recording
from tools.worlds.recording_config import RecordingConfig

LOGS = (
    *(("apartment", seed, walk) for seed, walk in ((24, 0), (25, 1), (26, 0), (29, 1), (30, 0))),
    *(("tabletop", seed, 0) for seed in (33, 34)),
)
"""Scenes, seeds and walks; those of `tools/bench` are others."""
VIEWS = (
    *(Scene(kind="apartment", seed=seed, frames=16) for seed in range(400, 412)),
    *(Scene(kind="tabletop", seed=seed, frames=10) for seed in range(400, 412, 2)),
)
ROOMS = tuple(Scene(kind="clutter-training", seed=seed, frames=48) for seed in range(200, 224, 2))
SHARES = (1.0, 0.6, 0.3)
"""What logs, single views of own rooms, and random rooms weigh."""
RATE_HZ = 1.5


def grown(seed: int, num_trees: int, network: PixelNetwork, folder: Path) -> tuple[Trees, dict[str, object]]:
    """Return a forest, and what its card tells of how it was grown; `folder` keeps rendered views."""
    kinds = [
        [lesson for scene in LOGS for lesson in lessons_of(*recording(*scene), network=network)],
        _lessons_of_views(VIEWS, folder, network),
        _lessons_of_views(ROOMS, folder, network),
    ]
    trees, num_pairs = train(kinds, Growth(seed=seed, num_trees=num_trees), SHARES)
    return trees, {
        "trained_on": {"logs": [name_of(*scene) for scene in LOGS], "views": told(VIEWS), "rooms": told(ROOMS)},
        "images_per_second": RATE_HZ, "images": [len(kind) for kind in kinds], "shares": SHARES, "pairs": num_pairs,
    }  # fmt: skip


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


_PACKAGE = Path(__file__).resolve().parents[1] / "hickory_stream" / "perception"
HELD_OUT = ("apartment", 38, 0)
"""Scene, seed and walk; those of `tools/bench` are others."""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="tools/train_segmenter", description=__doc__)
    parser.add_argument("--out", type=Path, default=(_PACKAGE / EMBEDDED).parent, help="folder of trees, card")
    parser.add_argument("--seed", type=int, default=0, help="draws the partial joins and the growth of the trees")
    parser.add_argument("--trees", type=int, default=Growth().num_trees, help="how many are grown")
    parser.add_argument(
        "--frames", type=Path, help="folder of rendered views; by default beside the caches, not capped"
    )
    options = parser.parse_args(arguments)
    frames = options.frames or cache_root() / "network-frames"
    network, join = PixelNetwork(), JoinConfig()
    started_s = time.process_time()
    trees, history = grown(options.seed, options.trees, network, frames)
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / Path(EMBEDDED).name
    trees.save(path)
    card = {
        "what": "Boosted trees: the probability that two groups of fragments of an RGB-D frame are one thing.",
        "made_by": f"tools/train_segmenter --seed {options.seed} --trees {options.trees}",
        "licence": "Apache-2.0, as the project: grown on scenes of its own generators alone, no data of others",
        "scikit_learn": sklearn.__version__,
        "network_sha256": _digest(_PACKAGE / pixel_network.EMBEDDED), **history,
        "trees": len(trees.roots), "inputs": len(trees.features), "bytes": path.stat().st_size,
        "held_out_from_probability": join.probability,
        "held_out": {name: _scores(lessons, trees, join) for name, lessons in _held_out(network, frames).items()},
        "processor_minutes": round((time.process_time() - started_s) / 60, 1),
    }  # fmt: skip
    text = dumps_exactly(card, indent=2)
    path.with_suffix(".json").write_text(text + "\n", encoding="utf-8")
    print(text)
    return 0


def _held_out(network: PixelNetwork, frames: Path) -> dict[str, list[Lesson]]:
    logs = {name_of(*HELD_OUT): lessons_of(*recording(*HELD_OUT), network=network)}
    return logs | {scene.name: lessons_of_scene(scene, frames, network) for scene in HELD_OUT_VIEWS}


def _scores(lessons: Sequence[Lesson], trees: Trees, join: JoinConfig) -> dict[str, dict[str, float]]:
    return {
        "ours": _told(total(score_groups(lesson, joined(lesson, trees, join)) for lesson in lessons)),
        "true_joins": _told(total(score_groups(lesson, true_groups(lesson)) for lesson in lessons)),
    }


def joined(lesson: Lesson, trees: Trees, join: JoinConfig) -> NDArray[np.int64]:
    *_, last = rounds(lesson.measures, trees.probabilities, join, lesson.odds)
    return last.numbers


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _told(score: MaskScore) -> dict[str, float]:
    return {
        "f1_50": round(score.f1, 3), "best_iou": round(score.best_iou, 3),
        "found_fraction": round(score.found_fraction, 3), "things": score.num_things, "masks": score.num_masks,
    }  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
