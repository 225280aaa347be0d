"""The input channels of the affinity network, in eight bits: geometry and colour.

Geometry leads, as in UOIS-Net (Xie et al. 2021) and UCN (Xiang et al. 2020). The channels do not depend on the camera:
normals are in the frame of gravity and the heading; depth steps and creases are second differences of inverse depth in
units of its noise. The network was trained to work without scale, height or colour.
"""

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry import portable
from hickory_stream.geometry.portable_kernels import log
from hickory_stream.perception.surface import Surface

CHANNELS = (
    *("valid", "normal_forward", "normal_right", "normal_up", "bend_x_1", "bend_y_1", "bend_x_4", "bend_y_4"),
    *("scale", "height", "has_height", "light", "green_red", "blue_yellow"),
)
NUM_INPUTS = len(CHANNELS)
# The byte for 0 and for unknown values; the values -1 and 1 of a channel are `UNIT` below and above it.
ZERO, UNIT = 128, 64
# Height and width of the network's input are multiples of this; pixels beyond the frame are `ZERO`.
MULTIPLE_PX = 32


def pixel_inputs(surface: Surface, floor_z_m: float | None) -> NDArray[np.uint8]:
    """Return (NUM_INPUTS, H, W) bytes, H and W multiples of 32, for a surface (h, w) in their upper left corner."""
    height, width = surface.depth_m.shape
    padded = [-(-side // MULTIPLE_PX) * MULTIPLE_PX for side in (height, width)]
    out = np.full((NUM_INPUTS, *padded), ZERO, dtype=np.uint8)
    # Beyond the image there is no return either.
    inverses = np.pad(np.float32(1) / surface.depth_m, 4, constant_values=np.nan)
    stiffness = surface.depth_m * surface.depth_m / surface.sigma_m
    arrays = (surface.depth_m, surface.points_world, surface.normals_world, inverses, stiffness)
    focal_px = np.float32((surface.camera.fx + surface.camera.fy) / 2)
    floor_z = np.float32(np.nan if floor_z_m is None else floor_z_m)
    _geometry(*arrays, _heading(surface.world_from_camera), focal_px, floor_z, out)
    _colors(surface.lab, out)
    return out


def _heading(world_from_camera: NDArray[np.float64]) -> NDArray[np.float32]:
    # (2,) the horizontal viewing direction; the image's top for a camera that looks straight down.
    forward = world_from_camera[:2, 2] - 0.2 * world_from_camera[:2, 1]
    return np.asarray(forward / max(portable.norm(forward), 1e-9), dtype=np.float32)


@kernel
def _byte(value):
    # Clipped to -2..1.98.
    scaled = np.float32(128.5) + np.float32(64.0) * value
    return np.uint8(min(max(scaled, np.float32(0.0)), np.float32(255.0)))


@kernel(error_model="numpy")
def _bends(one, other, own, stiffness, out):
    # (W,) second differences of inverse depth in sigmas, squeezed to -2..2; 0 where not measurable. `one` and `other`
    # are inverse depths on both sides of `own`, NaN without a return; `stiffness`: inverse deviation. Vectorised.
    two, four, zero = np.float32(2.0), np.float32(4.0), np.float32(0.0)
    for x in range(len(out)):
        bend = (one[x] + other[x] - two * own[x]) * stiffness[x]
        # Without a return on one side this is NaN, and no comparison is true of it.
        bend = bend if abs(bend) >= zero else zero
        byte = _byte(two * bend / (abs(bend) + four))
        out[x] = byte if own[x] > zero else np.uint8(ZERO)


@kernel(error_model="numpy")
def _geometry(depth, points, normals, inverses, stiffness, heading, focal_px, floor_z_m, out):
    height, width = depth.shape
    one = np.float32(1.0)
    for y in range(height):
        own, rows = inverses[y + 4, 4 : 4 + width], inverses[y + 4]
        for channel in range(2):
            step = 1 if channel == 0 else 4
            left, right = rows[4 - step : 4 - step + width], rows[4 + step : 4 + step + width]
            above, below = inverses[y + 4 - step, 4 : 4 + width], inverses[y + 4 + step, 4 : 4 + width]
            _bends(left, right, own, stiffness[y], out[4 + 2 * channel, y, :width])
            _bends(above, below, own, stiffness[y], out[5 + 2 * channel, y, :width])
        for x in range(width):
            if np.isnan(depth[y, x]):
                continue
            out[0, y, x] = _byte(one)
            if not np.isnan(normals[y, x, 0]):
                nx, ny = normals[y, x, 0], normals[y, x, 1]
                out[1, y, x] = _byte(nx * heading[0] + ny * heading[1])
                out[2, y, x] = _byte(nx * heading[1] - ny * heading[0])
                out[3, y, x] = _byte(normals[y, x, 2])
            # Metres per pixel: from 1 mm to 5 cm.
            out[8, y, x] = _byte(np.float32(log(depth[y, x] / focal_px)) + np.float32(5.0))
            if not np.isnan(floor_z_m):
                out[9, y, x] = _byte((points[y, x, 2] - floor_z_m) / np.float32(0.75) - one)
                out[10, y, x] = _byte(one)


@kernel
def _colors(lab, out):
    height, width = lab.shape[:2]
    for y in range(height):
        for x in range(width):
            out[11, y, x] = _byte(lab[y, x, 0] / np.float32(40.0) - np.float32(1.25))
            out[12, y, x] = _byte(lab[y, x, 1] / np.float32(40.0))
            out[13, y, x] = _byte(lab[y, x, 2] / np.float32(40.0))
