"""Pose corrections in a run, and registration of its keyframes.

Corrections from outside and from loops are applied before a frame is mapped.
"""

import logging
import time
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from hickory_stream.engine.async_tools import on_thread
from hickory_stream.engine.effects import EffectRunner
from hickory_stream.engine.keyframe_places import RegistrationFilter
from hickory_stream.engine.loop_closing import LoopCloser
from hickory_stream.errors import InputError
from hickory_stream.events import KeyframeKeptOut, PoseJumped, PosesCorrected
from hickory_stream.geometry.rigid import is_rigid
from hickory_stream.poses.registration_config import RegistrationConfig
from hickory_stream.poses.surface_image import SurfaceImage
from hickory_stream.records import Frame

logger = logging.getLogger(__name__)


class Corrections:
    """Pending corrections in the order of their arrival; `counts` are applied ones."""

    def __init__(self, effects: EffectRunner, loops: LoopCloser, thread: ThreadPoolExecutor) -> None:
        self._effects = effects
        self._loops = loops
        self._thread = thread
        self.counts: Counter[str] = Counter()
        self._waiting: deque[dict[int, NDArray[np.float64]]] = deque()
        self._is_closed = False

    def give(self, world_from_submap: Mapping[int, NDArray[np.float64]], known: Sequence[int]) -> None:
        """Place submaps at new poses; `known` are the ids of the map's submaps.

        Raises `InputError`: there is no such submap, a transform is not rigid, or the map is finished; nothing is
        moved.
        """
        if self._is_closed:
            raise InputError("the map is finished: poses can be corrected while it is being made")
        self._waiting.append(checked_places(world_from_submap, known))

    async def apply(self, stamp_ns: int) -> None:
        """Send pending corrections to the core."""
        while self._waiting:
            places = self._waiting.popleft()
            self.counts["pose_corrections"] += 1
            poses = np.array(list(places.values())).reshape(-1, 4, 4)
            event = PosesCorrected(stamp_ns=stamp_ns, submap_ids=tuple(places), world_from_submap=poses)
            await self._effects.handle(event)

    async def close_loops(self, stamp_ns: int, *, all_of_them: bool = False) -> None:
        """Send loops that are due at a stamp to the core, then the poses of submaps that the graph's solution moves."""
        while (event := await self._loops.next_due(None if all_of_them else stamp_ns)) is not None:
            await self._effects.handle(event)
            self.counts["loops"] += sum(loop.reason is None for loop in event.loops)
            corrected = None
            if event.loops:
                corrected = await on_thread(self._thread, self._loops.correction, self._effects.core, stamp_ns)
            if corrected is not None:
                self.counts["loop_corrections"] += len(corrected.submap_ids) > 0
                await self._effects.handle(corrected)

    def __len__(self) -> int:
        return len(self._waiting)

    def forget(self) -> None:
        """Drop pending corrections after a seek back: their submaps may not exist yet."""
        if self._waiting:
            logger.warning("%d corrections of poses are dropped after a seek back", len(self._waiting))
            self._waiting.clear()

    def close(self) -> None:
        """Refuse further corrections."""
        self._is_closed = True


def checked_places(
    world_from_submap: Mapping[int, NDArray[np.float64]], known: Sequence[int]
) -> dict[int, NDArray[np.float64]]:
    """Return copies of the (4, 4) poses by submap; `known` are the ids of the map's submaps.

    Raises `InputError`: there is no such submap, or a transform is not rigid.
    """
    for submap_id, pose in world_from_submap.items():
        if submap_id not in known:
            there = f"the map has {known[0]} to {known[-1]}" if known else "the map has none before its first keyframe"
            raise InputError(f"there is no submap {submap_id}: {there}")
        if np.shape(pose) != (4, 4) or not is_rigid(np.asarray(pose)):
            raise InputError(f"world_from_submap of submap {submap_id} must be a rigid (4, 4) transform, found {pose}")
    return {i: np.array(pose, dtype=np.float64) for i, pose in world_from_submap.items()}


class KeyframeRegistrar:
    """Registers keyframes on a thread, in their order; a series of rejected keyframes is logged once."""

    def __init__(self, config: RegistrationConfig, effects: EffectRunner, thread: ThreadPoolExecutor) -> None:
        self.places = RegistrationFilter(config)
        self._effects = effects
        self._thread = thread
        self.counts: Counter[str] = Counter()
        self.seconds = 0.0
        self._is_keeping_out = False

    async def place(self, frame: Frame, surface: SurfaceImage | None = None) -> Frame | None:
        """Return a keyframe at its registered pose, None if it does not fit the map.

        `surface` is its `keyframe_surface`, None if it was not computed ahead.
        """
        started = time.perf_counter()
        found = await on_thread(self._thread, self.places.place, frame, surface)
        self.seconds += time.perf_counter() - started
        if found is None:
            return frame
        if isinstance(found, KeyframeKeptOut):
            if not self._is_keeping_out:
                logger.warning("frame %d and following ones are kept out of the map: %s", frame.index, found.reason)
            self._is_keeping_out = True
            await self._effects.handle(found)
            return None
        if found.event.how == "begun anew":
            logger.warning(
                "frame %d does not fit the map, nor do the frames before it: the robot is not where its odometry says, "
                "and a new submap begins",
                frame.index,
            )
            self.counts["carried_away"] += 1
            await self._effects.handle(PoseJumped(stamp_ns=frame.stamp_ns, after_from_before=np.eye(4)))
        elif self._is_keeping_out:
            logger.warning("frame %d fits the map again", frame.index)
        self._is_keeping_out = False
        self.counts["keyframes_corrected"] += found.event.corrects
        await self._effects.handle(found.event)
        return found.frame
