"""The beginning of a source: its first frames only, for a quick look."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from hickory_stream.ports import Source
    from hickory_stream.records import RawFrame, SourceInfo


class FirstFrames:
    """A source that ends after `count` frames of another one."""

    def __init__(self, source: Source, count: int) -> None:
        if count < 1:
            raise ValueError(f"the first {count} frames")
        self._source = source
        self._count = count

    @property
    def info(self) -> SourceInfo:
        """What the other source found, with fewer frames."""
        info = self._source.info
        known = info.num_frames if info.num_frames is not None else self._count
        return replace(info, num_frames=min(known, self._count))

    def frames(self) -> Iterator[RawFrame]:
        """Yield the first frames."""
        return islice(self._source.frames(), self._count)

    def ledger(self) -> Mapping[str, int]:
        """Return what the other source counted so far."""
        return self._source.ledger()

    def account(self) -> Any:
        """Return where the messages went, where the other source keeps account of them."""
        account = getattr(self._source, "account", None)
        return account() if account is not None else None

    def interrupt(self) -> None:
        """Wake the other source, where it may be waiting."""
        interrupt = getattr(self._source, "interrupt", None)
        if interrupt is not None:
            interrupt()

    def close(self) -> None:
        """Close the other source."""
        self._source.close()
