"""A solved pose graph as the map has it: three rounds with drift, true loops, and wrong ones of each kind."""

from functools import cache
import numpy as np
from hickory_stream.graph.config import GraphConfig
from hickory_stream.graph.record import record_of
from hickory_stream.graph.solution import Solution
from hickory_stream.graph.solve import solve
from tools.evaluation.simulated_maps.simulated_graphs import simulated_graph

START_NS = 1_700_000_000_000_000_000


@cache
def walk():
    return simulated_graph(
        np.random.default_rng(8), GraphConfig(), num_nodes=60, num_loops=9, num_wrong=3, start_ns=START_NS
    )


@cache
def solved_graph():
    graph = walk().graph
    answer = solve(graph, accepted_before=[min(walk().wrong)])
    assert isinstance(answer, Solution)
    stamps_ns = [START_NS + 5_000_000_000 * i for i in range(graph.num_nodes)]
    return record_of(graph, answer, range(graph.num_nodes), stamps_ns)
