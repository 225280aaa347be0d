"""Which boundaries between two true things single keyframes draw, by what draws them: depth, colour, or neither.

`python -m tools.evaluation.masks.boundaries LOG TRUTH`
"""

import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.evaluation.truth import frame_at, instances_of, load_truth
from hickory_stream.perception.surface import lab_of
from hickory_stream.records import Frame
from tools.evaluation.masks.first_layer import play_first_layer

# Pixels on both sides of a boundary are this far apart; a step is more than three sigmas and a slope of 45 degrees.
_APART_PX = 6
_STEP_SIGMAS, _STEP_LAB = 3.0, 12.0
# A pair of things counts in a keyframe with this many pixels of a boundary, and by the median of so many keyframes.
_LEAST_PX, _LEAST_KEYFRAMES = 12, 3
KINDS = ("a step in depth", "a step in colour alone", "neither")


def sides(
    frame: Frame, shown: NDArray[np.int64], masks: NDArray[np.int32]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]]:
    """Yield, along rows and columns, pairs (K, 2) of true things, the kind of each boundary, and if masks differ."""
    lab = cv2.blur(lab_of(frame.rgb), (3, 3))
    for axis in (0, 1):
        a, b = (tuple(cut if own == axis else slice(None) for own in (0, 1)) for cut in _CUTS)
        at = (shown[a] > 0) & (shown[b] > 0) & (shown[a] != shown[b]) & (masks[a] > 0) & (masks[b] > 0)
        near, far = frame.depth_m[a][at], frame.depth_m[b][at]
        gate = _STEP_SIGMAS * frame.sensor.sigma_m(np.maximum(near, far)) + _APART_PX / frame.camera.fx * near
        is_step = ~(np.abs(near - far) <= gate)
        is_seam = np.linalg.norm(lab[a][at] - lab[b][at], axis=1) > _STEP_LAB
        yield (
            np.sort(np.stack([shown[a][at], shown[b][at]], axis=1), axis=1),
            np.where(is_step, 0, np.where(is_seam, 1, 2)),
            masks[a][at] != masks[b][at],
        )


_CUTS = (slice(None, -_APART_PX), slice(_APART_PX, None))


def drawn_shares(log: Path, truth_folder: Path) -> dict[str, tuple[float, float, int]]:
    """Return by kind: the share of boundary pixels drawn, the median over pairs of things, and how many pairs."""
    truth = load_truth(truth_folder)
    stamps = np.array([frame.stamp_ns for frame in truth.frames])
    pixels, shares = np.zeros((3, 2), np.int64), defaultdict[tuple[int, int, int], list[float]](list)
    for keyframe in play_first_layer(log):
        frame, masks = keyframe.frame, np.zeros(keyframe.frame.depth_m.shape, np.int32)
        for i, observation in enumerate(keyframe.perceived.observations, start=1):
            x0, y0, x1, y1 = observation.box_px
            masks[y0:y1, x0:x1][observation.mask] = i
        shown = instances_of(truth, truth.frames[frame_at(stamps, frame.stamp_ns)]).astype(np.int64)
        pairs, kinds, differ = (np.concatenate(parts) for parts in zip(*sides(frame, shown, masks), strict=True))
        np.add.at(pixels, kinds, np.stack([differ, np.ones_like(differ)], axis=1))
        rows = np.column_stack([pairs, kinds])
        found, numbers = np.unique(rows, axis=0, return_inverse=True)
        counts, drawn = np.bincount(numbers.ravel()), np.bincount(numbers.ravel(), weights=differ)
        for (one, other, kind), count, own in zip(found.tolist(), counts, drawn, strict=True):
            if count >= _LEAST_PX:
                shares[one, other, kind].append(float(own / count))
    out = {}
    for kind, name in enumerate(KINDS):
        of = [np.median(s) for (_, _, own), s in shares.items() if own == kind and len(s) >= _LEAST_KEYFRAMES]
        out[name] = (float(pixels[kind, 0] / max(pixels[kind, 1], 1)), float(np.median(of)) if of else 0.0, len(of))
    return out


if __name__ == "__main__":
    for name, (share, median, count) in drawn_shares(Path(sys.argv[1]), Path(sys.argv[2])).items():
        print(f"{name}: {share:.2f} of the pixels are drawn; median of {count} pairs of things {median:.2f}")
