"""The first surface at each pixel of a viewpoint, by a z-buffer (Catmull 1974).

A large map has more triangles than a picture has pixels, so that drawing them is faster than building a ray caster.
`raycast.Scene` answers rays from anywhere; both agree but at the very edges of triangles.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.arrays import freeze
from hickory_stream.pictures.raycast import CREASE_COSINE, Hits, Surface, image_colors
from hickory_stream.pictures.viewpoint import Viewpoint

# What is nearer to the eye's plane than this is not drawn.
_NEAR_M = 0.01
# Dots as far apart as this many samples leave hardly a square of samples empty.
_DOTS_APART = 0.1
# One dot of so many tells how far all are.
_SOME = 64
_MIDDLE = np.zeros((1, 2), dtype=np.float32)
# Read-only as those of a surface are: a kernel is compiled for each kind of array.
_NO_UV = np.empty((0, 2), dtype=np.float32)
_NO_UV.flags.writeable = False


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Dots:
    """Points (N, 3) float32, each drawn as an upright square of half side `half_m` that faces the viewer.

    A dot is never smaller than a pixel sample, so that distant surfaces have no holes.
    """

    points: NDArray[np.float32]
    colors: NDArray[np.uint8]
    half_m: float
    owner: int

    def __post_init__(self) -> None:
        freeze(self, "points", np.float32, (None, 3))
        freeze(self, "colors", np.uint8, (len(self.points), 3))


def first_hits(
    surfaces: Sequence[Surface],
    dots: Sequence[Dots],
    viewpoint: Viewpoint,
    *,
    within_px: NDArray[np.float32] = _MIDDLE,
    step_px: int = 1,
) -> list[Hits]:
    """Return the first hits in each square of `step_px` pixels, row by row: Hits for each of S sample positions.

    `within_px` (S, 2) are the positions, relative to the middle of a square.
    """
    image = _Image(viewpoint, within_px.astype(np.float32), step_px, any(one.image is not None for one in surfaces))
    for i, surface in enumerate(surfaces):
        image.draw(surface, i)
    for one in dots:
        image.draw_dots(one)
    return image.hits(surfaces)


class _Image:
    """Depths, and what is to be seen at them, at (S, rows, columns) samples."""

    def __init__(self, viewpoint: Viewpoint, within_px: NDArray[np.float32], step_px: int, with_uv: bool) -> None:
        self._viewpoint, self._within_px, self._step_px = viewpoint, within_px, step_px
        rows, columns = viewpoint.height // step_px, viewpoint.width // step_px
        shape = (len(within_px), rows, columns)
        self._depth = np.full(shape, np.inf, dtype=np.float32)
        self._normals, self._colors = np.zeros((2, *shape, 3), dtype=np.float32)
        self._owners = np.full(shape, -1, dtype=np.int32)
        # Of which surface with an image, and where in the image.
        self._of = np.full(shape if with_uv else (0, 0, 0), -1, dtype=np.int32)
        self._uv = np.zeros((*self._of.shape, 2), dtype=np.float32)
        self._pose = np.ascontiguousarray(viewpoint.world_from_camera)
        self._lens = np.array([viewpoint.focal_px, viewpoint.width / 2, viewpoint.height / 2])
        self._buffers = (self._depth, self._normals, self._colors, self._owners, self._of, self._uv)

    def draw(self, surface: Surface, index: int) -> None:
        uv = surface.uv if surface.image is not None and surface.uv is not None else _NO_UV
        _draw_triangles(
            surface.vertices, surface.faces, surface.normals, surface.colors, uv, surface.owner, index,
            self._pose, self._lens, self._viewpoint.is_orthographic, float(self._step_px), self._within_px,
            *self._buffers,
        )  # fmt: skip

    def draw_dots(self, dots: Dots) -> None:
        # Where a hundred dots are in one square of samples, as in a sketch of a building, some of them fill it.
        apart_m = _DOTS_APART * self._step_px * self._viewpoint.pixel_m(dots.points[::_SOME])
        every = max(1, int((apart_m / dots.half_m) ** 2))
        _draw_dots(
            dots.points, dots.colors, every, dots.half_m, dots.owner,
            self._pose, self._lens, self._viewpoint.is_orthographic, float(self._step_px), self._within_px,
            *self._buffers[:5],
        )  # fmt: skip

    def hits(self, surfaces: Sequence[Surface]) -> list[Hits]:
        for i in np.unique(self._of[self._of >= 0]):
            here, picture = self._of == i, surfaces[i].image
            assert picture is not None
            self._colors[here] = image_colors(picture, self._uv[here])
        found = zip(self._depth, self._normals, self._colors, self._owners, self._within_px, strict=True)
        return [
            Hits(
                distance_m=(depth * self._stretch(within)).reshape(-1),
                normals=normals.reshape(-1, 3),
                colors=colors.reshape(-1, 3),
                owners=owners.reshape(-1),
            )
            for depth, normals, colors, owners, within in found
        ]

    def _stretch(self, within_px: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return (rows, columns) distances along the ray at a depth of one."""
        rows, columns = self._depth.shape[1:]
        if self._viewpoint.is_orthographic:
            return np.ones((rows, columns), dtype=np.float32)
        x = ((np.arange(columns) + 0.5) * self._step_px + within_px[0] - self._lens[1]) / self._lens[0]
        y = ((np.arange(rows) + 0.5) * self._step_px + within_px[1] - self._lens[2]) / self._lens[0]
        return np.sqrt(1 + x[None, :] ** 2 + y[:, None] ** 2).astype(np.float32)


