"""Images of several threads share runs of a network: those that wait while it runs go together in the next run.

Results do not depend on timing: every run has the same number of images, since other numbers give other last bits, and
empty ones fill it up. For each size of image a check shows that place and neighbours in a run do not matter.
"""

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import ModelError

# A run of a small network takes an accelerator about as long as its start: of that, three quarters are saved.
IMAGES_A_RUN = 4

Outputs = list[NDArray[Any]]


@dataclass(frozen=True, slots=True, eq=False)
class _Call:
    image: NDArray[Any]
    outputs: Future[Outputs] = field(default_factory=Future)


class SharedRuns:
    """A network for several threads; `run` takes images (B, C, H, W) and returns outputs of B rows, or raises.

    Images run alone where the network fails on several, or does not give the same bytes in every place.
    """

    def __init__(self, run: Callable[[NDArray[Any]], Outputs]) -> None:
        self._run = run
        self._waiting: deque[_Call] = deque()
        self._thread = ThreadPoolExecutor(1, "network")
        self._can_share: dict[tuple[int, ...], bool] = {}

    def run(self, image: NDArray[Any]) -> Outputs:
        """Return the outputs, of one row each, for an image (1, C, H, W); raises `ModelError`."""
        call = _Call(image)
        self._waiting.append(call)
        self._thread.submit(self._serve)
        return call.outputs.result()

    def _serve(self) -> None:
        calls: list[_Call] = []
        while self._waiting and len(calls) < IMAGES_A_RUN:
            if calls and self._waiting[0].image.shape != calls[0].image.shape:
                break
            calls.append(self._waiting.popleft())
        for call, found in zip(calls, self._outputs([call.image for call in calls]), strict=True):
            if isinstance(found, list):
                call.outputs.set_result(found)
            else:
                call.outputs.set_exception(found)

    def _outputs(self, images: list[NDArray[Any]]) -> list[Outputs | ModelError]:
        try:
            if images and self._is_checked(images[0]):
                return [*self._rows(images)]
            if len(images) == 1:
                return [self._run(images[0])]
        except ModelError as error:
            if len(images) == 1:
                return [error]
        # An image on which the network fails costs only itself.
        return [found for image in images for found in self._outputs([image])]

    def _rows(self, images: list[NDArray[Any]]) -> list[Outputs]:
        empty = [np.zeros_like(images[0])] * (IMAGES_A_RUN - len(images))
        outputs = self._run(np.concatenate([*images, *empty]))
        return [[output[i : i + 1] for output in outputs] for i in range(len(images))]

    def _is_checked(self, image: NDArray[Any]) -> bool:
        if image.shape not in self._can_share:
            other = 2 * image[..., ::-1]
            try:
                rows = [*self._rows([image] * IMAGES_A_RUN), *self._rows([other, image, image, other])]
            except ModelError:
                rows = []
            found = [tuple(output.tobytes() for output in outputs) for outputs in rows]
            of_other = {*found[IMAGES_A_RUN :: IMAGES_A_RUN - 1]}
            self._can_share[image.shape] = len(of_other) == 1 and len({*found} - of_other) <= 1
        return self._can_share[image.shape]
