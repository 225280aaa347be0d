"""Carries out the core's effects, crops views, and commits the results of shape jobs."""

from collections.abc import Awaitable, Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import assert_never

import numpy as np
from numpy.typing import NDArray

from hickory_stream.config import JournalConfig, RunConfig
from hickory_stream.engine.async_tools import StopRequest, on_thread
from hickory_stream.engine.loop_closing import LoopCloser
from hickory_stream.engine.modes import Mode
from hickory_stream.engine.shape_jobs.queue import ShapeQueue
from hickory_stream.engine.step_writer import Recorder, StepWriter
from hickory_stream.events import (
    CancelShape,
    ComputeFeatures,
    DropView,
    Effect,
    Event,
    KeepView,
    Publish,
    RequestShape,
    SearchLoops,
    ShapeFailed,
    ShapeReady,
)
from hickory_stream.map_folder.views import write_crop
from hickory_stream.map_folder.writer import MapFolder
from hickory_stream.mapping.core import MapperCore
from hickory_stream.perception.perceive import features_of
from hickory_stream.ports import Crop
from hickory_stream.records import Frame, MapSnapshot, Observation, RawFrame

# Quality of the kept images where the log has none.
_JPEG_QUALITY = 80


def crop_of(frame: Frame, observation: Observation, margin: float) -> Crop:
    """Return the crop of a frame around an observation, its box enlarged by `margin` on every side."""
    x0, y0, x1, y1 = observation.box_px
    dx, dy = round((x1 - x0) * margin) + 2, round((y1 - y0) * margin) + 2
    left, top = max(0, x0 - dx), max(0, y0 - dy)
    right, bottom = min(frame.camera.width, x1 + dx), min(frame.camera.height, y1 + dy)
    mask = np.zeros((bottom - top, right - left), dtype=bool)
    mask[y0 - top : y1 - top, x0 - left : x1 - left] = observation.mask
    return Crop(
        rgb=frame.rgb[top:bottom, left:right],
        depth_m=frame.depth_m[top:bottom, left:right],
        mask=mask,
        camera=frame.camera.cropped(left, top, right, bottom),
        world_from_camera=frame.world_from_camera,
        sensor=frame.sensor,
    )


def color_of(raw: RawFrame, frame: Frame, config: JournalConfig) -> bytes | None:
    """Return the compressed image of a keyframe: the log's own, else a JPEG; None if images are not kept."""
    if not config.keep_images:
        return None
    if raw.color_bytes is not None:
        return raw.color_bytes
    import cv2

    quality = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
    encoded: bytes = cv2.imencode(".jpg", frame.rgb[..., ::-1], quality)[1].tobytes()
    return encoded


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CurrentKeyframe:
    """The keyframe of an event: pixels and observations, which some effects need."""

    frame: Frame
    observations: Sequence[Observation]
    #: (h, w, D) features of its colours.
    patches: NDArray[np.float32] | None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Handled:
    """The result of an event."""

    published: Publish | None
    #: To carry out after the map is published: shape jobs and clean-up.
    effects: tuple[Effect, ...]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class EffectTargets:
    """Receivers of effects: `folder` gets the pixels of views, `recorder` and `steps` write the journal."""

    folder: MapFolder
    recorder: Recorder
    steps: StepWriter
    shapes: ShapeQueue
    loops: LoopCloser
    #: The side of a patch of features.
    patch_px: int
    publish: Callable[[MapSnapshot], None]


