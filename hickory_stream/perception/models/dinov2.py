"""DINOv2: patch features of unit norm by a vision transformer's graph, for images of any size.

The graph takes (1, 3, H, W) in multiples of its patch, normalised as for ImageNet, and gives tokens (1, T, D), the last
of which are the patches row by row, or a map (1, D, h, w).
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.ranges import Ranged, number
from hickory_stream.errors import ModelError
from hickory_stream.perception.models.network import Network
from hickory_stream.perception.models.preprocessing import normalised

_MOST_EXTRA_TOKENS = 16


@dataclass(frozen=True, kw_only=True, slots=True)
class DinoConfig(Ranged):
    """How features are computed."""

    #: Name of the network in the folder of models.
    model: str = "dinov2-small"
    #: Side of a patch of the network.
    patch_px: int = number(14, 1, 1024, "px")
    #: Integer factor by which frames are reduced first; a patch covers this many times more frame pixels.
    reduce: int = number(1, 1, 64, "ratio")


class DinoExtractor:
    """A `FeatureExtractor`; `name` tells weights apart. Raises `ModelError` for another kind of graph."""

    def __init__(self, network: Network, config: DinoConfig, *, name: str = "dinov2", warm_up: bool = True) -> None:
        self.name = name
        self._network = network
        self._config = config
        self._fixed = network.require_image_input("DINOv2")
        shape = network.outputs[0].shape
        if len(shape) not in (3, 4):
            raise network.mismatch("DINOv2", "tokens (1, T, D) or a map (1, D, h, w) as its first output")
        dim = shape[2] if len(shape) == 3 else shape[1]
        if dim is None or warm_up:
            side = 4 * config.patch_px
            height, width = self._fixed[0] or side, self._fixed[1] or side
            tokens = self._features(np.zeros((height, width, 3), dtype=np.uint8), is_warm_up=True)
            dim = tokens.shape[-1]
        self._dim = dim

    @property
    def patch_px(self) -> int:
        """The side of a patch in pixels of the frame."""
        return self._config.patch_px * self._config.reduce

    @property
    def dim(self) -> int:
        """The length D of a feature."""
        return self._dim

    def share_runs(self) -> int:
        """Let images of several threads share runs; return how many share one."""
        return self._network.share_runs()

    def extract(self, rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Return (h, w, D) float32 features of unit norm, one per patch; h = ceil(H / patch), w = ceil(W / patch).

        Patches beyond the image repeat its border.

        Raises:
            ModelError: the graph has another fixed size, or gives tensors of another shape or that are not finite.
        """
        height, width, _ = rgb.shape
        rows, columns = -(-height // self.patch_px), -(-width // self.patch_px)
        padded = cv2.copyMakeBorder(
            rgb, 0, rows * self.patch_px - height, 0, columns * self.patch_px - width, cv2.BORDER_REPLICATE
        )
        if self._config.reduce > 1:
            size = (columns * self._config.patch_px, rows * self._config.patch_px)
            padded = cv2.resize(padded, size, interpolation=cv2.INTER_AREA)
        for given, fixed, side in zip(padded.shape, self._fixed, ("height", "width"), strict=False):
            if fixed not in (None, given):
                raise ModelError(
                    f"{self._network.path} takes images of {side} {fixed} only, and the frames give {given} (made "
                    f"whole patches of {self._config.patch_px}); export it with open sizes "
                    "(hickory_stream/perception/models/README.md)"
                )
        return self._features(padded, is_warm_up=False)

    def _features(self, rgb: NDArray[np.uint8], *, is_warm_up: bool) -> NDArray[np.float32]:
        rows, columns = rgb.shape[0] // self._config.patch_px, rgb.shape[1] // self._config.patch_px
        image = normalised(rgb)
        if is_warm_up:
            self._network.warm_up(image)
        tokens = self._network.run(image)[0]
        if tokens.ndim == 4 and tokens.shape[0] == 1 and tokens.shape[2:] == (rows, columns):
            patches = tokens[0].transpose(1, 2, 0)
        elif tokens.ndim == 3 and tokens.shape[0] == 1 and 0 <= tokens.shape[1] - rows * columns <= _MOST_EXTRA_TOKENS:
            patches = tokens[0, tokens.shape[1] - rows * columns :].reshape(rows, columns, -1)
        else:
            raise self._network.mismatch(
                "DINOv2",
                f"{rows * columns} patch tokens of {self._config.patch_px} px for an image of {rgb.shape[1]} x "
                f"{rgb.shape[0]}, got {tokens.shape}",
            )
        if not np.isfinite(patches.sum()):
            raise ModelError(
                f"{self._network.path} gave features with NaN or infinity on {self._network.provider}; a graph in "
                "float16 overflows on some devices: export it in float32, or choose another provider"
            )
        norm = np.linalg.norm(patches, axis=-1, keepdims=True)
        return np.ascontiguousarray(patches / np.maximum(norm, 1e-12), dtype=np.float32)
