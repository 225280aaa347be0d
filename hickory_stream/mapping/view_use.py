"""Which views are in use: counted by name, and followed from the tracks that have changed."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

from hickory_stream.mapping.joins import views_in

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping

    from hickory_stream.mapping.absorbed import Absorbed
    from hickory_stream.mapping.joins import Join, Joins
    from hickory_stream.mapping.track import Track
    from hickory_stream.mapping.track_table import Mark, TrackTable


class ViewUse:
    """By how many tracks each view is held: those of the map, and those that a split or a parting could restore."""

    def __init__(self) -> None:
        self._marks: tuple[Mark, Mark] | None = None
        self._held: dict[int, tuple[str, ...]] = {}
        self._absorbed: dict[int, tuple[Track, ...]] = {}
        self._joins: dict[int, tuple[Join, ...]] = {}
        self._num_holders: Counter[str] = Counter()
        self._freed: set[str] = set()

    def ask_for(self, name: str) -> None:
        """Ask at the next count whether a view is held, though no track that held it is known to have let it go.

        A better view may have taken its place before the views were counted.
        """
        self._freed.add(name)

    def unused(
        self, tracks: TrackTable, elsewhere: TrackTable, absorbed: Absorbed, joins: Joins, kept: Collection[str]
    ) -> list[str]:
        """Return the names of the `kept` views that nothing refers to any more, ascending."""
        tables = (tracks, elsewhere)
        marks = self._marks
        if marks is None or any(mark.table is not table for mark, table in zip(marks, tables, strict=True)):
            marks = None
            self._held, self._absorbed, self._joins, self._num_holders = {}, {}, {}, Counter()
            self._freed = set(kept)
        for table, mark in zip(tables, marks or (None, None), strict=True):
            for track_id in table.changed_since(mark):
                # A track that is in neither table is gone; one may have come from the other.
                track = tracks.get(track_id) or elsewhere.get(track_id)
                self._hold(track_id, () if track is None else track.names_of_views)
        self._marks = (tracks.now, elsewhere.now)
        self._follow(self._absorbed, absorbed, _names)
        self._follow(self._joins, joins, views_in)
        self._absorbed, self._joins = dict(absorbed), dict(joins)
        unused = sorted(name for name in self._freed if not self._num_holders[name] and name in kept)
        self._freed = set()
        return unused

    def _hold(self, track_id: int, names: tuple[str, ...]) -> None:
        before = self._held.pop(track_id, ())
        if names:
            self._held[track_id] = names
        self._count(before, names)

    def _follow(self, known: Mapping[int, Any], now: Mapping[int, Any], names: Callable[[Any], Iterable[str]]) -> None:
        """Count the views that hosts hold for others, where these have changed."""
        changed = [host for host, held in now.items() if known.get(host) is not held]
        changed += [host for host in known if host not in now]
        for host in changed:
            self._count(names(known.get(host, ())), names(now.get(host, ())))

    def _count(self, before: Iterable[str], now: Iterable[str]) -> None:
        self._num_holders.update(now)
        for name in before:
            self._num_holders[name] -= 1
            if not self._num_holders[name]:
                del self._num_holders[name]
                self._freed.add(name)


def _names(tracks: Iterable[Track]) -> list[str]:
    return [name for track in tracks for name in track.names_of_views]
