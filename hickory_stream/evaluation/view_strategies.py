"""The paper's comparison of view choice: one log, five strategies, each object reconstructed from its one best view.

The strategies change the choice of the best view, not the tracks, so that objects differ between runs by their shapes
alone. Means are given over all true objects, with 0 for a missed one, and over those that every strategy has matched.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, get_args

import numpy as np

from hickory_stream.engine.mapper import Mapper
from hickory_stream.engine.play import play
from hickory_stream.engine.saved_map import open_map
from hickory_stream.evaluation.evaluate import evaluate
from hickory_stream.mapping.views import Strategy

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from hickory_stream.config import MapperConfig
    from hickory_stream.engine.map_folder import MapFolder
    from hickory_stream.engine.run_progress import Progress
    from hickory_stream.evaluation.evaluate import Evaluation
    from hickory_stream.evaluation.truth import Truth
    from hickory_stream.ports import Sink, Source

OURS: Strategy = "s_score"
STRATEGIES: tuple[Strategy, ...] = get_args(Strategy)


@dataclass(frozen=True, kw_only=True, slots=True)
class StrategyScore:
    """Means over the true objects of all logs; the `common_` ones over those that every strategy has matched."""

    strategy: str
    f1_5pct: float
    f1_1cm: float
    adds_10: float
    adds_05: float
    common_f1_5pct: float
    num_objects: int
    num_common: int


def evaluate_strategy(
    source: Source,
    truth: Truth,
    config: MapperConfig,
    strategy: Strategy,
    out: Path,
    sinks: Callable[[MapFolder], list[tuple[Sink, bool]]],
    progress: Callable[[Progress], None] = lambda _: None,
) -> Evaluation:
    """Map a log with a strategy and the `single_view` reconstructor into the folder `out`, and compare with truth.

    Raises:
        HickoryError: the log, the map folder or the truth cannot be used.
    """
    mapping = replace(config.mapping, views=replace(config.mapping.views, strategy=strategy))
    config = replace(config, mapping=mapping, shapes=replace(config.shapes, reconstructor="single_view"))
    play(Mapper(config, out=out, overwrite=True), source, sinks=sinks, progress=progress)
    return evaluate(open_map(out), truth)


def compare(evaluations: Mapping[str, Sequence[Evaluation]]) -> list[StrategyScore]:
    """Return the scores of strategies, each evaluated on the same logs in the same order; best F1 first."""
    matched = [
        {(i, row.truth_id) for i, evaluation in enumerate(logs) for row in evaluation.objects if row.map_id is not None}
        for logs in evaluations.values()
    ]
    common = set.intersection(*matched) if matched else set()
    scores = [_score(strategy, logs, common) for strategy, logs in evaluations.items()]
    return sorted(scores, key=lambda score: (-score.f1_5pct, score.strategy))


def format_comparison(scores: Sequence[StrategyScore]) -> str:
    """Return the table of strategies, and whether S is the best."""
    head = f"{'strategy':<14}{'F1 5 %':>9}{'F1 1 cm':>9}{'ADD-S .1':>10}{'ADD-S .05':>11}{'F1 of common':>14}"
    lines = [head]
    lines += [
        f"{s.strategy:<14}{s.f1_5pct:>9.3f}{s.f1_1cm:>9.3f}{s.adds_10:>10.3f}{s.adds_05:>11.3f}{s.common_f1_5pct:>14.3f}"
        for s in scores
    ]
    total = f"{scores[0].num_objects} true objects, {scores[0].num_common} matched by every strategy"
    lines += ["", total, verdict(scores)]
    return "\n".join(lines)


def verdict(scores: Sequence[StrategyScore]) -> str:
    """Return a sentence that compares S with the other strategies."""
    ours = next(score for score in scores if score.strategy == OURS)
    better = [s for s in scores if s.strategy != OURS and s.f1_5pct >= ours.f1_5pct]
    if not better:
        return f"{OURS} chooses the views with the highest mean F1"
    told = ", ".join(f"{s.strategy} ({s.f1_5pct - ours.f1_5pct:+.3f})" for s in better)
    return f"{OURS} is not the best: {told}"


def _score(strategy: str, logs: Sequence[Evaluation], common: set[tuple[int, int]]) -> StrategyScore:
    rows = [((i, row.truth_id), row) for i, evaluation in enumerate(logs) for row in evaluation.objects]
    shared = [row.f1_5pct for key, row in rows if key in common]

    def success(limit: float) -> float:
        return float(np.mean([row.add_s_m is not None and row.add_s_m < limit * row.diameter_m for _, row in rows]))

    return StrategyScore(
        strategy=strategy,
        f1_5pct=float(np.mean([row.f1_5pct for _, row in rows])),
        f1_1cm=float(np.mean([row.f1_1cm for _, row in rows])),
        adds_10=success(0.1),
        adds_05=success(0.05),
        common_f1_5pct=float(np.mean(shared)) if shared else 0.0,
        num_objects=len(rows),
        num_common=len(common),
    )
