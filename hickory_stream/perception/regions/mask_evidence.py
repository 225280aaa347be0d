"""Overlapping masks of a network as evidence for joining fragments.

Masks are hypotheses at several granularities: a whole, its parts, neighbours as one. None is accepted or rejected.
Masks divide fragments; then they shift the log-odds that two regions are one thing, together with the trees, which
rate geometry and colour. The weights are a logistic regression.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry import portable
from hickory_stream.geometry.disjoint_sets import root_of
from hickory_stream.perception.masks import InstanceMask
from hickory_stream.perception.regions.region_graph import summed

_SURE = 1e-6
# A mask that covers more of the image than this is the scene: it says nothing of its things.
_MAX_SHARE = 0.6
# A piece of a fragment needs this many pixels with all eight neighbours in it: outlines err by a pixel or two.
_MIN_CORE_PX = 12
# Of four signs: whether a mask shows either region; the trees' log-odds; the greatest share of both regions in one
# mask; the greatest difference of their shares in one. A logistic regression on masks of `home` and `bookstore` with
# all errors of `tools/bench paper_masks` gives 2 to 3, 0.8 to 0.9, 3.3 to 5 and -7 to -5. The first is lower here: the
# map repairs what is divided more easily than what is merged.
_WEIGHTS = (1.4, 0.9, 4.0, -6.0)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MaskEvidence:
    """The `pixels` (n,) of each fragment, and those `inside` (n, M) each mask."""

    pixels: NDArray[np.int64]
    inside: NDArray[np.int64]

    def combined(
        self, probability: NDArray[np.float64], pairs: NDArray[np.int64], numbers: NDArray[np.int64], count: int
    ) -> NDArray[np.float64]:
        """Return the probabilities (K,) that pairs (K, 2) of `count` regions are one; `numbers` as in `Round`."""
        pixels, inside = (summed(own, numbers, count) for own in (self.pixels, self.inside))
        share = inside / np.maximum(pixels, 1)[:, None]
        a, b = share[pairs[:, 0]], share[pairs[:, 1]]
        both = np.minimum(a, b).max(axis=1, initial=0.0)
        apart = np.abs(a - b).max(axis=1, initial=0.0)
        shown = np.maximum(both, apart)
        likely = np.clip(probability, _SURE, 1 - _SURE)
        odds = portable.log(likely) - portable.log(1 - likely)
        odds = sum(weight * sign for weight, sign in zip(_WEIGHTS, (shown, odds, both, apart), strict=True))
        return np.where(shown > 0, 1 / (1 + portable.exp(-odds)), probability)


def evidence_of(masks: NDArray[np.bool_], labels: NDArray[np.int32]) -> MaskEvidence:
    """Return the evidence of masks (M, h, w) for the fragments `labels` (h, w)."""
    count = int(labels.max(initial=0)) + 1
    inside = [np.bincount(labels[mask], minlength=count) for mask in masks]
    return MaskEvidence(
        pixels=np.bincount(labels.ravel(), minlength=count),
        inside=np.stack(inside, axis=1) if inside else np.zeros((count, 0), dtype=np.int64),
    )


def sampled_masks(masks: Sequence[InstanceMask], factor: int, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return (M, h, w) the masks that show more than nothing and less than the scene, at working resolution."""
    out = np.zeros((len(masks), *shape), dtype=bool)
    for i, mask in enumerate(masks):
        x0, y0, x1, y1 = mask.box_px
        (u0, u1), (v0, v1) = (
            [-(-(end - factor // 2) // factor) for end in ends] for ends in ((x0, x1), (y0, y1))
        )  # the first working pixels whose middle pixels are not before the ends
        part = mask.mask[factor // 2 + v0 * factor - y0 :: factor, factor // 2 + u0 * factor - x0 :: factor]
        window = out[i, v0:v1, u0:u1]
        window[:] = part[: window.shape[0], : window.shape[1]]
    shares = out.mean(axis=(1, 2)) if len(out) else np.zeros(0)
    return out[(shares > 0) & (shares <= _MAX_SHARE)]


def divided_by_masks(labels: NDArray[np.int32], masks: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Return the fragments (h, w), divided where masks end; the first piece of a fragment keeps its number."""
    names = np.random.default_rng(0).integers(1 << 62, size=len(masks), dtype=np.uint64)
    shown = np.zeros(labels.shape, dtype=np.uint64)
    for name, mask in zip(names, masks, strict=True):
        shown += mask * name
    pieces = _pieces(labels, shown)
    core = np.ones(labels.shape, dtype=bool)
    padded = np.pad(pieces, 1, constant_values=-1)
    height, width = labels.shape
    for y, x in np.ndindex(3, 3):
        core &= padded[y : y + height, x : x + width] == pieces
    stays = np.bincount(pieces[core], minlength=pieces.size) >= _MIN_CORE_PX
    kept = np.where(stays[pieces] & (labels > 0), pieces, -1)
    return _named(labels, _spread(labels, kept))


@kernel
def _pieces(labels, shown):
    # (h, w) connected pixels of one label that the same masks show, named by a pixel.
    height, width = labels.shape
    parent = np.arange(height * width)
    for y in range(height):
        for x in range(width):
            for side in range(2):
                yy, xx = (y, x + 1) if side == 0 else (y + 1, x)
                if yy < height and xx < width and labels[y, x] == labels[yy, xx] and shown[y, x] == shown[yy, xx]:
                    a, b = root_of(parent, y * width + x), root_of(parent, yy * width + xx)
                    parent[max(a, b)] = min(a, b)
    return np.array([root_of(parent, i) for i in range(height * width)]).reshape(height, width)


@kernel
def _spread(labels, kept):
    # Pixels without a piece take a neighbour's of the same fragment, ring by ring.
    height, width = labels.shape
    queue = np.empty(height * width, dtype=np.int64)
    out, count, done = kept.copy(), 0, 0
    for i in range(height * width):
        if out[i // width, i % width] >= 0:
            queue[count] = i
            count += 1
    while done < count:
        y, x = queue[done] // width, queue[done] % width
        done += 1
        for side in range(4):
            yy = y + (1 if side == 0 else (-1 if side == 1 else 0))
            xx = x + (1 if side == 2 else (-1 if side == 3 else 0))
            if 0 <= yy < height and 0 <= xx < width and out[yy, xx] < 0 and labels[yy, xx] == labels[y, x]:
                out[yy, xx] = out[y, x]
                queue[count] = yy * width + xx
                count += 1
    return out


@kernel
def _named(labels, pieces):
    # (h, w) fragments and their pieces as numbers; a fragment without a piece stays whole.
    height, width = labels.shape
    count = 0
    for y in range(height):
        for x in range(width):
            count = max(count, labels[y, x])
    names, has_name = np.zeros(height * width, dtype=np.int32), np.zeros(count + 1, dtype=np.bool_)
    out = labels.copy()
    for y in range(height):
        for x in range(width):
            label, piece = labels[y, x], pieces[y, x]
            if label == 0 or piece < 0:
                continue
            if names[piece] == 0:
                if has_name[label]:
                    count += 1
                    names[piece] = count
                else:
                    has_name[label] = True
                    names[piece] = label
            out[y, x] = names[piece]
    return out
