"""Keyframes placed in a run: registered on a thread, and what came of it told to the core and to people."""

from __future__ import annotations

import logging
import time
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.engine.keyframe_places import KeyframePlaces
from hickory_stream.engine.threads import on_thread
from hickory_stream.events import KeyframeKeptOut, PoseJumped

if TYPE_CHECKING:
    from collections.abc import MutableMapping
    from concurrent.futures import ThreadPoolExecutor

    from numpy.typing import NDArray

    from hickory_stream.engine.effects import EffectRunner
    from hickory_stream.engine.history.registration_history import RegistrationHistory
    from hickory_stream.poses.registration_config import RegistrationConfig
    from hickory_stream.poses.surface_image import SurfaceImage
    from hickory_stream.records import Frame

logger = logging.getLogger(__name__)


class Placing:
    """Places the keyframes of a run in their order; what does not fit the map is kept out, and said once in a row.

    `counts` and `timings_s` are those of the run.
    """

    def __init__(
        self,
        config: RegistrationConfig,
        effects: EffectRunner,
        thread: ThreadPoolExecutor,
        *,
        counts: MutableMapping[str, int],
        timings_s: MutableMapping[str, float],
    ) -> None:
        self._places = KeyframePlaces(config)
        self._effects = effects
        self._thread = thread
        self._counts = counts
        self._timings_s = timings_s
        self._is_keeping_out = False

    def where(self, odometry_from_camera: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where a camera is in the map (4, 4) that the odometry has at `odometry_from_camera`."""
        return self._places.where(odometry_from_camera)

    def jumped(self, *, is_loop: bool = False) -> None:
        """Take note of a jump of the odometry or the stamps; `is_loop`: the log begins anew, and so do its poses."""
        self._places.jumped(is_loop=is_loop)

    def restore(self, history: RegistrationHistory | None) -> None:
        """Go on as after some step of a run; None: as at its beginning."""
        self._places.restore(history)

    async def place(self, frame: Frame, surface: SurfaceImage | None = None) -> Frame | None:
        """Return a keyframe at the pose at which it is mapped, None where it does not fit the map.

        `surface` is its `keyframe_surface`, None where nobody found it ahead.
        """
        started = time.perf_counter()
        found = await on_thread(self._thread, self._places.place, frame, surface)
        self._timings_s["register"] += time.perf_counter() - started
        if found is None:
            return frame
        if isinstance(found, KeyframeKeptOut):
            if not self._is_keeping_out:
                logger.warning("frame %d and what follows is kept out of the map: %s", frame.index, found.reason)
            self._is_keeping_out = True
            await self._effects.handle(found)
            return None
        if found.event.how == "begun anew":
            logger.warning(
                "frame %d does not fit the map, nor do those before it: the robot is somewhere else than its odometry "
                "says, and a new submap begins",
                frame.index,
            )
            self._counts["carried_away"] += 1
            await self._effects.handle(PoseJumped(stamp_ns=frame.stamp_ns, after_from_before=np.eye(4)))
        elif self._is_keeping_out:
            logger.warning("frame %d fits the map again", frame.index)
        self._is_keeping_out = False
        self._counts["keyframes_corrected"] += found.event.corrects
        await self._effects.handle(found.event)
        return found.frame