class EffectRunner:
    """Owns the core; every event goes through `handle`, on the mapping thread."""

    def __init__(
        self, core: MapperCore, targets: EffectTargets, mapping_thread: ThreadPoolExecutor, config: RunConfig
    ) -> None:
        self.core = core
        self._to = targets
        self._mapping_thread = mapping_thread
        self._config = config

    async def handle(self, event: Event, current: CurrentKeyframe | None = None) -> Handled:
        """Send an event to the core, and carry out its effects and those that follow from them."""
        handled = await self.decide(event, current)
        await self.carry_out(handled.effects)
        return handled

    async def decide(self, event: Event, current: CurrentKeyframe | None = None) -> Handled:
        """Send an event to the core, and publish the map; the remaining effects are for `carry_out`."""
        published: Publish | None = None
        left: list[Effect] = []
        asked: Event | None = event
        while asked is not None:
            self._to.steps.add_event(asked)
            effects = await on_thread(self._mapping_thread, self.core.handle, asked)
            asked = None
            # Pixels first: a job may need them.
            await self._keep_views([effect for effect in effects if isinstance(effect, KeepView)], current)
            for effect in effects:
                if isinstance(effect, ComputeFeatures):
                    assert current is not None and current.patches is not None, "features are of the current frame"
                    needed = (effect, current.observations, current.patches, self._to.patch_px)
                    asked = await on_thread(self._mapping_thread, features_of, *needed)
                elif isinstance(effect, Publish):
                    published = effect
                else:
                    left.append(effect)
        if published is not None:
            self._to.publish(published.snapshot)
            self._to.steps.add_published(published)
        return Handled(published=published, effects=tuple(left))

    async def carry_out(self, effects: Sequence[Effect]) -> None:
        """Carry out the remaining effects of an event, in order."""
        for effect in effects:
            match effect:
                case KeepView() | ComputeFeatures() | Publish():
                    pass
                case DropView():
                    self._to.steps.drop_view(effect.name)
                case RequestShape():
                    await self._to.recorder.written()
                    await self._to.shapes.request(effect)
                case SearchLoops():
                    self._to.loops.request(effect)
                case CancelShape():
                    self._to.shapes.cancel(effect.ticket)
                    self._to.steps.end_job(effect.ticket)
                case _:
                    assert_never(effect)

    async def _keep_views(self, keeps: Sequence[KeepView], current: CurrentKeyframe | None) -> None:
        if not keeps:
            return
        assert current is not None, "views are kept of the current frame"
        frame, observations, views = current.frame, current.observations, self._to.folder.views

        def write() -> None:
            for keep in keeps:
                crop = crop_of(frame, observations[keep.observation_index], self._config.crop_margin)
                write_crop(views, keep.view.name, crop, self._config)

        await self._to.recorder.write_views(write)


class GraceExpired(Exception):
    """The grace period of a stopped run is over."""


class DueShapes:
    """Commits results of shape jobs: each is an event, and its job ends with the step of this event.

    Results are committed when they are due (playback) or have arrived (live), and at the end.
    """

    def __init__(
        self, effects: EffectRunner, targets: EffectTargets, stop: StopRequest, *, mode: Mode, grace_s: float
    ) -> None:
        self._effects = effects
        self._to = targets
        self._stop = stop
        self._mode = mode
        self._grace_s = grace_s

    async def commit(self, stamp_ns: int | None) -> None:
        """Send shapes that are due at a stamp to the core, None: all open ones.

        Raises `GraceExpired`: the run was stopped while one was missing: what follows would not be reproducible.
        """
        while (event := await self._next(stamp_ns)) is not None:
            await self._ended(event)
        if self._mode == "playback" and self._to.shapes.has_due(stamp_ns):
            raise GraceExpired

    async def commit_last(self, commit: Callable[[], Awaitable[None]]) -> None:
        """Send open shapes to the core, or those that arrive within the grace of a stop; `commit` a step after each."""
        while (event := await self._next(None)) is not None:
            await self._ended(event)
            await commit()

    async def _ended(self, event: ShapeReady | ShapeFailed) -> None:
        await self._effects.handle(event)
        self._to.steps.end_job(event.ticket)
        if isinstance(event, ShapeReady):
            self._to.folder.keep_shape(event.shape.mesh_name)

    async def _next(self, stamp_ns: int | None) -> ShapeReady | ShapeFailed | None:
        # None also where a stop leaves no time for the next shape.
        if self._mode == "live" and stamp_ns is not None:
            return await self._to.shapes.next_arrived(stamp_ns)
        return await self._stop.within_grace(self._to.shapes.next_due(stamp_ns), "next-shape", self._grace_s)
