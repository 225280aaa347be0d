"""Grow the trees that join fragments into things, from synthetic rooms and their truth.

Each image falls into fragments, and their true owners say which pairs are one thing. Two forests are grown and their
log-odds averaged: one on our apartments and table-tops, with all inputs, and one on random rooms as well, which count
as much as these, with inputs that know no sizes. Each is grown twice: on pairs of fragments and of groups partly joined
by the truth, then also on the groups that the first trees come to. Everything is drawn from seeds. Needs the optional
group `train`.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import sklearn
from sklearn.ensemble import HistGradientBoostingClassifier

from hickory_stream.evaluation.truth import load_truth
from hickory_stream.evaluation.worlds.cache import cached_recording
from hickory_stream.evaluation.worlds.recording import RecordingConfig
from hickory_stream.json_text import dumps_exactly
from hickory_stream.perception.affinity import pair_features
from hickory_stream.perception.geometric import GeometricConfig, GeometricSegmenter
from hickory_stream.perception.join import Groups, JoinConfig, rounds
from hickory_stream.perception.sizes import is_size
from hickory_stream.perception.trees import EMBEDDED, Trees, averaged
from tools.benchmarks.first_layer import play_first_layer
from tools.benchmarks.mask_scores import MaskScore, score_masks, total
from tools.segmenter_lessons import lessons_of, lessons_of_rooms, score_groups, true_groups, true_instances

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from hickory_stream.evaluation.truth import Truth
    from tools.segmenter_lessons import Lesson

_PACKAGE = Path(__file__).resolve().parents[1] / "hickory_stream" / "perception"
_FILE = _PACKAGE / EMBEDDED["mixed"]
_JOIN = JoinConfig(forest="mixed", probability=0.5)
"""How fragments are joined by what is grown here; the default probability is for the forest of sizes."""
ROOMS = (0, 1)
"""Seeds of random rooms of the family `training`, `_IMAGES` of each."""
TRAINING = (
    *(("apartment", seed, walk) for seed, walk in ((24, 0), (25, 1), (26, 0), (27, 1), (28, 0))),
    *(("apartment", seed, walk) for seed, walk in ((29, 1), (30, 0), (31, 1), (32, 0))),
    *(("tabletop", seed, 0) for seed in (33, 34, 35)),
)
HELD_OUT = (("apartment", 38, 0), ("tabletop", 40, 0))
"""Scenes, seeds and walks; those of `tools/bench` are others."""

_IMAGES = 300
_HELD_OUT_IMAGES = 80
_RATE_HZ = 1.5
_PURE = 0.6
_EAGER = 0.4
_SHARES = (0.4, 0.8)
_EVERY = 2
_LEAST_PIXELS = 20.0
_MIN_SHARE = 0.002


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Samples:
    """Pairs to learn from: features (N, F), whether they are one thing, and how much each counts."""

    features: NDArray[np.float64]
    is_one: NDArray[np.bool_]
    weight: NDArray[np.float64]


def main(arguments: Sequence[str] | None = None) -> int:
    """Return the exit status."""
    parser = argparse.ArgumentParser(prog="tools/train_segmenter", description=__doc__)
    parser.add_argument("--out", type=Path, default=_FILE.parent, help="folder of trees and card")
    parser.add_argument("--seed", type=int, default=0, help="draws the partial joins and the growth of the trees")
    parser.add_argument("--trees", type=int, default=120, help="how many are grown")
    options = parser.parse_args(arguments)
    started_s = time.monotonic()
    rooms = [lessons_of_rooms(seed, "training", _IMAGES) for seed in ROOMS]
    logs = [lessons_of(*recording(*scene)) for scene in TRAINING]
    kinds = [[lesson for lessons in kind for lesson in lessons] for kind in (rooms, logs)]
    of_sizes, size_pairs = train(kinds[1:], seed=options.seed, num_trees=options.trees)
    of_shapes, shape_pairs = train(
        [kinds[0], kinds[1][::_EVERY]], seed=options.seed, num_trees=options.trees, with_sizes=False
    )
    trees = averaged(of_sizes, of_shapes)
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / _FILE.name
    trees.save(path)
    card = {
        "what": "Boosted trees: the probability that two groups of fragments of an RGB-D frame are one thing.",
        "made_by": f"tools/train_segmenter --seed {options.seed} --trees {options.trees}",
        "scikit_learn": sklearn.__version__,
        "trained_on": [
            *(f"random rooms, family training, seed {seed}: {_IMAGES} images" for seed in ROOMS),
            *(_name(*scene) for scene in TRAINING),
        ],
        "images_per_second": _RATE_HZ,
        "images": [len(kind) for kind in kinds],
        "pairs": {"forest_of_sizes": size_pairs, "forest_of_shapes": shape_pairs},
        "trees": len(trees.roots),
        "inputs": len(trees.features),
        "bytes": path.stat().st_size,
        "held_out": {_name(*scene): _told(score(*recording(*scene), trees)) for scene in HELD_OUT}
        | _told_of_rooms(trees),
        "minutes": round((time.monotonic() - started_s) / 60, 1),
    }
    text = dumps_exactly(card, indent=2)
    path.with_suffix(".json").write_text(text + "\n")
    print(text)
    return 0


def recording(scene: str, seed: int, walk: int) -> tuple[Path, Truth]:
    """Return the log and the truth of a scene; made if they are not cached."""
    print(f"recording {_name(scene, seed, walk)}", file=sys.stderr, flush=True)
    config = RecordingConfig(
        scene=scene, seed=seed, walk_index=walk, seconds=None, rate_hz=_RATE_HZ, width=640, height=480
    )
    log, _ = cached_recording(config)
    return log, load_truth(log.with_suffix(".truth"))


def train(
    kinds: Sequence[Sequence[Lesson]], *, seed: int = 0, num_trees: int = 120, with_sizes: bool = True
) -> tuple[Trees, int]:
    """Return trees grown on the lessons of kinds of rooms, all of which count alike, and on how many pairs."""
    random = np.random.default_rng(seed)
    some = next(lesson for kind in kinds for lesson in kind)
    _, features = _features_of(some, np.arange(len(some.shown)))
    names = tuple(name for name in features if with_sizes or not is_size(name))
    samples = [
        [_samples_of_truth(lesson, share, names, random) for lesson in kind for share in (0.0, *_SHARES)]
        for kind in kinds
    ]
    first = _grown(samples, names, seed, max(1, num_trees // 2))
    for own, kind in zip(samples, kinds, strict=True):
        for lesson in kind[::_EVERY]:
            own += _samples_of_rounds(lesson, names, first.probabilities)
    return _grown(samples, names, seed, num_trees), sum(len(sample.is_one) for own in samples for sample in own)


def score(log: Path, truth: Truth, trees: Trees) -> MaskScore:
    """Return the score of the masks of a log, each keyframe seen with the map as it is after the one before."""
    stamps = np.array([frame.stamp_ns for frame in truth.frames])
    scores = []
    for seen in play_first_layer(log, segmenter=GeometricSegmenter(GeometricConfig(join=_JOIN), trees)):
        shown = true_instances(truth, int(np.argmin(np.abs(stamps - seen.frame.stamp_ns))))
        scores.append(score_masks(seen.perceived.segmentation.instances, shown, int(_MIN_SHARE * shown.size)))
    return total(scores)


def _features_of(
    lesson: Lesson, numbers: NDArray[np.int64]
) -> tuple[NDArray[np.int64], Mapping[str, NDArray[np.float64]]]:
    return pair_features(lesson.measures, numbers, int(numbers.max()) + 1)


def _samples_of_truth(lesson: Lesson, share: float, names: tuple[str, ...], random: np.random.Generator) -> Samples:
    """Return the pairs that are left when about this share of the true joins is made."""
    numbers = np.arange(len(lesson.shown))
    pairs, features = _features_of(lesson, numbers)
    if share > 0:
        is_one, counts, _ = _truth_of(lesson, numbers, pairs)
        joined = pairs[is_one & counts & (random.random(len(pairs)) < share)]
        groups = Groups(len(numbers))
        groups.unite((int(a), int(b)) for a, b in joined)
        numbers = groups.numbers()[0]
        pairs, features = _features_of(lesson, numbers)
    return _samples(lesson, numbers, pairs, features, names)


def _samples_of_rounds(
    lesson: Lesson,
    names: tuple[str, ...],
    probabilities: Callable[[Mapping[str, NDArray[np.float64]]], NDArray[np.float64]],
) -> Iterable[Samples]:
    """Yield the pairs of each round of joining by given probabilities, more eagerly than a segmenter joins."""
    for step in rounds(lesson.measures, probabilities, JoinConfig(probability=_EAGER)):
        yield _samples(lesson, step.numbers, step.pairs, step.features, names)


def _truth_of(
    lesson: Lesson, numbers: NDArray[np.int64], pairs: NDArray[np.int64]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.float64]]:
    """Return (K,) which pairs are one thing, which count (both are mostly of one owner, one of a thing), and pixels."""
    shown = np.zeros((int(numbers.max()) + 1, len(lesson.owners)))
    np.add.at(shown, numbers, lesson.shown)
    most, pixels = shown.argmax(axis=1), np.maximum(shown.sum(axis=1), 1)
    owner, is_pure = lesson.owners[most], shown.max(axis=1) > _PURE * pixels
    a, b = pairs.T
    is_one = (owner[a] == owner[b]) & (owner[a] > 0)
    counts = is_pure[a] & is_pure[b] & ((owner[a] > 0) | (owner[b] > 0))
    return is_one, counts, np.minimum(pixels[a], pixels[b])


def _samples(
    lesson: Lesson,
    numbers: NDArray[np.int64],
    pairs: NDArray[np.int64],
    features: Mapping[str, NDArray[np.float64]],
    names: tuple[str, ...],
) -> Samples:
    is_one, counts, pixels = _truth_of(lesson, numbers, pairs)
    rows = np.stack([features[name] for name in names], axis=1)
    # What is small costs little where it is joined wrongly, but there is much of it.
    weight = np.sqrt(np.maximum(pixels, _LEAST_PIXELS))
    return Samples(features=rows[counts], is_one=is_one[counts], weight=weight[counts])


def _grown(kinds: Sequence[Sequence[Samples]], names: tuple[str, ...], seed: int, num_trees: int) -> Trees:
    rows = np.concatenate([sample.features for samples in kinds for sample in samples])
    weight = np.concatenate([_alike(samples) for samples in kinds])
    classifier = HistGradientBoostingClassifier(
        max_iter=num_trees,
        learning_rate=0.1,
        max_leaf_nodes=15,
        min_samples_leaf=60,
        l2_regularization=5.0,
        early_stopping=False,
        random_state=seed,
    )
    is_one = np.concatenate([sample.is_one for samples in kinds for sample in samples])
    classifier.fit(rows, is_one, sample_weight=weight / weight.mean())
    trees = exported(classifier, names)
    few = rows[:: max(1, len(rows) // 1000)]
    off = np.abs(trees.probabilities(dict(zip(names, few.T, strict=True))) - classifier.predict_proba(few)[:, 1]).max()
    if off > 1e-5:
        raise RuntimeError(f"exported trees differ from scikit-learn's by {off:.2g}: its nodes mean something else now")
    return trees


def _alike(samples: Sequence[Samples]) -> NDArray[np.float64]:
    """Return the weights of a kind's samples, that together weigh one."""
    weight = np.concatenate([sample.weight for sample in samples])
    return np.asarray(weight / weight.sum())


