"""The map at any moment of its run, from the journal, and changes between two moments.

Moments are stamps of the log (ns), or seconds of the map's own clock: 0 at the first keyframe, continuous through jumps
of the stamps, so that a looped log has unique moments. Of a repeated stamp the last time counts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from hickory_stream.errors import InputError
from hickory_stream.journal.reader import Journal
from hickory_stream.map_folder.history.known_map import known_map
from hickory_stream.map_folder.manifest import read_manifest
from hickory_stream.records import MapSnapshot, PoseGraphRecord, TrackedObject, kind_text

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from hickory_stream.config import MapperConfig

ChangeKind = Literal[
    "appeared", "new", "merged", "dropped", "gone", "moved", "better view", "shape changed", "kind changed"
]

_MOVED_M = 0.05
_NS = "ns"


@dataclass(frozen=True, kw_only=True, slots=True)
class Change:
    """A change of one object between two moments; `text` gives the numbers.

    An object that appeared may have been there all the time, and a dropped one may be part of another;
    `changes.within_run` gives "new" and "gone" with a probability.
    """

    kind: ChangeKind
    object_id: int
    text: str
    probability: float | None = None
    #: The object of the earlier map that moved here.
    was: int | None = None


def as_known_at(path: Path, stamp_ns: int) -> MapSnapshot:
    """Return the core's map at a stamp, empty before the first keyframe; objects are read on first use (`known_map`).

    Raises `MapFolderError`: there is no map or no journal, or it is damaged or of another version; also on first use.
    """
    # It stays open for reads on first use, and is closed with the map.
    journal = Journal(path)
    index = step_at(journal.stamps_ns, stamp_ns)
    if index is None:
        return MapSnapshot(revision=0, stamp_ns=stamp_ns, submaps=(), objects=())
    read_manifest(path)
    return known_map(journal, index, lambda: _config_of(path).mapping)


def seen_by(final: MapSnapshot, stamp_ns: int) -> MapSnapshot:
    """Return the finished map, restricted to objects and views seen by a stamp; shapes and points are final."""
    objects = [_with_views_until(o, stamp_ns) for o in final.objects if o.first_seen_ns <= stamp_ns]
    graph = final.graph
    if graph is not None:
        # No edge is older than its nodes.
        nodes = tuple(node for node in graph.nodes if node.stamp_ns <= stamp_ns)
        graph = PoseGraphRecord(nodes=nodes, edges=tuple(edge for edge in graph.edges if edge.stamp_ns <= stamp_ns))
    return replace(final, stamp_ns=min(final.stamp_ns, stamp_ns), objects=tuple(objects), graph=graph)


def changes(before: MapSnapshot, after: MapSnapshot) -> tuple[Change, ...]:
    """Return the changes of objects between two maps, by id."""
    old = {o.id: o for o in before.objects}
    new = {o.id: o for o in after.objects}
    became = {gone: o.id for o in after.objects for gone in o.merged_ids}
    found: list[Change] = []
    for object_id in sorted(old.keys() | new.keys()):
        a, b = old.get(object_id), new.get(object_id)
        if a is None and b is not None:
            found.append(
                Change(kind="appeared", object_id=object_id, text=f"at {_place(b)}, {kind_text(b.fixture_probability)}")
            )
        elif a is not None and b is None and object_id in became:
            found.append(Change(kind="merged", object_id=object_id, text=f"is now a part of #{became[object_id]}"))
        elif a is not None and b is None:
            found.append(Change(kind="dropped", object_id=object_id, text="was found to be no object"))
        elif a is not None and b is not None:
            found += _changes_of(a, b)
    return tuple(found)


def stamp_of(path: Path, text: str) -> int:
    """Return the stamp of a text: seconds of the map's own clock ("12.5"), or a stamp ("17...ns").

    Raises `InputError`: it is neither, or outside of the run; `MapFolderError`: there is no journal.
    """
    with Journal(path) as journal:
        stamps_ns = journal.stamps_ns
    if len(stamps_ns) == 0:
        raise InputError(f"{path} knows nothing yet: its run ended before the first keyframe")
    clock_s = own_clock_s(stamps_ns, _config_of(path).run.time_jump_s)
    expected = f"seconds from 0 to {clock_s[-1]:.3f}, or a stamp with {_NS}, up to {stamps_ns.max()}{_NS}"
    try:
        value = int(text.removesuffix(_NS)) if text.endswith(_NS) else float(text)
    except ValueError as error:
        raise InputError(f"found the time {text}, expected {expected}") from error
    if text.endswith(_NS):
        if not stamps_ns.min() <= value <= stamps_ns.max():
            raise InputError(f"found the time {text}, expected {expected}")
        return int(value)
    if not 0 <= value <= clock_s[-1] + 0.0005:
        raise InputError(f"found the time {text}, expected {expected}")
    return int(stamps_ns[int(np.searchsorted(clock_s, value + 0.0005, side="right")) - 1])


def _config_of(path: Path) -> MapperConfig:
    # Imported on use: the configuration imports perception and shapes, which takes longer than the read.
    from hickory_stream.map_folder.history.recorded_config import recorded_config

    return recorded_config(path)


def own_clock_s(stamps_ns: NDArray[np.int64], time_jump_s: float) -> NDArray[np.float64]:
    """Return the seconds of the map's own clock at every step: jumps of the stamps take no time."""
    gaps_ns = np.diff(stamps_ns, prepend=stamps_ns[:1])
    gaps_ns[(gaps_ns < 0) | (gaps_ns > time_jump_s * 1e9)] = 0
    return np.cumsum(gaps_ns) / 1e9


