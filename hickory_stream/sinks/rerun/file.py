"""The .rrd file, written in the caller's thread until it reaches its cap or the disk fails."""

import logging
from pathlib import Path
from typing import Any

from hickory_stream.errors import OutputError, ViewerError
from hickory_stream.sinks.rerun.items import LogItem, Moment, Weight, emit, new_stream
from hickory_stream.sinks.rerun.piped_file import PipedFile

# Fewer and larger pieces than the SDK would write: each costs about a kilobyte beside what is in it.
_BATCH_S = 1.0
# From this share of the cap on, images are those of keyframes.
_SPARING = 0.5

logger = logging.getLogger(__name__)


class RrdFile:
    """Writes items to a file; beyond `cap_mb` only light ones, so that plots and decisions stay complete."""

    def __init__(self, path: Path, *, recording_id: str, cap_mb: float) -> None:
        self._path = path
        self._cap_mb = cap_mb
        self._is_full = False
        self._is_lost = False
        self._stream = new_stream(recording_id, batch_s=_BATCH_S)
        try:
            self._piped = PipedFile(path, self._stream)
        except OSError as error:
            raise ViewerError(f"{path} cannot be written ({error}); name a file in an existing folder") from error

    def send_blueprint(self, blueprint: Any) -> None:
        """Store a layout; the viewer shows the last one."""
        self._stream.send_blueprint(blueprint, make_active=True, make_default=True)

    def write(self, moment: Moment, items: list[LogItem]) -> None:
        """Write the items, only light ones beyond the cap; a disk error removes the file, raises `OutputError`."""
        if self._piped.error is not None:
            self.close()
        num_bytes, cap_bytes = self._num_bytes(), self._cap_mb * 1e6
        if not self._is_full and num_bytes >= cap_bytes:
            self._is_full = True
            logger.warning(
                "%s has reached its cap of %g MB: images, clouds and meshes are left out from frame %d on",
                self._path,
                self._cap_mb,
                moment.frame,
            )
        # Colour between keyframes is most of a recording, and what is missed least.
        is_spare = self._is_full or (moment.keyframe is None and num_bytes >= _SPARING * cap_bytes)
        emit(self._stream, moment, (i for i in items if i.weight is Weight.LIGHT or not is_spare))

    def close(self) -> None:
        """Write the buffer and the footer; raises `OutputError` on a disk error, once, and removes the file."""
        if self._is_lost:
            return
        try:
            self._piped.close()
        except OSError as error:
            self._is_lost = True
            cause = error.strerror or type(error).__name__
            removed = "" if self._path.exists() else " and was removed"
            raise OutputError(
                f"the recording {self._path} could not be written to its end ({cause}){removed}; "
                "`hickory-stream replay MAP --rrd FILE` makes it from the map"
            ) from error

    def _num_bytes(self) -> int:
        return self._piped.num_bytes or (self._path.stat().st_size if self._path.is_file() else 0)
