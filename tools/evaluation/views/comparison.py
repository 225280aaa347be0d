"""Strategies compared: means over true objects, and what S is better by, object by object, with its certainty."""
# Objects of one scene depend on one another: differences are drawn by scene (cluster bootstrap: Davison and Hinkley,
# Bootstrap Methods and their Application, section 3.8); of few scenes by object, which the table says.

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tools.evaluation.views.trials import BEST, OURS, STRATEGIES, ViewTrial

_RESAMPLES = 10_000
_FEWEST_SCENES = 10


@dataclass(frozen=True, kw_only=True, slots=True)
class PairedDifference:
    """The mean difference between two figures of the same objects, its 95 % interval, and the p-value of "none"."""

    # `p_value` is two-sided, by the bootstrap, and never below one draw of it.
    mean: float
    low: float
    high: float
    p_value: float


@dataclass(frozen=True, kw_only=True, slots=True)
class StrategyScore:
    """Means over the true objects of all logs, 0 for one without a shape; `common_` over those that the map holds."""

    # `s_minus_this` is by how much the mean F1 at 5 % of S is higher, None for S itself. The strategy `best` is the
    # best view of those that were tried, by truth.
    strategy: str
    f1_5pct: float
    f1_1cm: float
    adds_10: float
    adds_05: float
    common_f1_5pct: float
    num_objects: int
    num_common: int
    num_scenes: int
    s_minus_this: PairedDifference | None


def compare(scenes: Sequence[Sequence[ViewTrial]]) -> list[StrategyScore]:
    """Return the scores of strategies over the trials of scenes, best F1 first; raises ValueError without a trial."""
    if not any(scenes):
        raise ValueError("found no true object that counts; expected one at least")
    scores = [_score(strategy, scenes) for strategy in (*STRATEGIES, BEST)]
    return sorted(scores, key=lambda score: (-score.f1_5pct, score.strategy))


def paired_difference(differences: Sequence[NDArray[np.float64]]) -> PairedDifference:
    """Return the mean of differences (N,) of each scene, drawn again by scene; of few scenes by object."""
    clusters = [each for each in differences if len(each)]
    if len(clusters) < _FEWEST_SCENES:
        clusters = [np.array([value]) for each in clusters for value in each]
    sums, counts = np.array([each.sum() for each in clusters]), np.array([len(each) for each in clusters])
    drawn = np.random.default_rng(0).integers(len(clusters), size=(_RESAMPLES, len(clusters)))
    means = sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    low, high = np.percentile(means, [2.5, 97.5])
    beyond = min(np.mean(means <= 0.0), np.mean(means >= 0.0))
    return PairedDifference(
        mean=float(sums.sum() / counts.sum()),
        low=float(low),
        high=float(high),
        p_value=float(min(1.0, max(2.0 * beyond, 1.0 / _RESAMPLES))),
    )


def format_comparison(scores: Sequence[StrategyScore]) -> str:
    lines = [
        f"{'strategy':<14}{'F1 5 %':>9}{'F1 1 cm':>9}{'ADD-S .1':>10}{'ADD-S .05':>11}{'F1 of common':>14}"
        f"{'S better by':>13}{'95 %':>18}{'p':>8}"
    ]
    for s in scores:
        line = f"{s.strategy:<14}{s.f1_5pct:>9.3f}{s.f1_1cm:>9.3f}{s.adds_10:>10.3f}{s.adds_05:>11.3f}"
        line += f"{s.common_f1_5pct:>14.3f}"
        if (paired := s.s_minus_this) is not None:
            told = f"{paired.low:+.4f}..{paired.high:+.4f}"
            line += f"{paired.mean:>+13.4f}{told:>18}{paired.p_value:>8.4f}"
        lines.append(line)
    first = scores[0]
    drawn = "by scene" if first.num_scenes >= _FEWEST_SCENES else "by object"
    lines += [
        "",
        f"{first.num_objects} true objects of {first.num_scenes} logs, {first.num_common} of them in the maps; "
        f"intervals and p-values by the bootstrap, drawn {drawn}; best: of the views that were tried, as truth has it",
        verdict(scores),
    ]
    return "\n".join(lines)


def verdict(scores: Sequence[StrategyScore]) -> str:
    """Return a sentence that compares S with the best of the other strategies, and says how certain that is."""
    other = next(score for score in scores if score.strategy not in (OURS, BEST))
    paired = other.s_minus_this
    assert paired is not None, "only S itself is not compared with S"
    told = f"{abs(paired.mean):.4f} {'better' if paired.mean > 0 else 'worse'} than {other.strategy}, the next best"
    if paired.mean <= 0:
        told = told.replace("the next best", "the best of the others")
    certainty = "a difference that chance alone rarely makes" if paired.p_value < 0.05 else "which may be chance"
    return f"S is {told}: {certainty} (p = {paired.p_value:.4f})"


def _score(strategy: str, scenes: Sequence[Sequence[ViewTrial]]) -> StrategyScore:
    trials = [trial for scene in scenes for trial in scene]
    f1 = [np.array([_f1(trial, strategy) for trial in scene]) for scene in scenes]
    ours = [np.array([_f1(trial, OURS) for trial in scene]) for scene in scenes]
    common = [_f1(trial, strategy) for trial in trials if trial.scores]

    def success(limit: float) -> float:
        found = [(trial, trial.scores.get(strategy)) for trial in trials]
        return float(np.mean([one is not None and one.add_s_m < limit * trial.diameter_m for trial, one in found]))

    return StrategyScore(
        strategy=strategy, f1_5pct=float(np.concatenate(f1).mean()),
        f1_1cm=float(np.mean([one.f1_1cm if (one := trial.scores.get(strategy)) else 0.0 for trial in trials])),
        adds_10=success(0.1), adds_05=success(0.05), common_f1_5pct=float(np.mean(common)) if common else 0.0,
        num_objects=len(trials), num_common=len(common), num_scenes=sum(bool(scene) for scene in scenes),
        s_minus_this=None if strategy == OURS else paired_difference([a - b for a, b in zip(ours, f1, strict=True)]),
    )  # fmt: skip


def _f1(trial: ViewTrial, strategy: str) -> float:
    found = trial.scores.get(strategy)
    return 0.0 if found is None else found.f1_5pct
