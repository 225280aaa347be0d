"""A picture of a map without a screen: from above and from a raised corner, layers selectable.

The corner is the one of eight from which the objects occlude one another least.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry.display import color_of_id
from hickory_stream.pictures.labels import (
    Label,
    draw_caption,
    draw_labels,
    draw_scale,
    draw_title,
    most_visible,
    place_labels,
)
from hickory_stream.pictures.legend import FIXTURE, FIXTURE_TEXT, GENERATED, GENERATED_TEXT, draw_legend
from hickory_stream.pictures.rasterize import Dots, first_hits
from hickory_stream.pictures.render_parts import dots_of, ground_points, mesh_surface, superquadric_surfaces
from hickory_stream.pictures.render_storeys import Place, Storey, places_of, storeys_to_draw
from hickory_stream.pictures.render_view import Floor, Model, draw_view, floor_around
from hickory_stream.pictures.viewpoint import Viewpoint, corners_of, from_above, from_corner
from hickory_stream.records import number_of_kinds
from hickory_stream.storeys import floors_of

if TYPE_CHECKING:
    from collections.abc import Set as AbstractSet

    from numpy.typing import NDArray

    from hickory_stream.map_folder.saved_map import SavedMap
    from hickory_stream.pictures.raycast import Surface
    from hickory_stream.records import TrackedObject

_TITLE_PX = 44
_ELEVATION_RAD = np.deg2rad(38.0)
_LABEL_STEP_PX = 3


def render_map(
    saved: SavedMap, layers: AbstractSet[int], size: tuple[int, int], texture_px: int = 0, floor_m: float | None = None
) -> NDArray[np.uint8]:
    """Return an (H, W, 3) uint8 picture of a map: from above on the left, from a corner on the right.

    Storeys are side by side, at most `MOST_STOREYS`.

    Args:
        saved: the map; tentative tracks are not drawn.
        layers: of 1 to 4; an object without a shape is drawn as points.
        size: (W, H) in pixels, at least (480, 240).
        texture_px: the largest side of a texture of layer 2, 0 for vertex colours.
        floor_m: draw only the storey of this floor.

    Raises:
        MapFolderError: a mesh or a view cannot be read.
        ValueError: the size or a layer is out of range.
    """
    width, height = size
    if width < 480 or height < 240:
        raise ValueError(f"a picture of a map has at least 480 x 240 pixels, found {width} x {height}")
    if not layers or not set(layers) <= {1, 2, 3, 4}:
        raise ValueError(f"layers are among 1, 2, 3 and 4, found {sorted(layers)}")
    storeys = storeys_to_draw(saved.snapshot, floor_m)
    image = np.full((height, width, 3), 255, dtype=np.uint8)
    below = image[_TITLE_PX:]
    # From above all storeys have one place and one scale, so that stairs and walls are above one another.
    around = _corners([tracked for storey in storeys for tracked in storey.objects])
    extent_m = np.maximum(np.ptp(around[:, :2], axis=0), 0.5)
    places = places_of(len(storeys), width, height - _TITLE_PX, extent_m)
    azimuth_rad: float | None = None
    # The fullest one first: from where it is seen best, all are seen.
    for i in sorted(range(len(storeys)), key=lambda i: (-len(storeys[i].objects), i)):
        storey, (above, corner) = storeys[i], places[i]
        dots = [dots_of(tracked) for tracked in storey.objects]
        corners = _corners(storey.objects)
        if azimuth_rad is None:
            azimuth_rad = _best_azimuth(dots, corners, corner)
        model = _model(saved, storey, dots, layers, texture_px)
        from_here = from_above(around, above.width, above.height, above.margin_px)
        from_there = from_corner(corners, azimuth_rad, _ELEVATION_RAD, corner.width, corner.height, corner.margin_px)
        above.of(below)[:] = _panel(model, from_here, storey.objects, dots)
        corner.of(below)[:] = _panel(model, from_there, storey.objects, dots)
        draw_scale(above.of(below), from_here.focal_px)
        if len(storeys) > 1:
            draw_caption(above.of(below), f"floor at {storey.floor_m:.2f} m: {len(storey.objects)} objects")
    draw_title(image[:_TITLE_PX], _title(saved, storeys, layers))
    entries = [(FIXTURE_TEXT, FIXTURE)] * any(tracked.is_fixture for one in storeys for tracked in one.objects)
    if entries := [*entries, *([(GENERATED_TEXT, GENERATED)] * (2 in layers))]:
        draw_legend(image, entries)
    return image


# ---- what to draw ---------------------------------------------------------------------------------------------------


def _model(saved: SavedMap, storey: Storey, dots: list[Dots], layers: AbstractSet[int], texture_px: int) -> Model:
    solid, translucent = _surfaces(saved, storey.objects, layers, texture_px)
    return Model(
        solid=solid,
        points=[one for one, tracked in zip(dots, storey.objects, strict=True) if 1 in layers or tracked.shape is None],
        translucent=translucent,
        submaps=saved.snapshot.submaps,
        floor=_floor_of(saved, storey.objects, storey.floor_m),
    )


def _surfaces(
    saved: SavedMap, objects: list[TrackedObject], layers: AbstractSet[int], texture_px: int
) -> tuple[list[Surface], list[Surface]]:
    """Return the opaque and the translucent surfaces of the layers 2 to 4."""
    solid: list[Surface] = []
    translucent: list[Surface] = []
    for tracked in objects:
        if tracked.shape is None:
            if 3 in layers and tracked.sketch is not None:
                translucent.extend(superquadric_surfaces(tracked.sketch, tracked.id, is_fixture=tracked.is_fixture))
            continue
        if 2 in layers:
            solid.append(mesh_surface(saved, tracked, texture_px))
        if 3 in layers:
            (translucent if 2 in layers else solid).extend(
                superquadric_surfaces(tracked.shape.fitted, tracked.id, is_fixture=tracked.is_fixture)
            )
        if 4 in layers:
            translucent.extend(superquadric_surfaces(tracked.shape.inflated, tracked.id, is_fixture=tracked.is_fixture))
    return solid, translucent


def _corners(objects: list[TrackedObject]) -> NDArray[np.float64]:
    return corners_of([tracked.box for tracked in objects])


def _floor_of(saved: SavedMap, objects: list[TrackedObject], floor_m: float | None) -> Floor:
    corners = _corners(objects)
    heights = [floor_m] if floor_m is not None else floors_of(saved.snapshot)
    z_m = next(iter(heights), float(corners[:, 2].min()))
    seen = [ground_points(submap, z_m) for submap in saved.snapshot.submaps]
    return floor_around(corners, z_m, np.concatenate([np.empty((0, 3)), *seen]))


def _best_azimuth(dots: list[Dots], corners: NDArray[np.float64], place: Place) -> float:
    small = (place.width // 8, place.height // 8, place.margin_px // 8)

    def visibility(azimuth: float) -> float:
        viewpoint = from_corner(corners, azimuth, _ELEVATION_RAD, *small)
        owners = first_hits([], dots, viewpoint)[0].owners
        _, counts = np.unique(owners[owners >= 0], return_counts=True)
        return float(np.log1p(counts).sum())

    return float(max(np.deg2rad(np.arange(8) * 45.0 + 25.0), key=visibility))


def _title(saved: SavedMap, storeys: list[Storey], layers: AbstractSet[int]) -> str:
    # What reaches through a ceiling is in two storeys.
    objects = list({tracked.id: tracked for storey in storeys for tracked in storey.objects}.values())
    shapes = [tracked.shape for tracked in objects if tracked.shape]
    sketched = sum(tracked.sketch is not None for tracked in objects)
    counts = {
        1: f"{sum(len(tracked.points_world) for tracked in objects):,} points",
        2: f"{len(shapes)} meshes",
        3: f"{sum(len(shape.fitted) for shape in shapes)} superquadrics"
        + (f" and {sketched} from points" if sketched else ""),
        4: f"{sum(len(shape.inflated) for shape in shapes)} inflated",
    }
    name = str(saved.manifest.source.get("uri", saved.folder.name)).rstrip("/").rsplit("/", maxsplit=1)[-1]
    shown = "  ".join(f"{layer}: {counts[layer]}" for layer in sorted(layers))
    num_floors = len(floors_of(saved.snapshot))
    of_all = f" of {num_floors}, --floor draws one" if num_floors > len(storeys) else ""
    text = f"    {len(storeys)} storeys{of_all}" if len(storeys) > 1 else ""
    return f"{name}    {number_of_kinds(objects)}{text}    layer {shown}"


# ---- one panel ------------------------------------------------------------------------------------------------------


def _panel(model: Model, viewpoint: Viewpoint, objects: list[TrackedObject], dots: list[Dots]) -> NDArray[np.uint8]:
    """Return the (H, W, 3) picture from one viewpoint, with labels."""
    drawn = draw_view(model, viewpoint)
    colors = {tracked.id: color_of_id(tracked.id, is_fixture=True) for tracked in objects if tracked.is_fixture}
    draw_labels(drawn, labels_of(viewpoint, objects, dots), colors)
    return drawn


def labels_of(viewpoint: Viewpoint, objects: list[TrackedObject], dots: list[Dots]) -> list[Label]:
    """Return the labels of objects as seen from a viewpoint, of the most visible ones if all would hide the map."""
    columns, rows = viewpoint.width // _LABEL_STEP_PX, viewpoint.height // _LABEL_STEP_PX
    owners = first_hits([], dots, viewpoint, step_px=_LABEL_STEP_PX)[0].owners.reshape(rows, columns)
    chosen = set(most_visible([tracked.id for tracked in objects], owners, _LABEL_STEP_PX))
    labelled = [tracked for tracked in objects if tracked.id in chosen]
    hidden = np.array([viewpoint.project(tracked.box.center[None])[0] for tracked in labelled]).reshape(-1, 2)
    return place_labels([tracked.id for tracked in labelled], owners, _LABEL_STEP_PX, hidden)
