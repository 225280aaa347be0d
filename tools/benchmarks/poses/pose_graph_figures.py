"""The pose graph's solver on simulated graphs: time, wrong loops rejected, true ones accepted, drift taken out."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from hickory_stream.graph.config import GraphConfig
from hickory_stream.graph.solution import Solution
from hickory_stream.graph.solve import solve
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.poses.pose_graphs import simulated_graph

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
        figure("solve_ms", solve_ms, "ms", "lower", f"processor time, the median {what}"),
        figure(
            "wrong_loops_rejected",
            1 - wrong_accepted / num_wrong,
            "",
            "higher",
            f"{num_wrong - wrong_accepted} of {num_wrong}",
        ),
        figure("true_loops_accepted", true_accepted / num_true, "", "higher", f"{true_accepted} of {num_true}"),
        *(
            figure(
                f"graph_ate_ratio_{drift:.0f}x",
                np.median(found),
                "",
                "lower",
                f"after and before, the median of {len(found)} graphs",
            )
            for drift, found in ratios.items()
        ),
    ]


def _ate_m(poses: NDArray[np.float64], true: NDArray[np.float64]) -> float:
    """Return the root mean square error of places, the first pose being shared."""
    return float(np.sqrt(np.square(poses[:, :3, 3] - true[:, :3, 3]).sum(axis=1).mean()))
