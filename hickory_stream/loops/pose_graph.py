"""The pose graph of a map: its submaps as nodes, odometry between them, and loops."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry import portable
from hickory_stream.geometry.rigid import compose, invert, rotation_angle_rad
from hickory_stream.graph.config import GraphConfig
from hickory_stream.graph.factors import (
    LoopEdge,
    OdometryEdge,
    PoseGraph,
    along_axes_of,
    odometry_covariance,
    registered_covariance,
)
from hickory_stream.graph.record import record_of
from hickory_stream.graph.solution import Solution
from hickory_stream.mapping.entities.submaps import SubmapState
from hickory_stream.records import GraphEdge, Loop, PoseGraphRecord, SurveyedSubmap

# The odometry's certainty of the vertical: visual-inertial ones know it to half a degree.
_GRAVITY_SIGMA_RAD = 0.01
_NO_WAY = 1e-6
# A solution of the graph that moves no submap by more than this, against those around it, is no correction: the map
# resolves no less.
_CORRECT_M = 0.02
_CORRECT_DEG = 0.3


# A submap as a node of the graph.
Node = SubmapState | SurveyedSubmap


def pose_graph(
    submaps: Sequence[Node], loops: Sequence[Loop], stamps_ns: Sequence[int], config: GraphConfig
) -> PoseGraph:
    """Return the graph of submaps (at least one, all with an anchor), without loops that their search rejected.

    `stamps_ns`: begin of the submaps; a loop has its later one's.
    """
    anchors = np.array([submap.anchor for submap in submaps])
    odometry = tuple(
        OdometryEdge(
            before=i,
            after=i + 1,
            before_from_after=compose(invert(anchors[i]), anchors[i + 1]),
            covariance=_edge_covariance(submaps[i], submaps[i + 1], config),
            is_jump=submaps[i + 1].after_jump,
        )
        for i in range(len(submaps) - 1)
    )
    edges = tuple(
        LoopEdge(
            id=i,
            earlier=loop.earlier,
            later=loop.later,
            earlier_from_later=compose(invert(anchors[loop.earlier]), loop.earlier_from_later, anchors[loop.later]),
            covariance=loop.covariance,
            method=loop.method,
            score=loop.score,
            stamp_ns=stamps_ns[loop.later],
        )
        for i, loop in enumerate(loops)
        if loop.reason is None and loop.later < len(submaps)
    )
    return PoseGraph(world_from_node=anchors, odometry=odometry, loops=edges, gravity_sigma_rad=_GRAVITY_SIGMA_RAD)


def _edge_covariance(submap: Node, after: Node, config: GraphConfig) -> NDArray[np.float64]:
    # By registration if that is more certain than the path; what registration did not see counts as by the path.
    anchor = _anchor(after)
    blind = None if submap.blind is None else along_axes_of(anchor, submap.blind)
    jump = {"jump_m": after.jump_m, "jump_rad": after.jump_rad} if after.after_jump else {}
    by_way = odometry_covariance(submap.way_m, submap.turn_rad, config, blind=blind, **jump)
    if submap.registered is None or after.after_jump:
        return by_way
    by_surface = registered_covariance(submap.registered, anchor)
    if submap.unfixed is not None:
        whole = np.maximum([submap.turn_rad] * 3 + [submap.way_m] * 3, _NO_WAY)
        sigmas = np.sqrt(by_way.diagonal() / whole)
        by_surface = by_surface + along_axes_of(anchor, submap.unfixed) * (sigmas[:, None] * sigmas)
    is_surer = by_surface.diagonal()[3:].sum() < by_way.diagonal()[3:].sum()
    return by_surface if is_surer else by_way


def graph_record(
    graph: PoseGraph, solution: Solution, loops: Sequence[Loop], stamps_ns: Sequence[int]
) -> PoseGraphRecord:
    """Return the public record of a solution, with the loops that their search rejected."""
    solved = record_of(graph, solution, range(graph.num_nodes), stamps_ns)
    unbelieved = tuple(
        GraphEdge(
            kind="loop",
            earlier=loop.earlier,
            later=loop.later,
            status="rejected",
            score=loop.score,
            reason=loop.reason,
            residual_m=0.0,
            residual_rad=0.0,
            stamp_ns=stamps_ns[loop.later],
        )
        for loop in loops
        if loop.reason is not None and loop.later < graph.num_nodes
    )
    return PoseGraphRecord(nodes=solved.nodes, edges=(*solved.edges, *unbelieved))


def world_from_submaps(submaps: Sequence[Node], world_from_node: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Return world_from_submap (4, 4) of each submap whose node has a pose of (N, 4, 4)."""
    return [compose(pose, invert(_anchor(submap))) for submap, pose in zip(submaps, world_from_node, strict=True)]


def submap_places(
    submaps: Sequence[Node], world_from_node: NDArray[np.float64], before: Sequence[NDArray[np.float64]]
) -> list[NDArray[np.float64]]:
    """Return world_from_submap (4, 4) of each submap in a solution; one that hardly moves stays where it was `before`.

    What was found about two submaps that both stay is known.
    """
    # A submap that moves against the next one by less than the map resolves gets its very pose: one piece stays one.
    solved = zip(submaps, world_from_submaps(submaps, world_from_node), before, strict=True)
    places = [then if _is_same(now, then, _anchor(submap)) else now for submap, now, then in solved]
    for i in range(len(places) - 2, -1, -1):
        if _is_same(places[i], places[i + 1], _anchor(submaps[i + 1])):
            places[i] = places[i + 1]
    return places


def is_correction(
    submaps: Sequence[Node],
    places: Sequence[NDArray[np.float64]],
    before: Sequence[NDArray[np.float64]],
) -> bool:
    """Return whether places of submaps, relative to the last one's, differ visibly from those before."""
    return not all(
        _is_same(compose(invert(places[-1]), now), compose(invert(before[-1]), then), _anchor(submap))
        for submap, now, then in zip(submaps, places, before, strict=True)
    )


def _is_same(a: NDArray[np.float64], b: NDArray[np.float64], anchor: NDArray[np.float64]) -> bool:
    step = compose(invert(compose(a, anchor)), compose(b, anchor))
    return portable.norm(step[:3, 3]) < _CORRECT_M and rotation_angle_rad(step[:3, :3]) < np.radians(_CORRECT_DEG)


def _anchor(submap: Node) -> NDArray[np.float64]:
    assert submap.anchor is not None, "a node is where the camera was first"
    return submap.anchor