def step_at(stamps_ns: NDArray[np.int64], stamp_ns: int) -> int | None:
    """Return the last step up to a stamp, in the last round in which the stamp occurs."""
    at = np.flatnonzero(stamps_ns <= stamp_ns)
    if len(at) == 0:
        return None
    if stamp_ns >= stamps_ns.max():
        return len(stamps_ns) - 1
    later = np.flatnonzero((stamps_ns[:-1] <= stamp_ns) & (stamps_ns[1:] > stamp_ns))
    return int(later[-1]) if len(later) else int(at[-1])


def _with_views_until(tracked: TrackedObject, stamp_ns: int) -> TrackedObject:
    views = tuple(view for view in tracked.views if view.stamp_ns <= stamp_ns)
    best = tracked.best_view if tracked.best_view in views else None
    return replace(
        tracked,
        views=views,
        best_view=best,
        last_seen_ns=max(tracked.first_seen_ns, min(tracked.last_seen_ns, stamp_ns)),
    )


def _changes_of(a: TrackedObject, b: TrackedObject) -> list[Change]:
    found: list[Change] = []
    moved_m = float(np.linalg.norm(b.box.center - a.box.center))
    if moved_m > _MOVED_M:
        found.append(Change(kind="moved", object_id=b.id, text=f"by {moved_m:.2f} m, to {_place(b)}"))
    best_a, best_b = a.best_view, b.best_view
    if best_b is not None and (best_a is None or best_a.name != best_b.name):
        scores = f"{_score(best_a.score) if best_a else 'none'} -> {_score(best_b.score)}"
        found.append(Change(kind="better view", object_id=b.id, text=f"frame {best_b.frame_index}, score {scores}"))
    if b.shape is not None and (a.shape is None or a.shape.mesh_sha256 != b.shape.mesh_sha256):
        count = f"{len(a.shape.fitted)}" if a.shape is not None else "none"
        text = f"superquadrics {count} -> {len(b.shape.fitted)}"
        found.append(Change(kind="shape changed", object_id=b.id, text=text))
    if a.kind is not b.kind:
        text = f"{kind_text(a.fixture_probability)} -> {kind_text(b.fixture_probability)}"
        found.append(Change(kind="kind changed", object_id=b.id, text=text))
    return found


def _score(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.3f}"


def _place(tracked: TrackedObject) -> str:
    x, y, z = tracked.box.center
    return f"({x:.2f}, {y:.2f}, {z:.2f}) m"
