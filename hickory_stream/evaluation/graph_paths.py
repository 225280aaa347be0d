"""The way of the camera before and after the pose graph moved the submaps, as a map folder has it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.graph.ways import ways_of

if TYPE_CHECKING:
    from hickory_stream.graph.ways import Ways
    from hickory_stream.map_folder.saved_map import SavedMap


def recorded_ways(saved: SavedMap) -> Ways | None:
    """Return the ways of the camera of a map, from its journal; None where it has no graph.

    Of a map without a journal, e.g. a merged one, only the places of the submaps are known.
    """
    from hickory_stream.journal.format import JOURNAL
    from hickory_stream.journal.reader import Journal

    graph = saved.snapshot.graph
    if graph is None or not graph.nodes:
        return None
    stamps_ns = [node.stamp_ns for node in graph.nodes]
    places = [node.uncorrected[:3, 3] for node in graph.nodes]
    if (saved.folder / JOURNAL).exists():
        with Journal(saved.folder) as journal:
            frames = [frame for i in range(len(journal)) for frame in journal.step(i).frames]
        known = [frame for frame in frames if frame.stamp_ns <= saved.snapshot.stamp_ns]
        if known:
            stamps_ns = [frame.stamp_ns for frame in known]
            places = [frame.world_from_camera[:3, 3] for frame in known]
    return ways_of(graph, stamps_ns, np.array(places))
