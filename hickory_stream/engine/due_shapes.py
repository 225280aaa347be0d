"""Commits results of shape jobs to the core: when they are due (playback) or have arrived (live), and at the end."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.events import ShapeReady

if TYPE_CHECKING:
    from collections.abc import Callable

    from hickory_stream.engine.effects import EffectRunner
    from hickory_stream.engine.map_folder import MapFolder
    from hickory_stream.engine.modes import Mode
    from hickory_stream.engine.shape_queue import ShapeQueue
    from hickory_stream.engine.step import StepKind
    from hickory_stream.engine.step_writer import StepWriter
    from hickory_stream.engine.stopping import Stop
    from hickory_stream.events import ShapeFailed


class OutOfPatienceError(Exception):
    """The grace period of a stopped run is over."""


class DueShapes:
    """Commits results of shape jobs: each is an event for the core, and its job is over with the step that has it."""

    def __init__(
        self,
        shapes: ShapeQueue,
        effects: EffectRunner,
        steps: StepWriter,
        folder: MapFolder,
        stop: Stop,
        *,
        mode: Mode,
        grace_s: float,
    ) -> None:
        self._shapes = shapes
        self._effects = effects
        self._steps = steps
        self._folder = folder
        self._stop = stop
        self._mode = mode
        self._grace_s = grace_s

    async def commit(self, stamp_ns: int | None) -> None:
        """Tell the core of the shapes that are due at a stamp, None: of all that are open.

        Raises:
            OutOfPatienceError: the run was stopped and one of them is not there yet: what came after this would not be
                what an uninterrupted run does.
        """
        while (event := await self._next(stamp_ns)) is not None:
            await self._ended(event)
        if self._mode == "playback" and self._shapes.has_due(stamp_ns):
            raise OutOfPatienceError

    async def commit_last(self, kind: StepKind, stamp_ns: int, tell: Callable[[], None]) -> None:
        """Tell the core of the shapes that are open, or those that come within the grace of a stop; each is a step."""
        while (event := await self._next(None)) is not None:
            await self._ended(event)
            await self._steps.commit(kind, stamp_ns)
            tell()

    async def _ended(self, event: ShapeReady | ShapeFailed) -> None:
        await self._effects.handle(event)
        self._steps.end_job(event.ticket)
        if isinstance(event, ShapeReady):
            self._folder.keep_shape(event.shape.mesh_name)

    async def _next(self, stamp_ns: int | None) -> ShapeReady | ShapeFailed | None:
        """Return the next shape that is due; None where none is, or where a stop has no patience left for it."""
        if self._mode == "live" and stamp_ns is not None:
            return await self._shapes.next_arrived(stamp_ns)
        return await self._stop.within_grace(self._shapes.next_due(stamp_ns), "next-shape", self._grace_s)
