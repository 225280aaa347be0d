"""The TF tree of a log: static and moving transforms, and chains of them between two frames."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.rigid import compose, invert
from players.poses.interpolation import PoseTrack
from players.poses.tracks import GrowingTrack

Link = PoseTrack | GrowingTrack | np.ndarray


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Edge:
    """A frame and its parent; `parent_from_child` is (4, 4) if it is static, else a track."""

    parent: str
    child: str
    parent_from_child: Link
    #: False for a transform of /tf that has not changed so far.
    is_published_static: bool = True
    #: Its topic of transforms, without "_static".
    scope: str = "/tf"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Chain:
    """`target_from_source` through `edges`, each with whether it is followed downwards (inverted)."""

    frames: tuple[str, ...]
    edges: tuple[tuple[Edge, bool], ...]

    @property
    def is_static(self) -> bool:
        """Whether no link of the chain moves."""
        return all(isinstance(edge.parent_from_child, np.ndarray) for edge, _ in self.edges)

    def at(self, stamp_ns: int) -> NDArray[np.float64] | None:
        """Return `target_from_source` (4, 4) at a stamp, or None if a link has no pose at that stamp."""
        target_from_source = np.eye(4)
        for edge, is_downwards in self.edges:
            link = edge.parent_from_child
            pose = link if isinstance(link, np.ndarray) else link.at(stamp_ns)
            if pose is None:
                return None
            target_from_source = compose(target_from_source, invert(pose) if is_downwards else pose)
        return target_from_source


class FrameTree:
    """Frames by name; of two parents of a frame, the deeper namespace's, a static one, or the one with more poses."""

    def __init__(self, edges: Sequence[Edge]) -> None:
        #: By child.
        self.edges: Mapping[str, Edge] = {edge.child: edge for edge in sorted(edges, key=_weight)}

    def ancestors(self, frame: str) -> list[str]:
        """Return a frame and all frames above it, upwards; a loop in the tree ends the list."""
        line = [frame]
        while (edge := self.edges.get(line[-1])) is not None and edge.parent not in line:
            line.append(edge.parent)
        return line

    def chain(self, target: str, source: str) -> Chain | None:
        """Return the chain of `target_from_source`, or None if the two are not connected."""
        from_source, from_target = self.ancestors(source), self.ancestors(target)
        common = next((frame for frame in from_source if frame in from_target), None)
        if common is None:
            return None
        up = from_source[: from_source.index(common)]
        down = from_target[: from_target.index(common)]
        edges = [*((self.edges[frame], True) for frame in down), *((self.edges[f], False) for f in reversed(up))]
        return Chain(frames=(*down, common, *reversed(up)), edges=tuple(edges))


def _weight(edge: Edge) -> tuple[int, float, str]:
    link, depth = edge.parent_from_child, edge.scope.count("/")
    if isinstance(link, PoseTrack):
        return depth, float(len(link.stamps_ns)), edge.parent
    return depth, float(link.num_added) if isinstance(link, GrowingTrack) else float("inf"), edge.parent
