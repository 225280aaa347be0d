"""The pose graph of a map in numbers, and in one line."""

from dataclasses import dataclass

import numpy as np

from hickory_stream.records import GraphEdge, PoseGraphRecord


@dataclass(frozen=True, kw_only=True, slots=True)
class GraphSummary:
    """Counts of submaps and loops of a pose graph, and the loops."""

    num_submaps: int
    num_accepted: int
    num_rejected: int
    num_withdrawn: int
    #: largest displacement of a submap by the solution
    moved_m: float
    #: largest standard deviation of a position, relative to the first submap
    sigma_m: float
    loops: tuple[GraphEdge, ...]


def summary_of(graph: PoseGraphRecord) -> GraphSummary:
    """Return the numbers of a pose graph."""
    statuses = [loop.status for loop in graph.loops]
    moves_m = [float(np.linalg.norm(node.place[:3, 3] - node.uncorrected[:3, 3])) for node in graph.nodes]
    return GraphSummary(
        num_submaps=len(graph.nodes),
        num_accepted=statuses.count("accepted"),
        num_rejected=statuses.count("rejected"),
        num_withdrawn=statuses.count("withdrawn"),
        moved_m=max(moves_m, default=0.0),
        sigma_m=max((node.sigma_m for node in graph.nodes), default=0.0),
        loops=graph.loops,
    )


def summary_text(summary: GraphSummary) -> str:
    """Return a pose graph as a line for people."""
    counts = {"accepted": summary.num_accepted, "rejected": summary.num_rejected, "withdrawn": summary.num_withdrawn}
    said = ", ".join(f"{count} {status}" for status, count in counts.items() if count)
    submaps, loops = summary.num_submaps, len(summary.loops)
    return (
        f"pose graph: {submaps} submap{'s' * (submaps != 1)}, {loops} loop{'s' * (loops != 1)}"
        f"{f' ({said})' if said else ''}; submaps moved by up to {summary.moved_m:.2f} m, places are known within "
        f"{summary.sigma_m:.2f} m (1 sigma)"
    )
