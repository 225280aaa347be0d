"""Trees grown from lessons: which pairs of fragments, and of groups partly joined, are one thing by the truth."""
# A forest is grown twice: on pairs of fragments and of groups partly joined by the truth, then also on the groups that
# the first trees come to. Everything is drawn from a seed.

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import HistGradientBoostingClassifier

from hickory_stream.perception.regions.features import joined
from hickory_stream.perception.regions.join import Groups, JoinConfig, rounds
from hickory_stream.perception.regions.odds_features import odds_features
from hickory_stream.perception.regions.pair_features import pair_features
from hickory_stream.perception.regions.trees import Trees
from tools.segmenter_lessons import Lesson

_PURE = 0.6
_EAGER = 0.4
_SHARES = (0.4, 0.8)
_EVERY = 2
"""One in so many lessons is joined by the first trees."""
_MUTE_EVERY = 7
"""In one of so many lessons the network is taken to have said nothing."""
_LEAST_PIXELS = 20.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Samples:
    """Pairs to learn from: features (N, F), whether they are one thing, and how much each counts."""

    features: NDArray[np.float64]
    is_one: NDArray[np.bool_]
    weight: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, slots=True)
class Growth:
    """How trees are grown: `seed`, how many, and with how many leaves each."""

    seed: int = 0
    num_trees: int = 160
    num_leaves: int = 15


def train(
    kinds: Sequence[Sequence[Lesson]], growth: Growth, shares: Sequence[float] | None = None
) -> tuple[Trees, int]:
    """Return trees grown on the lessons of kinds of rooms, and on how many pairs."""
    # `shares` is what each kind weighs; None: all count alike.
    shares = shares or [1.0] * len(kinds)
    random = np.random.default_rng(growth.seed)
    kinds = [_partly_mute(kind) for kind in kinds]
    some = next(lesson for kind in kinds for lesson in kind)
    names = _names(some)
    samples = [
        [_samples_of_truth(lesson, share, names, random) for lesson in kind for share in (0.0, *_SHARES)]
        for kind in kinds
    ]
    first = _grown(samples, shares, names, replace(growth, num_trees=max(1, growth.num_trees // 2)))
    for own, kind in zip(samples, kinds, strict=True):
        for lesson in kind[::_EVERY]:
            own += _samples_of_rounds(lesson, names, first.probabilities)
    return _grown(samples, shares, names, growth), sum(len(sample.is_one) for own in samples for sample in own)


def _partly_mute(lessons: Sequence[Lesson]) -> list[Lesson]:
    return [replace(lesson, odds=None) if i % _MUTE_EVERY == 0 else lesson for i, lesson in enumerate(lessons)]


def _names(lesson: Lesson) -> tuple[str, ...]:
    numbers = np.arange(len(lesson.shown))
    pairs, features = pair_features(lesson.measures, numbers, len(numbers))
    return (*features, *odds_features(None, pairs, len(numbers)))


def _features_of(
    lesson: Lesson, numbers: NDArray[np.int64]
) -> tuple[NDArray[np.int64], Mapping[str, NDArray[np.float64]]]:
    count = int(numbers.max()) + 1
    pairs, features = pair_features(lesson.measures, numbers, count)
    odds = None if lesson.odds is None else lesson.odds.of_groups(numbers, count)
    return pairs, joined(features, odds_features(odds, pairs, count))


def _samples_of_truth(lesson: Lesson, share: float, names: tuple[str, ...], random: np.random.Generator) -> Samples:
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
    for step in rounds(lesson.measures, probabilities, JoinConfig(probability=_EAGER), lesson.odds):
        yield _samples(lesson, step.numbers, step.pairs, step.features, names)


def _truth_of(
    lesson: Lesson, numbers: NDArray[np.int64], pairs: NDArray[np.int64]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.float64]]:
    shown = np.zeros((int(numbers.max()) + 1, len(lesson.owners)))
    np.add.at(shown, numbers, lesson.shown)
    most, pixels = shown.argmax(axis=1), np.maximum(shown.sum(axis=1), 1)
    owner, is_pure = lesson.owners[most], shown.max(axis=1) > _PURE * pixels
    a, b = pairs.T
    is_one = (owner[a] == owner[b]) & (owner[a] > 0)
    counts = is_pure[a] & is_pure[b] & ((owner[a] > 0) | (owner[b] > 0))
    return is_one, counts, np.minimum(pixels[a], pixels[b])


def _samples(
    lesson: Lesson, numbers: NDArray[np.int64], pairs: NDArray[np.int64], features: Mapping[str, NDArray[np.float64]],
    names: tuple[str, ...],
) -> Samples:  # fmt: skip
    is_one, counts, pixels = _truth_of(lesson, numbers, pairs)
    rows = np.stack([features[name] for name in names], axis=1)
    # What is small costs little where it is joined wrongly, but there is much of it.
    weight = np.sqrt(np.maximum(pixels, _LEAST_PIXELS))
    return Samples(features=rows[counts], is_one=is_one[counts], weight=weight[counts])


def _grown(
    kinds: Sequence[Sequence[Samples]], shares: Sequence[float], names: tuple[str, ...], growth: Growth
) -> Trees:
    rows = np.concatenate([sample.features for samples in kinds for sample in samples])
    weight = np.concatenate([share * _alike(samples) for share, samples in zip(shares, kinds, strict=True)])
    classifier = HistGradientBoostingClassifier(
        max_iter=growth.num_trees, learning_rate=0.1, max_leaf_nodes=growth.num_leaves, min_samples_leaf=60,
        l2_regularization=5.0, early_stopping=False, random_state=growth.seed,
        monotonic_cst=[_direction(name) for name in names],
    )  # fmt: skip
    is_one = np.concatenate([sample.is_one for samples in kinds for sample in samples])
    classifier.fit(rows, is_one, sample_weight=weight / weight.mean())
    trees = exported(classifier, names)
    few = rows[:: max(1, len(rows) // 1000)]
    off = np.abs(trees.probabilities(dict(zip(names, few.T, strict=True))) - classifier.predict_proba(few)[:, 1]).max()
    if off > 1e-5:
        raise RuntimeError(f"exported trees differ from scikit-learn's by {off:.2g}: its nodes mean something else now")
    return trees


def _direction(name: str) -> int:
    # Return 1 where more of an input can only make one thing likelier, -1 for the opposite, else 0. What the network
    # says of a pair is held to what it means, lest trees learn from where it is wrong in our rooms.
    if name.startswith("odds_") and name not in ("odds_near_share", "odds_far_share"):
        return -1 if name.endswith(("_apart", "_below_even")) else 1
    return -1 if name.endswith("_odds_below_best") else 0


def _alike(samples: Sequence[Samples]) -> NDArray[np.float64]:
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
        features=names, baseline=float(classifier._baseline_prediction.item()), roots=starts[:-1].astype(np.int32),
        feature=np.where(is_leaf, -1, every["feature_idx"]).astype(np.int16),
        threshold=every["num_threshold"].astype(np.float64), left=(every["left"] + shift).astype(np.int32),
        right=(every["right"] + shift).astype(np.int32), nan_left=every["missing_go_to_left"].astype(bool),
        value=every["value"].astype(np.float32),
    )  # fmt: skip
