"""The first messages of an image topic, which are read when a log is opened."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from players.containers import Topic
    from players.images import LogImage

_PROBE_IMAGES = 15
"""The number of images of each topic that are read for frame names, encodings and periods."""


@dataclass(slots=True)
class Probe:
    """The first messages of an image topic: the first image, header stamps and log times."""

    topic: Topic
    first: LogImage | None = None
    stamps_ns: list[int] = field(default_factory=list)
    log_ns: list[int] = field(default_factory=list)
    num_unreadable: int = 0

    @property
    def is_full(self) -> bool:
        """Whether enough images were read."""
        number = self.topic.num_messages
        return len(self.stamps_ns) >= (_PROBE_IMAGES if number is None else min(_PROBE_IMAGES, number))
