"""The .rrd file: written in the caller's thread, complete, until it reaches its cap."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any

from hickory_stream.errors import ViewerError
from hickory_stream.sinks.rerun_items import LogItem, Moment, Weight, emit, new_stream

if TYPE_CHECKING:
    from pathlib import Path

# Fewer and larger pieces than the SDK would write: each costs about a kilobyte beside what is in it.
_BATCH_S = 1.0

logger = logging.getLogger(__name__)


class RrdFile:
    """Writes items to a file; from `cap_mb` on the light ones only, so that the plots and decisions stay complete."""

    def __init__(self, path: Path, *, recording_id: str, cap_mb: float) -> None:
        self._path = path
        self._cap_mb = cap_mb
        self._is_full = False
        try:
            path.open("wb").close()
        except OSError as error:
            raise ViewerError(f"{path} cannot be written ({error}); name a file in an existing folder") from error
        self._stream = new_stream(recording_id, batch_s=_BATCH_S)
        self._stream.save(path)

    def send_blueprint(self, blueprint: Any) -> None:
        """Store an arrangement; the last one that was stored is shown."""
        self._stream.send_blueprint(blueprint, make_active=True, make_default=True)

    def write(self, moment: Moment, items: list[LogItem]) -> None:
        """Write the items, without the heavy ones once the cap was reached."""
        if not self._is_full and self._path.stat().st_size >= self._cap_mb * 1e6:
            self._is_full = True
            logger.warning(
                "%s has reached its cap of %g MB: images, clouds and meshes are left out from frame %d on",
                self._path,
                self._cap_mb,
                moment.frame,
            )
        emit(self._stream, moment, (i for i in items if i.weight is Weight.LIGHT or not self._is_full))

    def close(self) -> None:
        """Write what is buffered, and the footer."""
        self._stream.disconnect()
