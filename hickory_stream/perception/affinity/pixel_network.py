"""The affinity network: for every pixel, which pixels around it are of the same object, and whether it is on an object.

Affinities to neighbours at growing distances, as in Wolf et al. 2018 (mutex watershed) and Lee et al. 2017; the network
(`tools/train_network`) is a U-Net of one megabyte whose weights come with the package. It is quantised to eight bits
throughout: sums are exact integers, which one scale factor and one rounding convert back to bytes, so that every
processor gives the same bytes (`tests/perception/test_pixel_network.py` compares it with integer arithmetic in NumPy).
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.perception.affinity.pixel_inputs import NUM_INPUTS, pixel_inputs
from hickory_stream.perception.models.network import Network, NetworkConfig

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from hickory_stream.perception.surface import Surface

EMBEDDED = "weights/affinities.onnx"
DISTANCES_PX = (1, 3, 9, 27)
"""Distances to the neighbours, in output pixels; one output pixel is two pixels of the surface."""
OFFSETS = tuple((dy * d, dx * d) for d in DISTANCES_PX for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)))
"""The offset (down, right) from a pixel to its neighbour, for each affinity output; the last output is `THING`."""
THING = len(OFFSETS)
NUM_OUTPUTS = THING + 1
ODDS_ZERO = 128
ODDS_UNIT = 16
"""Log-odds as bytes: `ODDS_ZERO` is log-odds 0 (even odds), and `ODDS_UNIT` steps are log-odds 1."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PixelOdds:
    """(NUM_OUTPUTS, h, w) bytes: log-odds at half resolution; pixel (i, j) is pixel (2 i, 2 j) of the surface."""

    odds: NDArray[np.uint8]


class PixelNetwork:
    """The loaded network; it always runs on one CPU thread, whatever other networks use.

    Args:
        path: the ONNX graph; None: the one in the package.

    Raises:
        ModelError: the graph is missing, damaged or of another kind.
    """

    def __init__(self, path: Path | None = None) -> None:
        config = NetworkConfig(provider="cpu", threads=1)
        if path is None:
            with resources.as_file(resources.files("hickory_stream.perception") / EMBEDDED) as embedded:
                self._network = Network(embedded, config)
        else:
            self._network = Network(path, config)
        inputs, outputs = self._network.inputs, self._network.outputs
        if (
            len(inputs) != 1
            or len(outputs) != 1
            or (inputs[0].dtype, outputs[0].dtype) != ("uint8", "uint8")
            or inputs[0].shape[1:2] != (NUM_INPUTS,)
            or outputs[0].shape[1:2] != (NUM_OUTPUTS,)
        ):
            expected = f"bytes (1, {NUM_INPUTS}, H, W) as its input and (1, {NUM_OUTPUTS}, H / 2, W / 2) as its output"
            raise self._network.mismatch("affinity", expected)

    def odds(self, surface: Surface, floor_z_m: float | None) -> PixelOdds:
        """Return the network's log-odds for a surface; raises `ModelError`."""
        height, width = surface.depth_m.shape
        found = self._network.run(pixel_inputs(surface, floor_z_m)[None])[0][0]
        return PixelOdds(odds=np.ascontiguousarray(found[:, : (height + 1) // 2, : (width + 1) // 2]))