def exported(classifier: HistGradientBoostingClassifier, names: tuple[str, ...]) -> Trees:
    """Return a fitted classifier as trees: its nodes have no public form, `_grown` checks that they are understood."""
    nodes = [predictor.nodes for stage in classifier._predictors for predictor in stage]
    starts = np.concatenate([[0], np.cumsum([len(tree) for tree in nodes])])
    every = np.concatenate(nodes)
    shift = np.repeat(starts[:-1], np.diff(starts))
    is_leaf = every["is_leaf"].astype(bool)
    return Trees(
        features=names,
        baseline=float(classifier._baseline_prediction.item()),
        roots=starts[:-1].astype(np.int32),
        feature=np.where(is_leaf, -1, every["feature_idx"]).astype(np.int16),
        threshold=every["num_threshold"].astype(np.float64),
        left=(every["left"] + shift).astype(np.int32),
        right=(every["right"] + shift).astype(np.int32),
        nan_left=every["missing_go_to_left"].astype(bool),
        value=every["value"].astype(np.float32),
    )


def _name(scene: str, seed: int, walk: int) -> str:
    return f"{scene} {seed}, walk {walk}"


def _told_of_rooms(trees: Trees) -> dict[str, dict[str, float]]:
    """Return the scores of masks in random rooms of the family `tuning`, with our joins and with true ones."""
    lessons = lessons_of_rooms(0, "tuning", _HELD_OUT_IMAGES)
    ours = total(score_groups(lesson, joined(lesson, trees)) for lesson in lessons)
    truth = total(score_groups(lesson, true_groups(lesson)) for lesson in lessons)
    name = f"random rooms, family tuning, {len(lessons)} images"
    return {name: _told(ours), f"{name}, true joins": _told(truth)}


def joined(lesson: Lesson, trees: Trees) -> NDArray[np.int64]:
    """Return (fragments,) the groups that the fragments of a lesson are joined to."""
    *_, last = rounds(lesson.measures, trees.probabilities, _JOIN)
    return last.numbers


def _told(score: MaskScore) -> dict[str, float]:
    return {
        "f1_50": round(score.f1, 3),
        "best_iou": round(score.best_iou, 3),
        "found_fraction": round(score.found_fraction, 3),
        "things": score.num_things,
        "masks": score.num_masks,
    }


if __name__ == "__main__":
    sys.exit(main())
