"""Where the maps of a batch overlap, and one map of those that do."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.alignment.answer import Alignment
from hickory_stream.batch.place_signature import candidate_pairs, place_signatures
from hickory_stream.batch.result import Joined, MergedMap, Overlap
from hickory_stream.fleet.finish import finish

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from pathlib import Path

    from hickory_stream.alignment.object_map import ObjectMap

MERGED = "merged"
"""What the merged maps of a batch are called."""


def join_maps(folders: Mapping[str, Path], out: Path, tell: Callable[[str], None]) -> Joined:
    """Align those of the maps that may overlap, and merge those that do into OUT/merged.map, merged-2.map, ...

    Raises:
        MapFolderError: a merged map cannot be written.
    """
    sizes: list[float] = []

    def choose(maps: Sequence[ObjectMap]) -> Iterable[tuple[int, int]]:
        signatures = place_signatures(maps)
        sizes.extend(one.num_bytes / 1e3 for one in signatures)
        return candidate_pairs(signatures)

    finished = finish(folders, out, overwrite=True, tell=tell, choose=choose, name=MERGED)
    believed = {pair for frame in finished.frames for pair in frame.pairs}
    overlaps = tuple(
        Overlap(
            a=pair[0],
            b=pair[1],
            is_believed=pair in believed,
            num_pairs=len(answer.pairs) if isinstance(answer, Alignment) else 0,
            told="" if isinstance(answer, Alignment) else f"{answer.refusal.value}: {answer.reason}",
        )
        for pair, answer in finished.answers.items()
    )
    count = len(finished.maps)
    return Joined(
        num_pairs=count * (count - 1) // 2,
        overlaps=overlaps,
        merged=tuple(
            MergedMap(
                path=one.path,
                names=one.names,
                digest=one.digest,
                num_objects=one.num_objects,
                num_united=one.num_united,
            )
            for one in finished.merged
        ),
        signature_kb=float(np.mean(sizes)) if sizes else 0.0,
        problems=tuple(f"{name}: {why}" for name, why in finished.problems.items()),
    )
