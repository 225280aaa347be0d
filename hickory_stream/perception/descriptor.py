"""A dense patch descriptor from colour alone, with DINOv2's interface and without weights.

Per patch of 14 pixels: soft histograms of colour in Lab and of gradient orientation at two scales, minus their mean
over many objects, since all patches would be similar otherwise. OpenCV's floating-point filters use fused multiply-add
on some processors only, so gradients have a kernel of their own.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry import portable
from hickory_stream.geometry.camera import whole_reduction
from hickory_stream.geometry.portable_kernels import arctan2
from hickory_stream.perception.surface import lab_of
from hickory_stream.records import MaskFeature, Observation


def gradients(image: NDArray[np.float32], sigma_px: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return (h, w) Sobel differences along x and y of a blurred image (h, w), mirrored at its border."""
    radius = max(1, round(4 * sigma_px))
    weights = portable.gaussian_weights(sigma_px, radius).astype(np.float32)
    blurred = _blurred(_mirrored(image, radius), weights)
    along_x, along_y = _sobel(_mirrored(blurred, 1))
    return along_x, along_y


def _mirrored(image: NDArray[np.float32], radius: int) -> NDArray[np.float32]:
    return np.asarray(cv2.copyMakeBorder(image, radius, radius, radius, radius, cv2.BORDER_REFLECT_101))


@kernel
def _blurred(padded, weights):
    # The innermost loop runs along a row and is vectorised.
    height, width = padded.shape[0] - len(weights) + 1, padded.shape[1] - len(weights) + 1
    rows = np.zeros((padded.shape[0], width), dtype=np.float32)
    for y in range(padded.shape[0]):
        for k in range(len(weights)):
            for x in range(width):
                rows[y, x] += weights[k] * padded[y, x + k]
    out = np.zeros((height, width), dtype=np.float32)
    for y in range(height):
        for k in range(len(weights)):
            for x in range(width):
                out[y, x] += weights[k] * rows[y + k, x]
    return out


@kernel
def _sobel(p):
    height, width = p.shape[0] - 2, p.shape[1] - 2
    along_x, along_y = np.empty((height, width), dtype=np.float32), np.empty((height, width), dtype=np.float32)
    two = np.float32(2.0)
    for y in range(height):
        for x in range(width):
            left = p[y, x] + two * p[y + 1, x] + p[y + 2, x]
            right = p[y, x + 2] + two * p[y + 1, x + 2] + p[y + 2, x + 2]
            above = p[y, x] + two * p[y, x + 1] + p[y, x + 2]
            below = p[y + 2, x] + two * p[y + 2, x + 1] + p[y + 2, x + 2]
            along_x[y, x], along_y[y, x] = right - left, below - above
    return along_x, along_y


_LIGHT_BINS, _HUE_BINS, _ORIENTATIONS = 5, 8, 8
# The mean over the objects of a synthetic apartment and a table-top, by `tools/descriptor_mean` (seeds 22 and 31).
_MEAN_TEXT = """
    0.047 0.323 0.339 0.097 0.032 0.060 0.431 0.313 0.025 0.008 0.013 0.037 0.027 0.306
    0.072 0.066 0.065 0.088 0.115 0.092 0.066 0.063 0.067 0.061 0.059 0.081 0.104 0.084
    0.060 0.058
"""
_MEAN = np.array([float(mean) for mean in _MEAN_TEXT.split()], dtype=np.float32)


