"""The path of the camera before and after the pose graph moved the submaps."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.arrays import freeze_all
from hickory_stream.geometry.rigid import apply, compose, invert
from hickory_stream.records import PoseGraphRecord


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Ways:
    """Camera places: `before` (N, 3) by odometry, `after` (N, 3) by the solution of the graph."""

    before: NDArray[np.float64]
    after: NDArray[np.float64]

    def __post_init__(self) -> None:
        freeze_all(self, np.float64, before=(None, 3), after=(len(self.before), 3))


def ways_of(graph: PoseGraphRecord, stamps_ns: Sequence[int], places_m: NDArray[np.float64]) -> Ways:
    """Return the paths of the camera from its places (N, 3) by odometry; each moves with its (last opened) submap."""
    opened = np.array([node.stamp_ns for node in graph.nodes])
    owners = np.maximum(np.searchsorted(opened, np.asarray(stamps_ns), side="right") - 1, 0)
    after = np.empty_like(places_m)
    for i, node in enumerate(graph.nodes):
        is_own = owners == i
        after[is_own] = apply(compose(node.place, invert(node.uncorrected)), places_m[is_own])
    return Ways(before=places_m, after=after)
