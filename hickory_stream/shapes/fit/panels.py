"""Thin things as thin superquadrics: carpets, rods, panels, curved sheets, of which a grid sees little or nothing.

Triangles are grouped by closed body, then the group is halved whose halves, each in its principal box, save most
volume. A group gets the least box, cylinder or fitted superquadric in the frame of its normals. A sheet of volume V and
area A is about 2 V / A thick, and so are its panels; a bent one is cut further, until its panels are nearly flat.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry import portable
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.geometry.superquadric import Superquadrics, joined, moved, volumes_m3
from hickory_stream.shapes.connected import joined_faces
from hickory_stream.shapes.fit.bounding_superquadric import around_all, surface_samples
from hickory_stream.shapes.fit.canonical_frame import object_axes
from hickory_stream.shapes.fit.quadric_lm import rows_in
from hickory_stream.shapes.fit.surface_partition import owned_pieces

# A sheet is this many times wider than thick; its panel may be so much thicker before it is called bent.
_SHEET = 4.0
_BENT = 1.3
# Where a group may be cut, in shares of its corners, and the share of all boxes' volume that halves must save.
_CUTS = (0.25, 0.5, 0.75)
_LEAST_GAIN = 0.03
# A bent sheet is cut where that saves this share of its own box, which is bent by about a third of its thickness then.
_LEAST_OF_BENT = 0.2
_SAMPLES = 1000
# Of loose surface: how many parts a group is cut into at most, and the share of its area that may face to one side.
_MOST_LOOSE = 6
_ONE_SIDED = 0.3
_HEIGHTS = 50


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Panels:
    """Primitives around all of a mesh, but for the bends of sheets."""

    primitives: Superquadrics
    #: before bent ones were made thin, when they contained the mesh
    volume_m3: float
    #: the intersection over union as far as panels do not overlap; 0 where the mesh is not closed
    share: float


def panels(vertices: NDArray[np.float64], faces: NDArray[np.int32], *, most: int, min_size_m: float) -> Panels:
    """Return up to `most` primitives around a mesh, twice as many for bent sheets, none thinner than `min_size_m`."""
    body_of_face, volumes, areas = _bodies(vertices, faces)
    groups = [np.flatnonzero(body_of_face == body) for body in range(len(volumes))]
    if len(groups) > most:
        groups = [np.arange(len(faces))]
        body_of_face, volumes, areas = (
            np.zeros(len(faces), np.int64),
            volumes.sum(keepdims=True),
            areas.sum(keepdims=True),
        )
    thicknesses = np.maximum(2 * volumes / np.maximum(areas, 1e-300), min_size_m)
    corners = _outward(vertices[faces])
    parts = _cut(
        [_Part.of(group, corners, float(thicknesses[body_of_face[group[0]]])) for group in groups], corners, most
    )
    around = [_around(vertices, faces[part.items], part.thickness) for part in parts]
    thinned = [_thinned(one, corners[part.items], part.thickness) for one, part in zip(around, parts, strict=True)]
    primitives = joined([one for one, _ in thinned])
    sizes = np.array([areas_of(corners[part.items]).sum() for part in parts])
    solid, taken = float(volumes.sum()), float(volumes_m3(primitives).sum())
    held = solid * float((sizes * [share for _, share in thinned]).sum()) / max(float(sizes.sum()), 1e-300)
    return Panels(
        primitives=primitives,
        volume_m3=float(sum(volumes_m3(one).sum() for one in around)),
        share=min(held, taken) / (solid + taken - min(held, taken)),
    )


def loose_panels(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], *, least_area: float, min_size_m: float, thin_m: float
) -> list[tuple[Superquadrics, float]]:
    """Return primitives around (F, 3) faces that are part of a surface, and the area of each in square metres.

    Groups of connected faces that face all round and are at most about `thin_m` thick are halved where that saves most;
    groups below `least_area` are left out.
    """
    corners = vertices[faces]
    areas = areas_of(corners)
    if areas.sum() < least_area:
        return []
    places, welded = _welded(corners.reshape(-1, 3))
    faces = welded.reshape(-1, 3).astype(np.int32)
    body, volumes, area_of_body = _joined(places, faces, closed_only=False)
    sides = [np.bincount(body, along) for along in (_normals(corners) * areas[:, None]).T]
    is_round = np.linalg.norm(sides, axis=0) <= _ONE_SIDED * area_of_body
    found = []
    for n in np.flatnonzero(is_round & (area_of_body >= least_area)):
        thickness = max(2 * float(volumes[n] / area_of_body[n]), min_size_m)
        if thickness > thin_m:
            continue
        parts = _cut([_Part.of(np.flatnonzero(body == n), corners, thickness)], corners, _MOST_LOOSE)
        found += [
            (_around(places, faces[part.items], min_size_m), float(areas[part.items].sum()))
            for part in parts
            if areas[part.items].sum() >= least_area
        ]
    return found


def sheet_thickness(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> float:
    """Return how thick (V, 3) vertices with (F, 3) faces are if they are sheets; infinity where some are not closed."""
    _, volumes, areas = _bodies(vertices, faces)
    return float(2 * volumes.sum() / areas.sum()) if (volumes > 0).all() and len(volumes) else np.inf


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Part:
    # Triangles `items` (N,); `is_bent`: their box is that of a sheet, but thicker than the sheet.
    items: NDArray[np.int64]
    thickness: float
    volume: float
    halves: tuple[NDArray[np.int64], ...]
    gain: float
    is_bent: bool

    def is_worth_cutting(self, total: float, *, has_room: bool) -> bool:
        """Return whether halves save enough of all boxes' volume, or, of a bent sheet, of its own."""
        of_all = has_room and self.gain > _LEAST_GAIN * total
        return of_all or (self.is_bent and self.gain > _LEAST_OF_BENT * self.volume)

    @classmethod
    def of(cls, items: NDArray[np.int64], corners: NDArray[np.float64], thickness: float) -> "_Part":
        points = corners[items]
        extents, axes = _box(points, thickness)
        volume = float(extents.prod())
        local = portable.matmul(points.reshape(-1, 3), axes).reshape(-1, 3, 3)
        halves: tuple[NDArray[np.int64], ...] = ()
        least = np.inf
        for along in local[:, :, 1:].transpose(2, 0, 1) if len(items) > 1 else ():
            middles, places = along.mean(axis=1), np.sort(along, axis=None)
            for share in _CUTS:
                # At a corner, so that the triangles of one flat face stay together.
                is_first = middles < places[int(share * len(places))]
                if is_first.any() and not is_first.all():
                    both = sum(float(_box(points[side], thickness)[0].prod()) for side in (is_first, ~is_first))
                    if both < least:
                        halves, least = (items[is_first], items[~is_first]), both
        return cls(
            items=items,
            thickness=thickness,
            volume=volume,
            halves=halves,
            gain=volume - least,
            is_bent=_is_bent(np.sort(extents - thickness), thickness),
        )


