"""The first frames of a source, for a quick look."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

from hickory_stream.ports import Source, SourceAround
from hickory_stream.records import RawFrame, SourceInfo


class FirstFrames(SourceAround):
    """A source that ends after `count` frames of another one."""

    def __init__(self, source: Source, count: int) -> None:
        if count < 1:
            raise ValueError(f"the first {count} frames")
        super().__init__(source)
        self._count = count

    @property
    def info(self) -> SourceInfo:
        """The info of the other source, with fewer frames."""
        info = self._source.info
        known = info.num_frames if info.num_frames is not None else self._count
        return replace(info, num_frames=min(known, self._count))

    def frames(self) -> Iterator[RawFrame]:
        """Yield the first frames."""
        return islice(self._source.frames(), self._count)
