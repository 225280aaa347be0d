"""Loops in a run: searches on frozen snapshots beside mapping, answers by due stamp, and the graph's solution.

A playback commits an answer at the first keyframe at or after its due stamp, and waits for a late one; a live run
commits it on arrival. The graph is solved again for each loop, from records of the core, so a resumed run needs no
more.
"""

import asyncio
import logging
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from hickory_stream.engine.modes import Mode
from hickory_stream.events import LoopsSearched, PosesCorrected, SearchLoops
from hickory_stream.graph.config import GraphConfig
from hickory_stream.graph.solution import NoSolution
from hickory_stream.loops.config import MIN_AGREEING_POINTS, LoopConfig
from hickory_stream.loops.pose_graph import graph_record, is_correction, pose_graph, submap_places
from hickory_stream.loops.predictions import predictions
from hickory_stream.loops.surfaces import Surfaces
from hickory_stream.mapping.core import MapperCore
from hickory_stream.records import Loop

logger = logging.getLogger(__name__)
# A submap is not searched in those before it that are fewer than this away.
MIN_SUBMAPS_APART = 2


class LoopCloser:
    """Open searches by submap; one runs at a time."""

    def __init__(self, loops: LoopConfig, graph: GraphConfig, *, extractor: str, mode: Mode) -> None:
        self._loops = loops
        self._graph = graph
        self._extractor = extractor
        self._mode = mode
        self._open: dict[int, tuple[SearchLoops, asyncio.Future[tuple[Loop, ...]]]] = {}
        self._thread = ThreadPoolExecutor(1, "loops")

    def request(self, search: SearchLoops) -> None:
        """Queue a search."""
        answer = asyncio.get_running_loop().run_in_executor(self._thread, self._found, search)
        self._open[search.submap_id] = search, answer

    def restart(self, searches: Iterable[SearchLoops]) -> None:
        """Replace all searches by those that a restored core waits for."""
        for _, answer in self._open.values():
            answer.cancel()
        self._open.clear()
        for search in searches:
            self.request(search)

    async def next_due(self, stamp_ns: int | None) -> LoopsSearched | None:
        """Return the next answer that is due at a stamp (None: any), waiting for it; None if none is."""
        due = [
            (search.due_ns, submap_id)
            for submap_id, (search, answer) in self._open.items()
            if stamp_ns is None or (answer.done() if self._mode == "live" else search.due_ns <= stamp_ns)
        ]
        if not due:
            return None
        due_ns, submap_id = min(due)
        loops = await self._open[submap_id][1]
        del self._open[submap_id]
        return LoopsSearched(submap_id=submap_id, stamp_ns=due_ns if stamp_ns is None else stamp_ns, loops=loops)

    def correction(self, core: MapperCore, stamp_ns: int) -> PosesCorrected | None:
        """Return the pose graph, and the poses of submaps that it moves; None without a loop."""
        from hickory_stream.graph.solve import solve

        submaps = [submap for submap in core.submaps if submap.anchor is not None]
        if len(submaps) < 2 or not core.loops:
            return None
        began_ns = [submap.began_ns or 0 for submap in submaps]
        graph = pose_graph(submaps, core.loops, began_ns, self._graph)
        solution = solve(graph, self._graph, accepted_before=_accepted(core))
        if isinstance(solution, NoSolution):
            logger.warning("loops are left out: %s", solution.reason)
            return None
        record = graph_record(graph, solution, core.loops, began_ns)
        before = [submap.world_from_submap for submap in submaps]
        places = submap_places(submaps, solution.world_from_node, before)
        if not is_correction(submaps, places, before):
            return PosesCorrected(stamp_ns=stamp_ns, submap_ids=(), world_from_submap=np.empty((0, 4, 4)), graph=record)
        # A submap that was opened and has no keyframe yet goes on from the last one.
        ids = [submap.id for submap in core.submaps]
        places += [places[-1]] * (len(ids) - len(places))
        moved = np.array(places)
        return PosesCorrected(stamp_ns=stamp_ns, submap_ids=tuple(ids), world_from_submap=moved, graph=record)

    def close(self) -> None:
        """Wait for the running search, and drop the others."""
        for _, answer in self._open.values():
            answer.cancel()
        self._thread.shutdown(wait=True, cancel_futures=True)

    def _found(self, search: SearchLoops) -> tuple[Loop, ...]:
        submaps = search.submaps
        later_id = submaps[-1].id
        if later_id < MIN_SUBMAPS_APART or len(submaps[-1].points) < MIN_AGREEING_POINTS:
            return ()
        predicted = predictions(submaps, search.loops, self._graph, least_apart=MIN_SUBMAPS_APART)
        if isinstance(predicted, NoSolution):
            logger.warning("loops of submap %d are not searched: %s", later_id, predicted.reason)
            return ()
        # Imports all of alignment, which a run without loops does not need.
        from hickory_stream.loops.search import LoopQuery, search_loops

        query = LoopQuery(
            later_id=later_id,
            surfaces=Surfaces(submaps),
            predicted=predicted,
            keypoints={submap.id: submap.keypoints for submap in submaps},
            snapshot=search.snapshot,
            extractor=self._extractor,
        )
        return search_loops(query, self._loops)


def _accepted(core: MapperCore) -> list[int]:
    # Every loop that any solution so far has believed.
    edges = () if core.graph is None else core.graph.loops
    believed = {(edge.earlier, edge.later) for edge in edges if edge.status in ("accepted", "withdrawn")}
    return [i for i, loop in enumerate(core.loops) if (loop.earlier, loop.later) in believed]
