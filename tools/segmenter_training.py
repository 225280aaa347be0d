"""Grow the trees that join fragments into things, from synthetic recordings and their truth.

Each keyframe falls into fragments, and their true owners say which pairs are one thing. Trees are grown twice: on pairs
of fragments and of groups partly joined by the truth, then also on the groups that the first trees come to. Everything
is drawn from seeds. Needs the optional group `train`.
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

from hickory_stream.evaluation.truth import instances_of, load_truth
from hickory_stream.evaluation.worlds.cache import cached_recording
from hickory_stream.evaluation.worlds.recording import RecordingConfig
from hickory_stream.json_text import dumps_exactly
from hickory_stream.perception.affinity import pair_features
from hickory_stream.perception.geometric import GeometricConfig, GeometricSegmenter
from hickory_stream.perception.join import Groups, JoinConfig, measured, rounds
from hickory_stream.perception.masks import enlarged_mask
from hickory_stream.perception.trees import EMBEDDED, Trees
from hickory_stream.records import Segmentation
from tools.benchmarks.first_layer import play_first_layer
from tools.benchmarks.mask_scores import UNKNOWN, MaskScore, score_masks, total

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from hickory_stream.evaluation.truth import Truth
    from hickory_stream.perception.parts import Measures
    from hickory_stream.records import Frame, ObservedSpace

_PACKAGE = Path(__file__).resolve().parents[1] / "hickory_stream" / "perception"
TRAINING = (
    *(("apartment", seed, walk) for seed, walk in ((24, 0), (25, 1), (26, 0), (27, 1), (28, 0))),
    *(("apartment", seed, walk) for seed, walk in ((29, 1), (30, 0), (31, 1), (32, 0))),
    *(("tabletop", seed, 0) for seed in (33, 34, 35)),
)
HELD_OUT = (("apartment", 38, 0), ("apartment", 39, 1), ("tabletop", 40, 0))
"""Scenes, seeds and walks; those of `tools/bench` are others."""

_RATE_HZ = 1.5
_PURE = 0.6
_EAGER = 0.4
_SHARES = (0.4, 0.8)
_LEAST_PIXELS = 20.0
_MIN_SHARE = 0.002


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Lesson:
    """A keyframe to learn from: its fragments and how many pixels (fragments, owners) of each show which `owners`.

    Owner 0 is what is no thing.
    """

    measures: Measures
    shown: NDArray[np.float64]
    owners: NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Samples:
    """Pairs to learn from: features (N, F), whether they are one thing, and how much each counts."""

    features: NDArray[np.float64]
    is_one: NDArray[np.bool_]
    weight: NDArray[np.float64]


class TrueMasks:
    """A segmenter that knows the truth: the maps of which lessons see the space depend on no trees."""

    def __init__(self, truth: Truth) -> None:
        self._truth = truth
        self._stamps = np.array([frame.stamp_ns for frame in truth.frames])
        self._segmenter = GeometricSegmenter(GeometricConfig(), _NO_TREES)
        self.lessons: list[Lesson] = []

    def prepare(self, frame: Frame) -> object:
        """Return the surface of a frame."""
        return self._segmenter.prepare(frame)

    def segment(self, frame: Frame, prior: ObservedSpace | None = None, prepared: object = None) -> Segmentation:
        """Return the true instances of a frame where structure is not found; its fragments become a lesson."""
        pieces = self._segmenter.fragments(frame, prior, prepared)
        shown = true_instances(self._truth, int(np.argmin(np.abs(self._stamps - frame.stamp_ns))))
        measures = measured(pieces.surface, pieces.labels, pieces.supports, pieces.scenery, JoinConfig())
        if measures is not None:
            self.lessons.append(_lesson(measures, shown, pieces.surface.factor))
        size = (frame.camera.width, frame.camera.height)
        structure = enlarged_mask(pieces.scenery.structure, pieces.surface.factor, size)
        _, instances = np.unique(np.where(structure | (shown <= 0), 0, shown), return_inverse=True)
        return Segmentation(
            instances=instances.reshape(shown.shape).astype(np.int32),
            structure=structure,
            floor_z_m=pieces.scenery.floor_z_m,
            rejected=(),
        )


_NO_TREES = Trees(
    features=(),
    baseline=0.0,
    roots=np.zeros(0, np.int32),
    feature=np.zeros(0, np.int16),
    threshold=np.zeros(0),
    left=np.zeros(0, np.int32),
    right=np.zeros(0, np.int32),
    nan_left=np.zeros(0, np.bool_),
    value=np.zeros(0, np.float32),
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Return the exit status."""
    parser = argparse.ArgumentParser(prog="tools/train_segmenter", description=__doc__)
    parser.add_argument("--out", type=Path, default=_PACKAGE / Path(EMBEDDED).parent, help="folder of trees and card")
    parser.add_argument("--seed", type=int, default=0, help="draws the partial joins and the growth of the trees")
    parser.add_argument("--trees", type=int, default=200, help="how many are grown")
    options = parser.parse_args(arguments)
    started_s = time.monotonic()
    lessons = [lesson for scene in TRAINING for lesson in lessons_of(*recording(*scene))]
    trees, num_pairs = train(lessons, seed=options.seed, num_trees=options.trees)
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / Path(EMBEDDED).name
    trees.save(path)
    card = {
        "what": "Boosted trees: the probability that two groups of fragments of an RGB-D frame are one thing.",
        "made_by": f"tools/train_segmenter --seed {options.seed} --trees {options.trees}",
        "scikit_learn": sklearn.__version__,
        "trained_on": [_name(*scene) for scene in TRAINING],
        "images_per_second": _RATE_HZ,
        "keyframes": len(lessons),
        "pairs": num_pairs,
        "trees": len(trees.roots),
        "inputs": len(trees.features),
        "bytes": path.stat().st_size,
        "held_out": {_name(*scene): _told(score(*recording(*scene), trees)) for scene in HELD_OUT},
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


def lessons_of(log: Path, truth: Truth, max_keyframes: int | None = None) -> list[Lesson]:
    """Return the lessons of a log, played with its true masks."""
    teacher = TrueMasks(truth)
    for _ in play_first_layer(log, segmenter=teacher, max_keyframes=max_keyframes):
        pass
    return teacher.lessons


def train(lessons: Sequence[Lesson], *, seed: int = 0, num_trees: int = 200) -> tuple[Trees, int]:
    """Return trees grown on lessons, and on how many pairs."""
    random = np.random.default_rng(seed)
    samples = [_samples_of_truth(lesson, share, random) for lesson in lessons for share in (0.0, *_SHARES)]
    names = tuple(_features_of(lessons[0], np.arange(len(lessons[0].shown)))[1])
    first = _grown(samples, names, seed, num_trees)
    samples += [sample for lesson in lessons for sample in _samples_of_rounds(lesson, first.probabilities)]
    return _grown(samples, names, seed, num_trees), sum(len(sample.is_one) for sample in samples)


def score(log: Path, truth: Truth, trees: Trees) -> MaskScore:
    """Return the score of the masks of a log, each keyframe seen with the map as it is after the one before."""
    stamps = np.array([frame.stamp_ns for frame in truth.frames])
    scores = []
    for seen in play_first_layer(log, segmenter=GeometricSegmenter(GeometricConfig(), trees)):
        shown = true_instances(truth, int(np.argmin(np.abs(stamps - seen.frame.stamp_ns))))
        scores.append(score_masks(seen.perceived.segmentation.instances, shown, int(_MIN_SHARE * shown.size)))
    return total(scores)


def true_instances(truth: Truth, index: int) -> NDArray[np.int32]:
    """Return what each pixel of a true frame shows: an object, 0 for structure, `UNKNOWN` for a passer-by."""
    shown = instances_of(truth, truth.frames[index]).astype(np.int32)
    things = [item.id for item in truth.objects]
    return np.where(np.isin(shown, things) | (shown == 0), shown, UNKNOWN).astype(np.int32)


def _lesson(measures: Measures, shown: NDArray[np.int32], factor: int) -> Lesson:
    labels = measures.labels
    height, width = labels.shape
    owners, place = np.unique(shown[::factor, ::factor][:height, :width], return_inverse=True)
    count = len(measures.parts.pixels)
    key = labels.ravel().astype(np.int64) * len(owners) + place.ravel()
    pixels = np.bincount(key, minlength=count * len(owners)).reshape(count, len(owners)).astype(np.float64)
    pixels[0] = 0.0
    return Lesson(measures=measures, shown=pixels, owners=owners.astype(np.int64))


def _features_of(
    lesson: Lesson, numbers: NDArray[np.int64]
) -> tuple[NDArray[np.int64], Mapping[str, NDArray[np.float64]]]:
    return pair_features(lesson.measures, numbers, int(numbers.max()) + 1)


def _samples_of_truth(lesson: Lesson, share: float, random: np.random.Generator) -> Samples:
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
    return _samples(lesson, numbers, pairs, features)


def _samples_of_rounds(
    lesson: Lesson, probabilities: Callable[[Mapping[str, NDArray[np.float64]]], NDArray[np.float64]]
) -> Iterable[Samples]:
    """Yield the pairs of each round of joining by given probabilities, more eagerly than a segmenter joins."""
    for step in rounds(lesson.measures, probabilities, JoinConfig(probability=_EAGER)):
        yield _samples(lesson, step.numbers, step.pairs, step.features)


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
) -> Samples:
    is_one, counts, pixels = _truth_of(lesson, numbers, pairs)
    rows = np.stack(list(features.values()), axis=1)
    # What is small costs little where it is joined wrongly, but there is much of it.
    weight = np.sqrt(np.maximum(pixels, _LEAST_PIXELS))
    return Samples(features=rows[counts], is_one=is_one[counts], weight=weight[counts])


def _grown(samples: Sequence[Samples], names: tuple[str, ...], seed: int, num_trees: int) -> Trees:
    rows = np.concatenate([sample.features for sample in samples])
    weight = np.concatenate([sample.weight for sample in samples])
    classifier = HistGradientBoostingClassifier(
        max_iter=num_trees,
        learning_rate=0.08,
        max_leaf_nodes=15,
        min_samples_leaf=30,
        l2_regularization=1.0,
        early_stopping=False,
        random_state=seed,
    )
    classifier.fit(rows, np.concatenate([sample.is_one for sample in samples]), sample_weight=weight / weight.mean())
    trees = exported(classifier, names)
    few = rows[:: max(1, len(rows) // 1000)]
    off = np.abs(trees.probabilities(dict(zip(names, few.T, strict=True))) - classifier.predict_proba(few)[:, 1]).max()
    if off > 1e-5:
        raise RuntimeError(f"exported trees differ from scikit-learn's by {off:.2g}: its nodes mean something else now")
    return trees


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
