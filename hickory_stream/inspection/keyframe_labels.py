"""The label of each pixel of a recorded keyframe: mask, rejected mask (and why), structure, or none.

The journal keeps masks at full resolution, depth and structure at a reduced one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from hickory_stream.geometry.arrays import freeze
from hickory_stream.perception.coarse import enlarged_cells

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.geometry.camera import Camera
    from hickory_stream.map_folder.history.recorded import RecordedKeyframe
    from hickory_stream.records import CoarseFrame, Observation

Where = Literal["mask", "rejected mask", "structure", "no depth", "no mask"]

NO_MASK, STRUCTURE, NO_DEPTH = 0, -1, -2
_WHERE: dict[int, Where] = {
    NO_MASK: "no mask",
    STRUCTURE: "structure",
    NO_DEPTH: "no depth",
}
LEAST_CODE = NO_DEPTH


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SeenAs:
    """A keyframe by pixel: `codes` (H, W) int32.

    1 to `num_masks` are the observations, then rejected masks; other codes are constants of this module.
    """

    codes: NDArray[np.int32]
    num_masks: int

    def __post_init__(self) -> None:
        freeze(self, "codes", np.int32, (None, None))

    def where(self, code: int) -> Where:
        """Return the label of a code."""
        return where_of(code, self.num_masks)


def where_of(code: int, num_masks: int) -> Where:
    """Return the label of a code in a keyframe with this number of observations."""
    if code > num_masks:
        return "rejected mask"
    return "mask" if code > 0 else _WHERE[code]


def seen_as(keyframe: RecordedKeyframe) -> SeenAs:
    """Return the label of each pixel of a keyframe; raises `MapFolderError` if the journal has no depth of it."""
    observed, camera, coarse = keyframe.observed, keyframe.camera, keyframe.coarse
    codes = enlarged_cells(_codes_of_cells(coarse), coarse.stride_px, (camera.width, camera.height)).copy()
    count = len(observed.observations)
    for i, rejected in reversed(list(enumerate(observed.rejected))):
        x0, y0, x1, y1 = rejected.box_px
        window = codes[y0:y1, x0:x1]
        if rejected.mask is not None:
            window[rejected.mask] = count + 1 + i
    for i, observation in enumerate(observed.observations):
        x0, y0, x1, y1 = observation.box_px
        codes[y0:y1, x0:x1][observation.mask] = i + 1
    return SeenAs(codes=codes, num_masks=count)


def code_at(keyframe: RecordedKeyframe, pixel: tuple[float, float]) -> int:
    """Return the code of one pixel (column, row) of a keyframe, the same as in `seen_as`."""
    observed = keyframe.observed
    column, row = round(pixel[0]), round(pixel[1])
    masks = [(o.box_px, o.mask) for o in observed.observations] + [(r.box_px, r.mask) for r in observed.rejected]
    for i, ((x0, y0, x1, y1), mask) in enumerate(masks):
        if mask is not None and x0 <= column < x1 and y0 <= row < y1 and mask[row - y0, column - x0]:
            return i + 1
    cells, stride = _codes_of_cells(keyframe.coarse), keyframe.coarse.stride_px
    return int(cells[min(row // stride, len(cells) - 1), min(column // stride, cells.shape[1] - 1)])


def _codes_of_cells(coarse: CoarseFrame) -> NDArray[np.int32]:
    cells = np.where(coarse.structure, STRUCTURE, NO_MASK).astype(np.int32)
    cells[coarse.depth_mm == 0] = NO_DEPTH
    return cells


def rays_of(camera: Camera, pixels: NDArray[Any]) -> NDArray[np.float64]:
    """Return the rays (N, 3) of (N, 2) pixels, as points of depth 1 in the camera's frame."""
    x, y = np.asarray(pixels, dtype=np.float64).T
    return np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones(len(x))], axis=1)


def area_px(observation: Observation) -> int:
    """Return the number of pixels of a mask."""
    return int(np.count_nonzero(observation.mask))
