"""Layer 2 with a texture: the pixels of the views that show each place best, their exposures evened.

A high power of their detail weighs the views, so that one view holds most of a side and passes into the next without a
seam. Unseen surface has a plain colour, which fades between the colours of the seen surface around it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import csr_array

from hickory_stream.base.ranges import Ranged, number
from hickory_stream.geometry.camera import project
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.ports import Crop
from hickory_stream.textures import DEFAULT_TEXTURE_PX, LEAST_TEXTURE_PX, MOST_TEXTURE_PX
from hickory_stream.textures.atlas import Atlas, atlas_of
from hickory_stream.textures.textured_mesh import TexturedMesh

_HOLE_PX = 3.0
_LEAST_COSINE = 0.12
# Over so many pixels the colours of a view fade in from the border of what it shows of the object.
_RIM_PX = 1.0
_FADE_PX = 5.0
_SIGMAS = 3.0
_SAMPLES_A_ROW = 1024


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Sightings:
    """What V views show of N points; trust is 0 where a view does not show a point, and falls towards its border."""

    #: (V, N, 3)
    colors: NDArray[np.float32]
    #: (V, N) pixels a metre
    detail: NDArray[np.float32]
    #: (V, N) in 0..1
    trust: NDArray[np.float32]


def sightings(
    points: NDArray[np.float64], normals: NDArray[np.float64], crops: Sequence[Crop], reach_m: float
) -> Sightings:
    """Return the sightings of (N, 3) points in the world with unit normals.

    A view shows a point in its mask if it measured a surface within `reach_m`, or within the noise of its depth.
    """
    count = len(points)
    colors = np.zeros((len(crops), count, 3), np.float32)
    detail, trust = np.zeros((2, len(crops), count), np.float32)
    for i, crop in enumerate(crops):
        _see(crop, points, normals, reach_m, colors[i], detail[i], trust[i])
    return Sightings(colors=colors, detail=detail, trust=trust)


def _see(
    crop: Crop,
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    reach_m: float,
    colors: NDArray[np.float32],
    detail: NDArray[np.float32],
    trust: NDArray[np.float32],
) -> None:
    camera = crop.camera
    towards = crop.world_from_camera[:3, 3] - points
    slant = (normals * towards).sum(axis=1)
    facing = np.flatnonzero(slant > _LEAST_COSINE * np.linalg.norm(towards, axis=1))
    local = apply(invert(crop.world_from_camera), points[facing])
    pixels = project(local, camera)
    in_image = np.isfinite(pixels).all(axis=1)
    in_image &= ((pixels >= 0) & (pixels <= (camera.width - 1, camera.height - 1))).all(axis=1)
    here, local, pixels = facing[in_image], local[in_image], pixels[in_image]
    if len(here) == 0:
        return
    places = pixels.astype(np.float32)
    column, row = np.rint(places).astype(np.int64).T
    depth = _without_holes(crop)[row, column]
    tolerance = np.maximum(reach_m, _SIGMAS * crop.sensor.sigma_m(depth))
    shown = crop.mask[row, column] & (np.abs(depth - local[:, 2]) <= tolerance)
    here, local, places, column, row = here[shown], local[shown], places[shown], column[shown], row[shown]
    if len(here) == 0:
        return
    colors[here] = _sampled(crop.rgb, places)
    cosine = slant[here] / np.linalg.norm(towards[here], axis=1)
    detail[here] = cosine * camera.fx / local[:, 2]
    within = ndimage.distance_transform_edt(np.pad(crop.mask, 1))[1:-1, 1:-1]
    trust[here] = np.clip((within[row, column] - _RIM_PX) / _FADE_PX, 0.01, 1.0)


def _sampled(image: NDArray[np.uint8], places: NDArray[np.float32]) -> NDArray[np.uint8]:
    import cv2

    # OpenCV takes no image of more than 32767 rows or columns.
    rows = -(-len(places) // _SAMPLES_A_ROW)
    grid = np.zeros((rows * _SAMPLES_A_ROW, 2), np.float32)
    grid[: len(places)] = places
    x, y = np.moveaxis(grid.reshape(rows, _SAMPLES_A_ROW, 2), 2, 0)
    sampled = cv2.remap(image, x, y, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
    return np.asarray(sampled.reshape(-1, 3)[: len(places)])


def _without_holes(crop: Crop) -> NDArray[np.float32]:
    # Small holes get the depth of the nearest pixel.
    is_missing = np.isnan(crop.depth_m)
    if is_missing.all():
        return crop.depth_m
    away, nearest = ndimage.distance_transform_edt(is_missing, return_indices=True)
    return np.where(away <= _HOLE_PX, crop.depth_m[tuple(nearest)], np.float32(np.nan))


_MOST_PLACES = 4000
_LEAST_SHARED = 20
_LEAST_TRUST = 0.3
# Black and white say nothing of the gain.
_DARK, _BRIGHT = 12.0, 245.0
_MOST_GAIN = 2.5
# What holds the gains near 1, in shared places.
_HOLD = 10.0


def gains_of(seen: Sightings) -> NDArray[np.float64]:
    """Return (V, 3) the gains of the views' colours, least squares of the logarithms.

    The ratio of two views is the median over the places that both show; a view that shares none keeps its colours.
    """
    count, places = seen.trust.shape
    some = slice(None, None, max(places // _MOST_PLACES, 1))
    colors = seen.colors[:, some]
    useful = (seen.trust[:, some] >= _LEAST_TRUST)[..., None] & (colors > _DARK) & (colors < _BRIGHT)
    logs = np.log(np.maximum(colors, 1.0)).astype(np.float64)
    normal = np.tile(np.eye(count)[..., None] * _HOLD, (1, 1, 3))
    wanted = np.zeros((count, 3))
    for i in range(count):
        for j in range(i + 1, count):
            for channel in range(3):
                both = useful[i, :, channel] & useful[j, :, channel]
                shared = float(both.sum())
                if shared < _LEAST_SHARED:
                    continue
                ratio = float(np.median(logs[j, both, channel] - logs[i, both, channel]))
                normal[i, i, channel] += shared
                normal[j, j, channel] += shared
                normal[i, j, channel] -= shared
                normal[j, i, channel] -= shared
                wanted[i, channel] += shared * ratio
                wanted[j, channel] -= shared * ratio
    logs_of_gains = np.stack([np.linalg.solve(normal[..., k], wanted[:, k]) for k in range(3)], axis=1)
    return np.exp(np.clip(logs_of_gains, -np.log(_MOST_GAIN), np.log(_MOST_GAIN)))


_FILLINGS = 400
# Where the trust of all views together is less, the plain colour shows through.
_FULL_TRUST = 0.25


@dataclass(frozen=True, kw_only=True, slots=True)
class TextureConfig(Ranged):
    """A texture has at most `most_px` on a side: a power of two, smaller where the views show less.

    A view shows a place within `reach_edges` of the mesh's mean edge, at least `min_reach_m`, of what it measured.
    Colours are weighted with the power `sharpness` of their pixels a metre.
    """

    most_px: int = number(DEFAULT_TEXTURE_PX, LEAST_TEXTURE_PX, MOST_TEXTURE_PX, "px")
    reach_edges: float = number(2.0, 0, 100, "edges")
    min_reach_m: float = number(0.01, 0, 1, "m")
    sharpness: int = number(6, 1, 16, "power")


def textured(
    mesh: Mesh, world_from_object: NDArray[np.float64], crops: Sequence[Crop], config: TextureConfig
) -> TexturedMesh:
    """Return a mesh, in its own frame, with a texture of what views show of it; the same inputs give the same bytes."""
    atlas = atlas_of(mesh.vertices, mesh.faces, _texel_m(mesh, crops, config), config.most_px)
    row, column = np.nonzero(atlas.owner >= 0)
    face = atlas.owner[row, column]
    weights = _barycentric(atlas.corners_px[face], np.stack([column + 0.5, row + 0.5], axis=1))
    normals = _vertex_normals(mesh)
    corners = mesh.faces[face]
    points = np.einsum("nk,nkc->nc", weights, mesh.vertices[corners].astype(np.float64))
    directions = np.einsum("nk,nkc->nc", weights, normals[corners])
    # Texels and vertices at once: what surrounds unseen surface is known at its vertices.
    points = apply(world_from_object, np.concatenate([points, mesh.vertices.astype(np.float64)]))
    directions = np.concatenate([directions, normals]) @ world_from_object[:3, :3].T
    directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-12)
    colors, trust = _blended(points, directions, crops, _reach_m(mesh, config), config.sharpness)
    count = len(face)
    plain = _filled(mesh, colors[count:], trust[count:])
    share = np.minimum(trust[:count] / _FULL_TRUST, 1.0)[:, None]
    below = np.einsum("nk,nkc->nc", weights, plain[corners])
    image = np.zeros((atlas.side_px, atlas.side_px, 3), np.uint8)
    image[row, column] = np.rint(share * colors[:count] + (1 - share) * below).clip(0, 255).astype(np.uint8)
    # Filtering reaches beyond the border of a chart.
    nearest = ndimage.distance_transform_edt(atlas.owner < 0, return_distances=False, return_indices=True)
    return _unwrapped(mesh, atlas, image[tuple(nearest)])


def _texel_m(mesh: Mesh, crops: Sequence[Crop], config: TextureConfig) -> float:
    # The side of a pixel on the object in the nearest view; a whole atlas without a view.
    finest = [
        float(np.median(crop.depth_m[crop.mask & np.isfinite(crop.depth_m)])) / crop.camera.fx
        for crop in crops
        if (crop.mask & np.isfinite(crop.depth_m)).any()
    ]
    return min(finest) if finest else max(float(np.ptp(mesh.vertices, axis=0).max()), 1e-6) / config.most_px


def _reach_m(mesh: Mesh, config: TextureConfig) -> float:
    ends = mesh.vertices[mesh.faces[:, :2]].astype(np.float64)
    edge = float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).mean())
    return max(config.reach_edges * edge, config.min_reach_m)


def _blended(
    points: NDArray[np.float64], normals: NDArray[np.float64], crops: Sequence[Crop], reach_m: float, sharpness: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    if not crops:
        return np.zeros((len(points), 3), np.float32), np.zeros(len(points), np.float32)
    seen = sightings(points, normals, crops, reach_m)
    gains = gains_of(seen)
    best = np.maximum(seen.detail.max(axis=0), 1e-9)
    weights = seen.trust * np.power(seen.detail / best, sharpness)
    even = seen.colors * gains[:, None, :].astype(np.float32)
    total = np.maximum(weights.sum(axis=0), 1e-12)
    return np.einsum("vn,vnc->nc", weights, even) / total[:, None], seen.trust.max(axis=0)


def _filled(mesh: Mesh, colors: NDArray[np.float32], trust: NDArray[np.float32]) -> NDArray[np.float64]:
    # Vertices that no view shows have the mean of the vertices around them.
    filled = np.where((trust > 0)[:, None], colors, mesh.colors).astype(np.float64)
    # What was seen keeps the colour that layer 2 has of it.
    unknown = ~mesh.is_seen & (trust <= 0)
    if not unknown.any() or unknown.all():
        return filled
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    edges = np.concatenate([edges, edges[:, ::-1]])
    edges = edges[unknown[edges[:, 0]]]
    number = np.cumsum(unknown) - 1
    size = (int(unknown.sum()), len(filled))
    around = csr_array((np.ones(len(edges)), (number[edges[:, 0]], edges[:, 1])), shape=size)
    degree = np.maximum(around.sum(axis=1), 1)[:, None]
    for _ in range(_FILLINGS):
        filled[unknown] = (around @ filled) / degree
    return filled


def _barycentric(corners: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.float64]:
    # (N, 3) weights of the corners (N, 3, 2) at places (N, 2).
    b, c, p = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], places - corners[:, 0]
    area = b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0]
    wb = (p[:, 0] * c[:, 1] - p[:, 1] * c[:, 0]) / area
    wc = (b[:, 0] * p[:, 1] - b[:, 1] * p[:, 0]) / area
    return np.stack([1 - wb - wc, wb, wc], axis=1)


def _vertex_normals(mesh: Mesh) -> NDArray[np.float64]:
    a, b, c = (mesh.vertices[mesh.faces[:, i]].astype(np.float64) for i in range(3))
    per_face = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    count = len(mesh.vertices)
    sums = [np.bincount(mesh.faces.reshape(-1), per_face[:, k], minlength=count) for k in range(3)]
    normals = np.stack(sums, axis=1)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300))


def _unwrapped(mesh: Mesh, atlas: Atlas, image: NDArray[np.uint8]) -> TexturedMesh:
    keys = mesh.faces.astype(np.int64) * (int(atlas.of_face.max()) + 1) + atlas.of_face[:, None]
    _, first, corner = np.unique(keys.reshape(-1), return_index=True, return_inverse=True)
    source = mesh.faces.reshape(-1)[first]
    return TexturedMesh(
        mesh=Mesh(
            vertices=mesh.vertices[source],
            faces=corner.reshape(-1, 3).astype(np.int32),
            colors=mesh.colors[source],
            is_seen=mesh.is_seen[source],
        ),
        uv=(atlas.corners_px.reshape(-1, 2)[first] / atlas.side_px).astype(np.float32),
        image=image,
        source=source,
    )
