"""Bridging of occlusions: two fragments of one object on both sides of an occluder.

A fragment's plane is extrapolated along the image row or column behind its occluder. A line bridges two fragments if
the plane becomes visible again; a surface behind the plane ends it. Objects of equal height can stand side by side, so
a horizontal and a vertical plane must both continue.
"""

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.perception.surface import Surface

# Maximum length of the extrapolation; the trees were grown with it.
BRIDGED_M = 0.5
# Maximum distance of a point from the plane, plus 3 sigma of depth.
_TOLERANCE_M = 0.006
# Minimum number of rows and columns (every other one is scanned) that bridge two regions, also as a share of the
# square root of the smaller region's pixels.
_MIN_LINES = 4
_MIN_SHARE = 0.12
# Minimum number of lines for each of the two kinds of plane, horizontal and vertical.
_OTHER_LINES = 2


def bridges(surface: Surface, labels: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return (M, 3): two labels and whether the plane is horizontal, for every scanned line that bridges the two."""
    camera = surface.camera
    found: NDArray[np.int64] = _bridges(
        surface.depth_m,
        surface.points_world,
        surface.normals_world,
        surface.sigma_m,
        labels,
        surface.world_from_camera[:3, 3].astype(np.float32),
        surface.world_from_camera[:3, :3].astype(np.float32),
        (np.float32(camera.fx), np.float32(camera.fy), np.float32(camera.cx), np.float32(camera.cy)),
        np.float32(BRIDGED_M),
        np.float32(_TOLERANCE_M),
    )
    return found


def is_bridged(
    level: NDArray[np.float64], upright: NDArray[np.float64], pixels: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return (K,) which pairs of regions are one object behind an occluder.

    `level` and `upright` (K,): bridging lines on a horizontal and a vertical plane; `pixels` (K,): the smaller area.
    """
    most, other = np.maximum(level, upright), np.minimum(level, upright)
    enough = np.maximum(_MIN_LINES, _MIN_SHARE * np.sqrt(pixels))
    return np.asarray((most >= enough) & (other >= _OTHER_LINES))


@kernel
def _bridges(depth, points, normals, sigma, labels, origin, rotation, intrinsics, gap, tolerance):
    # (K, 3): two labels and whether the plane is horizontal, for each row or column that bridges the two.
    height, width = depth.shape
    fx, fy, cx, cy = intrinsics
    out = np.empty((height * width, 3), dtype=np.int64)
    count = 0
    for side in range(2):
        lines, length = (height, width) if side == 0 else (width, height)
        for line in range(0, lines, 2):
            for start in range(length - 2):
                y, x = (line, start) if side == 0 else (start, line)
                label = labels[y, x]
                if label == 0 or np.isnan(normals[y, x, 0]):
                    continue
                ny, nx = (line, start + 1) if side == 0 else (start + 1, line)
                if labels[ny, nx] == label or depth[ny, nx] > depth[y, x]:
                    continue
                n0, n1, n2 = normals[y, x, 0], normals[y, x, 1], normals[y, x, 2]
                offset = (
                    (points[y, x, 0] - origin[0]) * n0
                    + (points[y, x, 1] - origin[1]) * n1
                    + (points[y, x, 2] - origin[2]) * n2
                )
                is_occluded = False
                for step in range(1, length - start):
                    yy, xx = (line, start + step) if side == 0 else (start + step, line)
                    u, v = (xx - cx) / fx, (yy - cy) / fy
                    along = (
                        (rotation[0, 0] * u + rotation[0, 1] * v + rotation[0, 2]) * n0
                        + (rotation[1, 0] * u + rotation[1, 1] * v + rotation[1, 2]) * n1
                        + (rotation[2, 0] * u + rotation[2, 1] * v + rotation[2, 2]) * n2
                    )
                    if offset * along <= 0.0:
                        break
                    expected = offset / along
                    if step * expected / fx > gap or expected > 8.0:
                        break
                    z = depth[yy, xx]
                    if np.isnan(z):
                        continue
                    # Converts a distance to the plane into a difference of depth along the ray.
                    slack = (tolerance + 3.0 * sigma[y, x]) / abs(along)
                    if z < expected - max(slack, 0.02 * expected):
                        is_occluded = True
                        continue
                    other = labels[yy, xx]
                    if is_occluded and other != label and other != 0 and z < expected + slack:
                        agree = normals[yy, xx, 0] * n0 + normals[yy, xx, 1] * n1 + normals[yy, xx, 2] * n2
                        if agree > 0.95:
                            out[count, 0], out[count, 1] = label, other
                            out[count, 2] = 1 if n2 > 0.85 else 0
                            count += 1
                    break
    return out[:count].copy()
