"""The affinity network: for every pixel, which pixels around it are of the same object, and whether it is on an object.

Affinities at growing distances (Wolf et al. 2018, Lee et al. 2017) by a packaged U-Net of one megabyte
(`tools/train_network`). It is quantised to eight bits throughout: exact integer sums, one scale factor and one rounding
give the same bytes on every processor (`tests/perception/affinity/test_pixel_inputs.py`).
"""

from contextlib import nullcontext
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hickory_stream.perception.affinity.pixel_inputs import NUM_INPUTS, pixel_inputs
from hickory_stream.perception.models.network import Network, NetworkConfig
from hickory_stream.perception.surface import Surface

EMBEDDED = "weights/affinities.onnx"
# Distances to the neighbours, in output pixels; one output pixel is two pixels of the surface.
DISTANCES_PX = (1, 3, 9, 27)
# The offset (down, right) from a pixel to its neighbour, for each affinity output; the last output is `THING`.
OFFSETS = tuple((dy * d, dx * d) for d in DISTANCES_PX for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)))
THING = len(OFFSETS)
NUM_OUTPUTS = THING + 1
# Log-odds as bytes: `ODDS_ZERO` is log-odds 0 (even odds), and `ODDS_UNIT` steps are log-odds 1.
ODDS_ZERO, ODDS_UNIT = 128, 16


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PixelOdds:
    """(NUM_OUTPUTS, h, w) bytes: log-odds at half resolution; pixel (i, j) is pixel (2 i, 2 j) of the surface."""

    odds: NDArray[np.uint8]


class PixelNetwork:
    """The loaded network (None: the packaged one), on one CPU thread; raises `ModelError` for another kind of graph."""

    def __init__(self, path: Path | None = None) -> None:
        embedded = resources.files("hickory_stream.perception") / EMBEDDED
        with resources.as_file(embedded) if path is None else nullcontext(path) as graph:
            self._network = Network(graph, NetworkConfig(provider="cpu", threads=1))
        tensors = (*self._network.inputs, *self._network.outputs)
        found = [(tensor.dtype, tensor.shape[1:2]) for tensor in tensors]
        if len(self._network.inputs) != 1 or found != [("uint8", (NUM_INPUTS,)), ("uint8", (NUM_OUTPUTS,))]:
            expected = f"bytes (1, {NUM_INPUTS}, H, W) as its input and (1, {NUM_OUTPUTS}, H / 2, W / 2) as its output"
            raise self._network.mismatch("affinity", expected)

    def odds(self, surface: Surface, floor_z_m: float | None) -> PixelOdds:
        """Return the network's log-odds for a surface; raises `ModelError`."""
        height, width = surface.depth_m.shape
        found = self._network.run(pixel_inputs(surface, floor_z_m)[None])[0][0]
        return PixelOdds(odds=np.ascontiguousarray(found[:, : (height + 1) // 2, : (width + 1) // 2]))