class ColorTextureDescriptor:
    """Patch features of `dim` = 30: 5 of lightness, 8 of hue by chroma, 1 of grey, 16 of gradients."""

    name = "color-texture-30-centred"
    patch_px = 14
    dim = _LIGHT_BINS + _HUE_BINS + 1 + 2 * _ORIENTATIONS

    def extract(self, rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Return (h, w, 30) float32 features of unit norm, one per patch of 14 pixels; h = ceil(H / 14)."""
        features = self.uncentered(rgb) - _MEAN
        # The mean of many patches is shorter than 1, so that no patch becomes zero.
        return np.asarray(features / np.linalg.norm(features, axis=-1, keepdims=True))

    def uncentered(self, rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Return the unit-norm features (h, w, 30) before the mean is subtracted: square roots of histograms."""
        height, width, _ = rgb.shape
        # In a larger image, patches side by side share the feature of one patch of the same part of the view.
        shared = whole_reduction(width)
        side = shared * self.patch_px
        rows, columns = -(-height // side), -(-width // side)
        bottom, right = rows * side - height, columns * side - width
        padded = cv2.copyMakeBorder(rgb, 0, bottom, 0, right, cv2.BORDER_REPLICATE)
        # Half the resolution takes a quarter of the time, and a patch still has 49 pixels.
        size = columns * side // (2 * shared), rows * side // (2 * shared)
        small = cv2.resize(padded, size, interpolation=cv2.INTER_AREA)
        lab = lab_of(small)
        light = np.ascontiguousarray(lab[..., 0])
        # Angles are computed in separate loops, which are vectorised.
        hue = _turns(lab[..., 2].ravel(), lab[..., 1].ravel(), 2 * np.pi).reshape(light.shape)
        fine, coarse = _gradient(light, 0.35), _gradient(light, 0.7)
        pooled = _pooled(lab, hue, *fine, *coarse, self.patch_px // 2)
        # Square roots make the inner product of two histograms their Bhattacharyya coefficient.
        features = np.sqrt(np.maximum(pooled, 0.0)) + 1e-4
        features /= np.linalg.norm(features, axis=-1, keepdims=True)
        features = features.astype(np.float32)
        if shared > 1:
            features = features.repeat(shared, axis=0).repeat(shared, axis=1)
        return features[: -(-height // self.patch_px), : -(-width // self.patch_px)]


def mask_feature(observation: Observation, features: NDArray[np.float32], patch_px: int) -> MaskFeature:
    """Return the pooled feature of a mask and the variance of its patches, weighted by their shares of mask."""
    # sigma^2 is the trace of the covariance of the unit-norm patch features, at most 1.
    from hickory_stream.records import MaskFeature

    x0, y0, _, _ = observation.box_px
    weights = _pixels_of_patches(observation.mask, x0, y0, patch_px, features.shape[0], features.shape[1])
    used = weights > 0
    weight = weights[used] / weights.sum()
    values = features[used].astype(np.float64)
    mean = portable.matmul(weight, values)
    variance = portable.dot(weight, (values * values).sum(axis=1)) - portable.dot(mean, mean)
    norm = portable.norm(mean)
    return MaskFeature(
        observation_index=observation.index,
        variance=min(max(variance, 0.0), 1.0),
        pooled=(mean / norm).astype(np.float32),
    )


@kernel
def _pixels_of_patches(mask, x0, y0, patch_px, rows, columns):
    # (rows, columns) the number of mask pixels in each patch, for a mask whose box begins at (x0, y0).
    out = np.zeros((rows, columns))
    for y in range(mask.shape[0]):
        for x in range(mask.shape[1]):
            if mask[y, x]:
                out[(y + y0) // patch_px, (x + x0) // patch_px] += 1.0
    return out


def _gradient(
    light: NDArray[np.float32], sigma_px: float
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float64]]:
    # (h, w) the gradient along x and y, and its direction in half turns.
    x, y = gradients(light, sigma_px)
    return x, y, _turns(y.ravel(), x.ravel(), np.pi).reshape(light.shape)


@kernel(error_model="numpy")
def _turns(y, x, turn):
    out = np.empty(len(y))
    for i in range(len(y)):
        out[i] = arctan2(np.float64(y[i]), np.float64(x[i])) / turn
    return out


@kernel
def _pooled(lab, hue, fine_x, fine_y, fine, coarse_x, coarse_y, coarse, side):
    # (h, w, 30) soft histograms of patches of `side` pixels: every pixel is shared by the two nearest bins. `hue` is in
    # turns, directions of gradients in half turns.
    rows, columns = lab.shape[0] // side, lab.shape[1] // side
    out = np.zeros((rows, columns, _LIGHT_BINS + _HUE_BINS + 1 + 2 * _ORIENTATIONS), np.float32)
    share = 1.0 / (side * side)
    grey = _LIGHT_BINS + _HUE_BINS
    for row in range(rows * side):
        for column in range(columns * side):
            bins = out[row // side, column // side]
            light, a, b = lab[row, column, 0], lab[row, column, 1], lab[row, column, 2]
            position = min(max(light / 100.0 * (_LIGHT_BINS - 1), 0.0), _LIGHT_BINS - 1.0)
            low = min(int(position), _LIGHT_BINS - 2)
            bins[low] += share * (1.0 - (position - low))
            bins[low + 1] += share * (position - low)
            chroma = min(np.sqrt(a * a + b * b) / 40.0, 1.0)
            if chroma > 0.0:
                _add(bins, _LIGHT_BINS, _HUE_BINS, hue[row, column], share * 2.0 * chroma)
            bins[grey] += share * (1.0 - chroma)
            for scale in range(2):
                gx = fine_x[row, column] if scale == 0 else coarse_x[row, column]
                gy = fine_y[row, column] if scale == 0 else coarse_y[row, column]
                strength = min(np.sqrt(gx * gx + gy * gy) / 40.0, 2.0)
                if strength > 0.0:
                    turns = fine[row, column] if scale == 0 else coarse[row, column]
                    _add(bins, grey + 1 + scale * _ORIENTATIONS, _ORIENTATIONS, turns, share * 0.5 * strength)
    return out


@kernel
def _add(bins, first, count, turns, weight):
    position = (turns - np.floor(turns)) * count
    low = int(position)
    rest = position - low
    # Both wrap around at most once; a modulo would take as long as the rest of this function.
    here = low if low < count else low - count
    bins[first + here] += weight * (1.0 - rest)
    bins[first + (here + 1 if here + 1 < count else 0)] += weight * rest