@kernel
def _squares_over(low, high, reach, step, count):
    """Return the first, and the one after the last, of `count` squares in a row with a sample from `low` to `high`.

    Samples are within `reach` of the middle of their square; some squares at the ends may have none there.
    """
    first = np.floor((low - reach) / step + 0.5)
    end = np.floor((high + reach) / step + 0.5)
    return int(min(max(first, 0.0), count)), int(min(max(end, 0.0), count))


@kernel
def _draw_triangles(
    vertices, faces, normals, colors, uv, owner, index, pose, lens, is_flat, step, within, depths, normals_at,
    colors_at, owners_at, of_at, uv_at,
):  # fmt: skip
    count, has_uv, keeps_uv = len(vertices), len(uv) > 0, len(of_at) > 0
    x, y, z = np.empty(count), np.empty(count), np.empty(count)
    for i in range(count):
        dx, dy, dz = vertices[i, 0] - pose[0, 3], vertices[i, 1] - pose[1, 3], vertices[i, 2] - pose[2, 3]
        z[i] = pose[0, 2] * dx + pose[1, 2] * dy + pose[2, 2] * dz
        scale = lens[0] if is_flat else lens[0] / max(z[i], _NEAR_M)
        x[i] = (pose[0, 0] * dx + pose[1, 0] * dy + pose[2, 0] * dz) * scale + lens[1]
        y[i] = (pose[0, 1] * dx + pose[1, 1] * dy + pose[2, 1] * dz) * scale + lens[2]
    samples, rows, columns = depths.shape
    reach = np.abs(within).max()
    flat, smooth = np.empty(3), np.empty(3)
    for f in range(len(faces)):
        a, b, c = faces[f]
        area = (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a])
        if area == 0.0 or min(z[a], z[b], z[c]) < _NEAR_M:
            continue
        low_x, high_x = min(x[a], x[b], x[c]), max(x[a], x[b], x[c])
        low_y, high_y = min(y[a], y[b], y[c]), max(y[a], y[b], y[c])
        has_normal = False
        first, end = _squares_over(low_x, high_x, reach, step, columns)
        top, bottom = _squares_over(low_y, high_y, reach, step, rows)
        for row in range(top, bottom):
            for column in range(first, end):
                for s in range(samples):
                    px = (column + 0.5) * step + within[s, 0]
                    py = (row + 0.5) * step + within[s, 1]
                    if px < low_x or px > high_x or py < low_y or py > high_y:
                        continue
                    wb = ((px - x[a]) * (y[c] - y[a]) - (py - y[a]) * (x[c] - x[a])) / area
                    wc = ((x[b] - x[a]) * (py - y[a]) - (y[b] - y[a]) * (px - x[a])) / area
                    wa = 1.0 - wb - wc
                    if wa < 0.0 or wb < 0.0 or wc < 0.0:
                        continue
                    if is_flat:
                        depth = wa * z[a] + wb * z[b] + wc * z[c]
                    else:
                        # Of a perspective image, inverse depths are linear in the image, and so is what is over depth.
                        wa, wb, wc = wa / z[a], wb / z[b], wc / z[c]
                        depth = 1.0 / (wa + wb + wc)
                        wa, wb, wc = wa * depth, wb * depth, wc * depth
                    if depth >= depths[s, row, column]:
                        continue
                    if not has_normal:
                        has_normal = True
                        _face_normal(vertices, a, b, c, flat)
                    length, agreement, away = 0.0, 0.0, 0.0
                    for k in range(3):
                        smooth[k] = wa * normals[a, k] + wb * normals[b, k] + wc * normals[c, k]
                        length += smooth[k] * smooth[k]
                        agreement += smooth[k] * flat[k]
                    length = max(np.sqrt(length), 1e-12)
                    is_gentle = abs(agreement) > CREASE_COSINE * length
                    for k in range(3):
                        smooth[k] = smooth[k] / length if is_gentle else flat[k]
                        towards = pose[k, 2]
                        if not is_flat:
                            towards = wa * vertices[a, k] + wb * vertices[b, k] + wc * vertices[c, k] - pose[k, 3]
                        away += smooth[k] * towards
                    sign = -1.0 if away > 0.0 else 1.0
                    depths[s, row, column] = depth
                    owners_at[s, row, column] = owner
                    for k in range(3):
                        normals_at[s, row, column, k] = sign * smooth[k]
                        colors_at[s, row, column, k] = (
                            wa * colors[a, k] + wb * colors[b, k] + wc * colors[c, k]
                        ) / 255.0
                    if keeps_uv:
                        of_at[s, row, column] = index if has_uv else -1
                        if has_uv:
                            for k in range(2):
                                uv_at[s, row, column, k] = wa * uv[a, k] + wb * uv[b, k] + wc * uv[c, k]


