"""The pose graph's solver on simulated graphs with known truth, and on public ones: time, loops, drift removed."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.rigid import from_rotation_translation, invert, rotation_from_quaternion, yaw_rotation
from hickory_stream.graph.config import GraphConfig
from hickory_stream.graph.factors import LoopEdge, OdometryEdge, PoseGraph, symmetric
from hickory_stream.graph.solution import Solution
from hickory_stream.graph.solve import solve
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.evaluation.simulated_maps.simulated_graphs import simulated_graph

_NODES, _LOOPS, _WRONG = 300, 40, 4
_DRIFTS = (1.0, 3.0)
# As a share of the loops of a public graph, and at most: loops are added between nodes that they do not join.
_WRONG_SHARE, _MOST_WRONG = 0.1, 20
# Of what a planar graph leaves out: an information, and a sigma of the vertical; and the sigma where none is known.
_PLANAR, _PLANAR_RAD, _NO_VERTICAL_RAD = 1e6, 1e-3, 1e3


def graph_figures(options: Options) -> list[Figure]:
    """Return the figures of 20 seeded graphs at the drift that worlds have by default, and at three times it."""
    config, num_seeds = GraphConfig(), 3 if options.quick else 20
    ms, wrong_accepted, true_accepted, figures = [], 0, 0, []
    for drift in _DRIFTS:
        ratios = []
        for seed in range(num_seeds):
            rng = np.random.default_rng((options.seed, seed))
            walk = simulated_graph(rng, config, num_nodes=_NODES, num_loops=_LOOPS, num_wrong=_WRONG, drift=drift)
            started = time.process_time()
            answer = solve(walk.graph, config)
            ms.append(1000 * (time.process_time() - started))
            if isinstance(answer, Solution):
                wrong_accepted += len(set(answer.accepted) & walk.wrong)
                true_accepted += len(set(answer.accepted) - walk.wrong)
                before, after = (_ate_m(p, walk.true) for p in (walk.graph.world_from_node, answer.world_from_node))
                ratios.append(after / before)
        of = f"after and before, the median of {len(ratios)} graphs"
        figures.append(figure(f"graph_ate_ratio_{drift:.0f}x", np.median(ratios), "", "lower", of))
    num_wrong, num_true = len(ms) * _WRONG, len(ms) * (_LOOPS - _WRONG)
    rejected = num_wrong - wrong_accepted
    of = f"processor time, the median of {len(ms)} graphs of {_NODES} nodes and {_LOOPS} loops"
    return [
        # The first solve loads the library and the compiled kernels.
        figure("solve_ms", np.median(ms[1:]), "ms", "lower", of),
        figure("wrong_loops_rejected", rejected / num_wrong, "", "higher", f"{rejected} of {num_wrong}"),
        figure("true_loops_accepted", true_accepted / num_true, "", "higher", f"{true_accepted} of {num_true}"),
        *figures,
    ]


def public_figures(folder: Path, options: Options) -> list[Figure]:
    """Return the figures of graphs in g2o's format, with wrong loops among theirs; a quick run has the small ones."""
    # Their odometry drifts by itself, and there is no truth: errors are against the solution with their own loops.
    figures = []
    for file in sorted(folder.glob("*.g2o")):
        if options.quick and file.stat().st_size > 200_000:
            continue
        graph, name = read_g2o(file), file.stem.replace("-", "_").lower()
        own, rng, num = solve(graph), np.random.default_rng(options.seed), len(graph.loops)
        wrong = [replace(graph.loops[k], id=num + i, **dict(zip(("earlier", "later"), ends, strict=True)))
                 for i, k in enumerate(rng.integers(0, num, max(min(round(_WRONG_SHARE * num), _MOST_WRONG), 1)))
                 for ends in [np.sort(rng.choice(graph.num_nodes, 2, replace=False)).tolist()]]  # fmt: skip
        started = time.process_time()
        answer = solve(replace(graph, loops=(*graph.loops, *wrong)))
        seconds = time.process_time() - started
        if not isinstance(own, Solution) or not isinstance(answer, Solution):
            continue
        before, after = (
            _ate_m(poses, own.world_from_node) for poses in (graph.world_from_node, answer.world_from_node)
        )
        believed, of = set(answer.accepted), f"{graph.num_nodes} nodes"
        num_true, num_wrong = len(believed & set(own.accepted)), sum(loop.id in believed for loop in wrong)
        figures += [
            figure(f"g2o_{name}_ate_ratio", after / before, "", "lower", f"{of}; by odometry {before:.2f} m"),
            figure(f"g2o_{name}_loops", len(own.accepted) / num, "", "higher", f"{num} loops, none wrong, of {of}"),
            figure(
                f"g2o_{name}_kept", num_true / len(own.accepted), "", "higher", f"of them, beside {len(wrong)} wrong"
            ),
            figure(f"g2o_{name}_wrong", num_wrong, "", "lower", f"believed, of {len(wrong)}"),
            figure(f"g2o_{name}_s", seconds, "s", "lower", "processor time"),
        ]
    return figures


def read_g2o(file: Path) -> PoseGraph:
    """Return a graph of EDGE_SE2 or EDGE_SE3:QUAT: edges from a node to the next are odometry, the others loops."""
    odometry, loops, is_planar = dict[int, OdometryEdge](), list[LoopEdge](), False
    for kind, *words in filter(None, map(str.split, file.read_text().splitlines())):
        if not kind.startswith("EDGE"):
            continue
        first, second = map(int, words[:2])
        values, is_planar = np.array(words[2:], dtype=np.float64), kind == "EDGE_SE2"
        # The format has translations first, as a triangle.
        order, num = ([3, 4, 2], 3) if is_planar else ([3, 4, 5, 0, 1, 2], 7)
        own = np.zeros((len(order), len(order)))
        own[np.triu_indices(len(order))] = values[num:]
        information = _PLANAR * np.eye(6)
        information[np.ix_(order, order)] = own + np.triu(own, 1).T
        rotation = yaw_rotation(values[2]) if is_planar else rotation_from_quaternion(*values[3:7])
        step = from_rotation_translation(rotation, np.array([*values[:2], 0.0]) if is_planar else values[:3])
        before, after = min(first, second), max(first, second)
        transform, covariance = step if first < second else invert(step), symmetric(np.linalg.inv(information))
        if after == before + 1 and after not in odometry:
            odometry[after] = OdometryEdge(
                before=before, after=after, before_from_after=transform, covariance=covariance
            )
        else:
            loops.append(LoopEdge(
                id=len(loops), earlier=before, later=after, earlier_from_later=transform, covariance=covariance,
                method="surface", score=1.0, stamp_ns=0,
            ))  # fmt: skip
    poses = [np.eye(4)]
    for after in sorted(odometry):
        poses.append(poses[-1] @ odometry[after].before_from_after)
    return PoseGraph(
        world_from_node=np.array(poses), odometry=tuple(odometry[after] for after in sorted(odometry)),
        loops=tuple(loops), gravity_sigma_rad=_PLANAR_RAD if is_planar else _NO_VERTICAL_RAD,
    )  # fmt: skip


def _ate_m(poses: NDArray[np.float64], true: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.square(poses[:, :3, 3] - true[:, :3, 3]).sum(axis=1).mean()))
