"""Shows a run in Rerun: live in a viewer, in a .rrd file, or both.

`show` writes the file's stream, a thread the viewer's; both have one recording id. Rerun is imported when a sink is
made, so that the command line starts without it.
"""

from __future__ import annotations

import itertools
import time
import uuid
from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.geometry.camera import backproject
from hickory_stream.geometry.rigid import apply
from hickory_stream.sinks.rerun.viewer import ViewerChoice, ViewerKind, parse_viewer, start_viewer

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from hickory_stream.records import Frame, FrameReport
    from hickory_stream.sinks.rerun.config import RerunConfig
    from hickory_stream.sinks.rerun.items import LogItem, Moment

__all__ = ["RerunSink", "ViewerChoice", "ViewerKind", "parse_viewer"]

_CLOSE_TIMEOUT_S = 2.0
_STATUS_EVERY_S = 1.0


class RerunSink:
    """A `Sink` for Rerun; raises `ViewerError` if the file or the viewer is not available.

    `folder` is the map folder with meshes and views. `status` returns the lines about a live route, once a second.
    """

    def __init__(
        self,
        config: RerunConfig,
        folder: Path,
        rrd: Path | None,
        viewer: ViewerChoice,
        status: Callable[[], str] | None = None,
    ) -> None:
        from hickory_stream.sinks.rerun.scene import RerunScene

        self._config = config
        self._status = status
        self._told_s = -np.inf
        self._scene = RerunScene(config, folder)
        self._recording_id = str(uuid.uuid4())
        self._file: Any = None
        self._feed: Any = None
        self._last: Moment | None = None
        self._viewer = start_viewer(viewer, bind=config.bind, server_memory_limit=config.server_memory_limit)
        if rrd is not None:
            from hickory_stream.sinks.rerun.file import RrdFile

            self._file = RrdFile(rrd, recording_id=self._recording_id, cap_mb=config.rrd_cap_mb)

    @property
    def web_url(self) -> str | None:
        """Address of the page of a web viewer."""
        return None if self._viewer is None else self._viewer.web_url

    @property
    def dropped(self) -> Mapping[str, int]:
        """Number of entries that the live viewer missed, by weight (`heavy`, `light`)."""
        return {"heavy": 0, "light": 0} if self._feed is None else dict(self._feed.dropped)

    def show(self, report: FrameReport) -> None:
        """Log one report; never waits for a viewer."""
        from hickory_stream.sinks.rerun.items import moment_of

        if self._file is None and self._viewer is None:
            return
        if self._last is None:
            self._begin(report)
        self._last = moment_of(report)
        self._log(self._last, [*self._scene.items(report), *self._robot_items()])

    def close(self) -> None:
        """Finish the file and the viewer's queue; a window stays open, a web server of this run ends."""
        if self._last is not None:
            self._log(self._last, self._scene.finish())
        if self._file is not None:
            if len(corners := self._scene.corners()):
                self._file.send_blueprint(self._scene.blueprint(corners, is_live=self._status is not None))
            self._file.close()
        if self._feed is not None:
            self._feed.close(_CLOSE_TIMEOUT_S)
        if self._viewer is not None and self._viewer.process is not None and not self._viewer.outlives_us:
            self._viewer.process.kill()
            self._viewer.process.wait(_CLOSE_TIMEOUT_S)

    def _begin(self, report: FrameReport) -> None:
        corners = np.empty((0, 3)) if report.frame is None else _visible_corners(report.frame)
        blueprint = self._scene.blueprint(corners, is_live=self._status is not None)
        if self._file is not None:
            self._file.send_blueprint(blueprint)
        if self._viewer is not None:
            from hickory_stream.sinks.rerun.live import LiveFeed

            self._feed = LiveFeed(
                url=self._viewer.url,
                recording_id=self._recording_id,
                capacity=self._config.live_queue_length,
                blueprint=blueprint,
            )

    def _robot_items(self) -> list[LogItem]:
        if self._status is None or time.monotonic() - self._told_s < _STATUS_EVERY_S:
            return []
        import rerun as rr

        from hickory_stream.sinks.rerun.blueprint import ROBOT
        from hickory_stream.sinks.rerun.items import LogItem, Span

        self._told_s = time.monotonic()
        text = f"```\n{self._status()}\n```"
        document = rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
        return [LogItem(path=ROBOT, archetypes=(document,), span=Span.LASTING)]

    def _log(self, moment: Moment, items: list[LogItem]) -> None:
        if self._file is not None:
            self._file.write(moment, items)
        if self._feed is not None:
            self._feed.put(moment, items)


def _visible_corners(frame: Frame) -> NDArray[np.float64]:
    # (8, 3) corners of the visible part without the outermost tenths; (0, 3) if nothing is visible.
    points = backproject(frame.depth_m, frame.camera)[::8, ::8].reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) == 0:
        return np.empty((0, 3))
    ends = np.percentile(apply(frame.world_from_camera, points), [10, 90], axis=0)
    return np.array(list(itertools.product(*ends.T)))
