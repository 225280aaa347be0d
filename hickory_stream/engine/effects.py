"""Carries out effects: gives the core an event, then does what its effects ask for until none is left."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, assert_never

from hickory_stream.engine.crops import write_crop
from hickory_stream.engine.keyframe_images import crop_of
from hickory_stream.engine.threads import on_thread
from hickory_stream.events import (
    CancelShape,
    ComputeFeatures,
    DropView,
    Effect,
    Event,
    FeaturesReady,
    KeepView,
    Publish,
    RequestShape,
    SearchLoops,
)
from hickory_stream.perception.perceive import features_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from concurrent.futures import ThreadPoolExecutor

    import numpy as np
    from numpy.typing import NDArray

    from hickory_stream.config import RunConfig
    from hickory_stream.engine.loop_closing import LoopCloser
    from hickory_stream.engine.map_folder import MapFolder
    from hickory_stream.engine.recorder import Recorder
    from hickory_stream.engine.shape_queue import ShapeQueue
    from hickory_stream.engine.step_writer import StepWriter
    from hickory_stream.mapping.core import MapperCore
    from hickory_stream.ports import FeatureExtractor
    from hickory_stream.records import Frame, MapSnapshot, Observation


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class AtHand:
    """The keyframe that an event is about: its pixels and observations, which some effects need.

    `patches` (h, w, D) are the features of its colours; None where nobody found them ahead.
    """

    frame: Frame
    observations: Sequence[Observation]
    patches: NDArray[np.float32] | None = None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Handled:
    """What an event led to: what the core published, and the patch features (h, w, D); None where there is nothing.

    `effects` are those that nobody waits for who wants to see the map: shape jobs, and what they make superfluous.
    """

    published: Publish | None
    patches: NDArray[np.float32] | None
    effects: tuple[Effect, ...]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class EffectTargets:
    """Whom effects concern: `folder` the pixels of views, `recorder` and `steps` the disk, `shapes` the workers."""

    folder: MapFolder
    recorder: Recorder
    steps: StepWriter
    shapes: ShapeQueue
    loops: LoopCloser
    extractor: FeatureExtractor
    publish: Callable[[MapSnapshot], None]


class EffectRunner:
    """Owns the core; all that it decides, and all that it is told, goes through `handle`, on the thread `thinker`."""

    def __init__(
        self, core: MapperCore, targets: EffectTargets, thinker: ThreadPoolExecutor, config: RunConfig
    ) -> None:
        self.core = core
        self._to = targets
        self._thinker = thinker
        self._config = config

    async def handle(self, event: Event, at_hand: AtHand | None = None) -> Handled:
        """Give the core an event, and carry out its effects and those that follow from them."""
        handled = await self.decide(event, at_hand)
        await self.carry_out(handled.effects)
        return handled

    async def decide(self, event: Event, at_hand: AtHand | None = None) -> Handled:
        """Give the core an event, and publish the map after it; the effects that are left are for `carry_out`."""
        published: Publish | None = None
        patches: NDArray[np.float32] | None = None
        left: list[Effect] = []
        asked: Event | None = event
        while asked is not None:
            self._to.steps.add_event(asked)
            effects = await on_thread(self._thinker, self.core.handle, asked)
            asked = None
            # Pixels first: a job may need them.
            await self._keep_views([effect for effect in effects if isinstance(effect, KeepView)], at_hand)
            for effect in effects:
                if isinstance(effect, ComputeFeatures):
                    asked, patches = await self._features(effect, at_hand)
                elif isinstance(effect, Publish):
                    published = effect
                else:
                    left.append(effect)
        if published is not None:
            self._to.publish(published.snapshot)
            self._to.steps.add_published(published)
        return Handled(published=published, patches=patches, effects=tuple(left))

    async def carry_out(self, effects: Sequence[Effect]) -> None:
        """Carry out what was left of an event, in its order."""
        for effect in effects:
            await self._carry_out(effect)

    async def _carry_out(self, effect: Effect) -> None:
        match effect:
            case KeepView() | ComputeFeatures() | Publish():
                return
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

    async def _features(
        self, effect: ComputeFeatures, at_hand: AtHand | None
    ) -> tuple[FeaturesReady, NDArray[np.float32]]:
        assert at_hand is not None, "features are asked for while the frame is at hand"
        features, patches = await on_thread(
            self._thinker,
            features_of,
            at_hand.frame,
            at_hand.observations,
            effect.observation_indices,
            self._to.extractor,
            at_hand.patches,
        )
        return FeaturesReady(frame_index=effect.frame_index, features=features), patches

    async def _keep_views(self, keeps: Sequence[KeepView], at_hand: AtHand | None) -> None:
        if not keeps:
            return
        assert at_hand is not None, "views are kept while the frame is at hand"
        frame, observations, views = at_hand.frame, at_hand.observations, self._to.folder.views

        def write() -> None:
            for keep in keeps:
                crop = crop_of(frame, observations[keep.observation_index], self._config.crop_margin)
                write_crop(views, keep.view.name, crop, self._config)

        await self._to.recorder.write_views(write)
