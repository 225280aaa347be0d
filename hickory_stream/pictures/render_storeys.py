"""The storeys of a map side by side: from above only the top of a building is visible."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.records import MapSnapshot, Phase, TrackedObject
from hickory_stream.storeys import floors_of, on_storey

MARGIN_PX = 46
MOST_STOREYS = 6
"""More would be too small to see anything; `--floor` draws any of them."""
_GAP_PX = 2
# The view from above takes at least, and at most, this share of the width, where the other one is beside it.
_NARROWEST, _WIDEST = 0.34, 0.46
# Of several storeys, so much of a view's shorter side is margin at most.
_MOST_MARGIN = 0.12


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Storey:
    """The objects of the storey of a floor; `floor_m` None is the lowest of the map."""

    floor_m: float | None
    objects: list[TrackedObject]


@dataclass(frozen=True, kw_only=True, slots=True)
class Place:
    """A rectangle of a picture in pixels, (x, y) its upper left corner, and the margin inside."""

    x: int
    y: int
    width: int
    height: int
    margin_px: int = MARGIN_PX

    def of(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return this part of a picture as a view."""
        return image[self.y : self.y + self.height, self.x : self.x + self.width]


def storeys_to_draw(snapshot: MapSnapshot, floor_m: float | None) -> list[Storey]:
    """Return the storey of a floor, or the `MOST_STOREYS` with most objects, lowest first, without tentative tracks."""
    floors_m = floors_of(snapshot)
    if floor_m is None and len(floors_m) < 2:
        return [Storey(floor_m=None, objects=_shown(snapshot.objects))]
    if floor_m is not None:
        return [Storey(floor_m=floor_m, objects=_shown(on_storey(snapshot, floor_m).objects))]
    on_floors = [on_storey(snapshot, floor).objects for floor in floors_m]
    higher = {tracked.id for on_one in on_floors[1:] for tracked in on_one}
    lowest = {tracked.id for tracked in on_floors[0]}
    # What lies below all floors, by noise or in a pit, is nowhere else to be seen.
    on_floors[0] = tuple(item for item in snapshot.objects if item.id in lowest or item.id not in higher)
    storeys = [Storey(floor_m=floor, objects=_shown(on_one)) for floor, on_one in zip(floors_m, on_floors, strict=True)]
    fullest = sorted(range(len(storeys)), key=lambda i: (-len(storeys[i].objects), i))[:MOST_STOREYS]
    return [storeys[i] for i in sorted(fullest)]


def _shown(objects: tuple[TrackedObject, ...]) -> list[TrackedObject]:
    return [tracked for tracked in objects if tracked.phase != Phase.TENTATIVE]


def places_of(count: int, width: int, height: int, extent_m: NDArray[np.float64]) -> list[tuple[Place, Place]]:
    """Return the places of each storey, from above and from a corner, in a picture.

    Up to three are in one row, more in two. The two views are beside or above each other, whichever is larger for the
    horizontal extent (2,).
    """
    rows = 1 if count <= 3 else 2
    columns = -(-count // rows)
    cell_width = (width - _GAP_PX * (columns - 1)) // columns
    cell_height = (height - _GAP_PX * (rows - 1)) // rows
    cells = [
        Place(x=column * (cell_width + _GAP_PX), y=row * (cell_height + _GAP_PX), width=cell_width, height=cell_height)
        for row, column in (divmod(i, columns) for i in range(count))
    ]
    return [_views_in(cell, extent_m, is_only=count == 1) for cell in cells]


def _views_in(cell: Place, extent_m: NDArray[np.float64], *, is_only: bool) -> tuple[Place, Place]:
    beside, stacked = _beside(cell, extent_m, is_only=is_only), _stacked(cell)
    if is_only or _scale(beside[0], extent_m) >= _scale(stacked[0], extent_m):
        return beside
    return stacked


def _beside(cell: Place, extent_m: NDArray[np.float64], *, is_only: bool) -> tuple[Place, Place]:
    margin_px = MARGIN_PX if is_only else _margin_px(min(int(_NARROWEST * cell.width), cell.height))
    wanted = (cell.height - 2 * margin_px) * extent_m[0] / extent_m[1] + 2 * margin_px
    left = int(np.clip(wanted, _NARROWEST * cell.width, _WIDEST * cell.width))
    rest = cell.width - left - _GAP_PX
    return (
        Place(x=cell.x, y=cell.y, width=left, height=cell.height, margin_px=margin_px),
        Place(x=cell.x + left + _GAP_PX, y=cell.y, width=rest, height=cell.height, margin_px=margin_px),
    )


def _stacked(cell: Place) -> tuple[Place, Place]:
    upper = (cell.height - _GAP_PX) // 2
    lower = cell.height - upper - _GAP_PX
    margin_px = _margin_px(min(cell.width, upper))
    return (
        Place(x=cell.x, y=cell.y, width=cell.width, height=upper, margin_px=margin_px),
        Place(x=cell.x, y=cell.y + upper + _GAP_PX, width=cell.width, height=lower, margin_px=margin_px),
    )


def _margin_px(side_px: int) -> int:
    return min(MARGIN_PX, int(_MOST_MARGIN * side_px))


def _scale(place: Place, extent_m: NDArray[np.float64]) -> float:
    room = np.array([place.width, place.height]) - 2 * place.margin_px
    return float((room / extent_m).min())