@kernel
def _draw_dots(
    points, colors, every, half_m, owner, pose, lens, is_flat, step, within, depths, normals_at, colors_at, owners_at,
    of_at,
):  # fmt: skip
    samples, rows, columns = depths.shape
    reach = np.abs(within).max()
    normal = np.array([-pose[0, 2], -pose[1, 2], -pose[2, 2]])
    for i in range(0, len(points), every):
        dx, dy, dz = points[i, 0] - pose[0, 3], points[i, 1] - pose[1, 3], points[i, 2] - pose[2, 3]
        z = pose[0, 2] * dx + pose[1, 2] * dy + pose[2, 2] * dz
        if z < _NEAR_M:
            continue
        scale = lens[0] if is_flat else lens[0] / z
        x = (pose[0, 0] * dx + pose[1, 0] * dy + pose[2, 0] * dz) * scale + lens[1]
        y = (pose[0, 1] * dx + pose[1, 1] * dy + pose[2, 1] * dz) * scale + lens[2]
        half = max(half_m * scale, 0.5 * step)
        if not is_flat:
            length = np.sqrt(dx * dx + dy * dy + dz * dz)
            normal[0], normal[1], normal[2] = -dx / length, -dy / length, -dz / length
        first, end = _squares_over(x - half, x + half, reach, step, columns)
        top, bottom = _squares_over(y - half, y + half, reach, step, rows)
        for row in range(top, bottom):
            for column in range(first, end):
                for s in range(samples):
                    px = (column + 0.5) * step + within[s, 0]
                    py = (row + 0.5) * step + within[s, 1]
                    if abs(px - x) > half or abs(py - y) > half:
                        continue
                    if z >= depths[s, row, column]:
                        continue
                    depths[s, row, column] = z
                    owners_at[s, row, column] = owner
                    for k in range(3):
                        normals_at[s, row, column, k] = normal[k]
                        colors_at[s, row, column, k] = colors[i, k] / 255.0
                    if len(of_at) > 0:
                        of_at[s, row, column] = -1


@kernel
def _face_normal(vertices, a, b, c, out):
    """Put the unit normal of a triangle into `out` (3,)."""
    ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
    vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    length = max(np.sqrt(nx * nx + ny * ny + nz * nz), 1e-12)
    out[0], out[1], out[2] = nx / length, ny / length, nz / length