def _outward(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    a, b, c = corners.transpose(1, 0, 2)
    return corners if (a * np.cross(b, c)).sum() >= 0 else np.ascontiguousarray(corners[:, ::-1])


def areas_of(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (N,) areas of (N, 3, 3) triangles."""
    return np.asarray(
        np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    )


def _is_bent(extents: NDArray[np.float64], thickness: float) -> bool:
    return bool(extents[0] > _BENT * thickness and extents[1] >= _SHEET * thickness)


def _box(corners: NDArray[np.float64], thickness: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # Larger by the thickness, so that the two sides of a panel are not worth a box each; the longest axis last.
    points = corners.reshape(-1, 3)
    # NumPy is slow along short rows.
    off = (points - portable.matmul(np.ones(len(points)), points) / len(points)).T.copy()
    axes = portable.eigh(portable.matmul(off, off.T))[1]
    along = portable.matmul(axes.T, off)
    return along.max(axis=1) - along.min(axis=1) + thickness, axes


def _cut(parts: list[_Part], corners: NDArray[np.float64], most: int) -> list[_Part]:
    parts = list(parts)
    while len(parts) < 2 * most:
        total = sum(part.volume for part in parts)
        gains = [part.gain if part.is_worth_cutting(total, has_room=len(parts) < most) else 0.0 for part in parts]
        at = int(np.argmax(gains))
        if gains[at] == 0.0:
            break
        part = parts.pop(at)
        parts += [_Part.of(half, corners, part.thickness) for half in part.halves]
    return parts


def _bodies(
    vertices: NDArray[np.float64], faces: NDArray[np.int32]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    # The body (F,) of each face, volumes and areas (B,); an open body has no volume.
    found = _joined(vertices, faces)
    if (found[1] > 0).all():
        return found
    # Vertices may be apart for the sake of normals or texture.
    places, welded = _welded(vertices)
    return _joined(places, welded[faces])


def _welded(vertices: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    # Distinct vertices, and (V,) which of them each is.
    # As one number each: NumPy sorts rows ten times as slowly.
    key = np.zeros(len(vertices), np.int64)
    for along in vertices.T:
        values, place = np.unique(along, return_inverse=True)
        _, key = np.unique(key * len(values) + place, return_inverse=True)
    _, first, welded = np.unique(key, return_index=True, return_inverse=True)
    return vertices[first], welded


def _joined(
    places: NDArray[np.float64], faces: NDArray[np.integer], *, closed_only: bool = True
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    piece, is_open_face = joined_faces(np.ascontiguousarray(faces, np.int64), len(places))
    _, body = np.unique(piece, return_inverse=True)
    is_open = np.zeros(body.max() + 1, bool)
    is_open[body[is_open_face]] = True
    corners = places[faces]
    if not closed_only:
        # About the middle of each body, where what is open lacks least.
        counts = np.maximum(np.bincount(body), 1)
        means = np.stack([np.bincount(body, along) / counts for along in corners.mean(axis=1).T], axis=1)
        corners = corners - means[body][:, None]
    a, b, c = corners.transpose(1, 0, 2)
    doubled = np.cross(b - a, c - a)
    volumes = np.abs(np.bincount(body, (a * doubled).sum(axis=1))) / 6
    if closed_only:
        volumes = np.where(is_open, 0.0, volumes)
    return body, volumes, np.bincount(body, np.linalg.norm(doubled, axis=1)) / 2


def _around(vertices: NDArray[np.float64], faces: NDArray[np.int32], min_size_m: float) -> Superquadrics:
    used, own = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[used], own.reshape(-1, 3).astype(np.int32)
    axes = object_axes(vertices, faces)
    one = around_all(portable.matmul(vertices, axes), faces, min_size_m)
    return moved(one, from_rotation_translation(axes, np.zeros(3)))


def _thinned(one: Superquadrics, corners: NDArray[np.float64], thickness: float) -> tuple[Superquadrics, float]:
    # As thick as the bent sheet, where it holds most of its middle; `corners` (N, 3, 3) face outwards. Also the share
    # held.
    order = np.argsort(one.semi_axes_m[0], kind="stable")
    if not _is_bent(2 * one.semi_axes_m[0, order], thickness):
        return one, 1.0
    axis = one.world_from_local[0, :3, order[0]]
    # The sheet's middle is half its thickness below its surface.
    middles = surface_samples(corners - thickness / 2 * _normals(corners)[:, None], _SAMPLES)
    heights = np.sort(portable.matmul(middles - one.world_from_local[0, :3, 3], axis))
    tried = heights[:: max(len(heights) // _HEIGHTS, 1)]
    held = np.maximum(1 - np.abs(heights - tried[:, None]) / thickness, 0).mean(axis=1)
    best = int(np.argmax(held))
    pose, semi_axes = one.world_from_local.copy(), one.semi_axes_m.copy()
    pose[0, :3, 3] += axis * tried[best]
    semi_axes[0, order[0]] = thickness / 2
    thin = Superquadrics(exponents=one.exponents, semi_axes_m=semi_axes, world_from_local=pose)
    return thin, float(held[best])


def _normals(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(doubled / np.maximum(np.linalg.norm(doubled, axis=1, keepdims=True), 1e-300))


# In cells: how far outside a surface is left out, how fine it is divided, and how thick a thin part is at most.
_OUTSIDE, _PIECE, _THIN = 1.5, 3.0, 3.0
# The surface of a part over that of its box.
_ROUND = (0.7, 1.4)


def with_thin_parts(
    primitives: Superquadrics,
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    *,
    step_m: float,
    most: int,
    least_area: float,
) -> Superquadrics:
    """Return the primitives, and up to `most` in all with thin parts that the fit left out, such as a bin's rim.

    The surface outside of all primitives is cut like thin bodies. A part is a few cells thick, and its surface goes
    once around its box: a bulge's lies on one side, a pipe's goes round twice.
    `step_m` is the side of the fit's cells; a part has at least the share `least_area` of the surface.
    """
    rows = rows_in(primitives, step_m, np.zeros(3))
    points, pieces, _, distances = owned_pieces(vertices / step_m, faces.astype(np.int64), rows, _OUTSIDE, _PIECE)
    out = pieces[distances > _OUTSIDE].astype(np.int32)
    if len(out) == 0 or len(primitives) >= most:
        return primitives
    total = float(areas_of(vertices[faces]).sum())
    found = []
    for panel, area_m2 in loose_panels(
        points * step_m, out, least_area=least_area * total, min_size_m=0.1 * step_m, thin_m=_THIN * step_m
    ):
        sides = 2 * panel.semi_axes_m[0]
        around = 2 * (sides[0] * sides[1] + sides[1] * sides[2] + sides[2] * sides[0])
        if sides.min() <= _THIN * step_m and _ROUND[0] <= area_m2 / around <= _ROUND[1]:
            found.append((area_m2, panel))
    found.sort(key=lambda one: -one[0])
    return joined([primitives, *(panel for _, panel in found[: most - len(primitives)])])
