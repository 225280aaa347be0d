"""The pose graph's solver on simulated graphs: time, wrong loops rejected, true ones accepted, drift taken out."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.graph.config import GraphConfig
from hickory_stream.graph.solution import Solution
from hickory_stream.graph.solve import solve
from tools.benchmarks.figures import Figure
from tools.benchmarks.pose_graphs import simulated_graph

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tools.benchmarks.figures import Options

_NODES, _LOOPS, _WRONG = 300, 40, 4
_DRIFTS = (1.0, 3.0)


def graph_figures(options: Options) -> list[Figure]:
    """Return the figures of 20 seeded graphs at the drift that worlds have by default, and at three times it."""
    config = GraphConfig()
    num_seeds = 3 if options.quick else 20
    ms: list[float] = []
    wrong_accepted, true_accepted, num_graphs = 0, 0, 0
    ratios: dict[float, list[float]] = {drift: [] for drift in _DRIFTS}
    for drift in _DRIFTS:
        for seed in range(num_seeds):
            rng = np.random.default_rng((options.seed, seed))
            walk = simulated_graph(rng, config, num_nodes=_NODES, num_loops=_LOOPS, num_wrong=_WRONG, drift=drift)
            started = time.process_time()
            answer = solve(walk.graph, config)
            ms.append(1000 * (time.process_time() - started))
            num_graphs += 1
            if isinstance(answer, Solution):
                wrong_accepted += len(set(answer.accepted) & walk.wrong)
                true_accepted += len(set(answer.accepted) - walk.wrong)
                before, after = (_ate_m(p, walk.true) for p in (walk.graph.world_from_node, answer.world_from_node))
                ratios[drift].append(after / before)
    num_wrong, num_true = num_graphs * _WRONG, num_graphs * (_LOOPS - _WRONG)
    # The first solve loads the library and the compiled kernels.
    solve_ms = float(np.median(ms[1:]))
    what = f"of {num_graphs} graphs of {_NODES} nodes and {_LOOPS} loops"
    return [
        Figure(name="solve_ms", value=solve_ms, unit="ms", better="lower", of=f"processor time, the median {what}"),
        Figure(
            name="wrong_loops_rejected", value=1 - wrong_accepted / num_wrong, unit="", better="higher",
            of=f"{num_wrong - wrong_accepted} of {num_wrong}",
        ),
        Figure(
            name="true_loops_accepted", value=true_accepted / num_true, unit="", better="higher",
            of=f"{true_accepted} of {num_true}",
        ),
        *(
            Figure(
                name=f"graph_ate_ratio_{drift:.0f}x", value=float(np.median(found)), unit="", better="lower",
                of=f"after and before, the median of {len(found)} graphs",
            )
            for drift, found in ratios.items()
        ),
    ]  # fmt: skip


def _ate_m(poses: NDArray[np.float64], true: NDArray[np.float64]) -> float:
    """Return the root mean square error of places, the first pose being shared."""
    return float(np.sqrt(np.square(poses[:, :3, 3] - true[:, :3, 3]).sum(axis=1).mean()))
