"""A picture of two aligned maps: overlaid from above, and one lifted above the other.

Map a is blue, map b orange; objects without a partner are pale. Both ids of a pair have the colour of its
line; from above, only that of map a is shown. Without an alignment the maps stand side by side.
"""

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.alignment.answer import Alignment, NoAlignment
from hickory_stream.alignment.object_map import ObjectMap
from hickory_stream.geometry.display import color_of_id
from hickory_stream.geometry.rigid import apply, from_rotation_translation
from hickory_stream.geometry.superquadric import moved
from hickory_stream.geometry.superquadric_surface import display_mesh
from hickory_stream.pictures.labels import draw_labels, draw_scale, draw_title, flat_labels
from hickory_stream.pictures.legend import draw_legend
from hickory_stream.pictures.raycast import Surface
from hickory_stream.pictures.render_view import Model, draw_view, floor_around
from hickory_stream.pictures.viewpoint import Viewpoint, corners_of, from_above, from_corner

BLUE, ORANGE = (58, 118, 190), (238, 138, 48)
_PALE = 0.62
_TITLE_PX, _MARGIN_PX = 44, 40
_BOX_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]]
)  # fmt: skip


def render_alignment(
    map_a: ObjectMap, map_b: ObjectMap, answer: Alignment | NoAlignment, size: tuple[int, int] = (1600, 800)
) -> NDArray[np.uint8]:
    """Return an (H, W, 3) uint8 picture of two maps and their alignment; raises `ValueError` below 480 x 240 pixels."""
    width, height = size
    if width < 480 or height < 240:
        raise ValueError(f"a picture of an alignment has at least 480 x 240 pixels, found {width} x {height}")
    image = np.full((height, width, 3), 255, dtype=np.uint8)
    left = int(0.44 * width)
    if isinstance(answer, Alignment):
        _draw_joined(image[_TITLE_PX:], left, map_a, map_b, answer)
    else:
        _draw_apart(image[_TITLE_PX:], width // 2, map_a, map_b)
    draw_title(image[:_TITLE_PX], _title(map_a, map_b, answer))
    draw_legend(image, alignment_meanings(is_aligned=isinstance(answer, Alignment)))
    return image


def _draw_joined(image: NDArray[np.uint8], left: int, map_a: ObjectMap, map_b: ObjectMap, answer: Alignment) -> None:
    height, width = image.shape[:2]
    in_a, in_b = {pair.id_a for pair in answer.pairs}, {pair.id_b for pair in answer.pairs}
    bounds_a, bounds_b = _corners(map_a, np.eye(4)), _corners(map_b, answer.a_from_b)
    both = np.concatenate([bounds_a, bounds_b])
    floor = floor_around(both, float(both[:, 2].min()))
    # Overlaid: map b is translucent.
    over = Model(
        solid=_surfaces(map_a, np.eye(4), in_a, BLUE),
        translucent=_surfaces(map_b, answer.a_from_b, in_b, ORANGE),
        points=[],
        submaps=map_a.submaps,
        floor=floor,
    )
    above = from_above(both, left - 2, height, _MARGIN_PX)
    partner = {pair.id_b: pair.id_a for pair in answer.pairs}
    joined = draw_view(over, above)
    _draw_ids(joined, above, [("a", map_a, np.eye(4)), ("b", map_b, answer.a_from_b)], partner, is_once=True)
    draw_scale(joined, above.focal_px)
    image[:, : left - 2] = joined
    # Lifted: high enough to show both floors, with a line from each object to its partner.
    lift_m = 0.5 * float(np.ptp(both[:, :2], axis=0).max()) + float(np.ptp(both[:, 2]))
    lifted = from_rotation_translation(np.eye(3), np.array([0.0, 0.0, lift_m])) @ answer.a_from_b
    apart = Model(
        solid=_surfaces(map_a, np.eye(4), in_a, BLUE) + _surfaces(map_b, lifted, in_b, ORANGE),
        translucent=[],
        points=[],
        submaps=(),
        floor=floor,
    )
    scene = np.concatenate([bounds_a, _corners(map_b, lifted)])
    corner = from_corner(scene, np.deg2rad(-60.0), np.deg2rad(24.0), width - left, height, _MARGIN_PX)
    panel = draw_view(apart, corner)
    _draw_lines(panel, corner, map_a, map_b, answer, lifted)
    _draw_ids(panel, corner, [("a", map_a, np.eye(4)), ("b", map_b, lifted)], partner)
    image[:, left:] = panel


def _draw_lines(
    panel: NDArray[np.uint8],
    viewpoint: Viewpoint,
    map_a: ObjectMap,
    map_b: ObjectMap,
    answer: Alignment,
    lifted: NDArray[np.float64],
) -> None:
    import cv2

    place_a = {int(i): place for i, place in zip(map_a.ids, map_a.centroids, strict=True)}
    place_b = {int(i): place for i, place in zip(map_b.ids, map_b.centroids, strict=True)}
    lines = panel.copy()
    for pair in answer.pairs:
        ends = np.array([place_a[pair.id_a], apply(lifted, place_b[pair.id_b])])
        (x0, y0), (x1, y1) = np.round(viewpoint.project(ends)).astype(int).tolist()
        color = color_of_id(pair.id_a)
        cv2.line(lines, (x0, y0), (x1, y1), color, 2, cv2.LINE_AA)
        for x, y in ((x0, y0), (x1, y1)):
            cv2.circle(lines, (x, y), 4, (255, 255, 255), cv2.FILLED, cv2.LINE_AA)
            cv2.circle(lines, (x, y), 3, color, cv2.FILLED, cv2.LINE_AA)
    cv2.addWeighted(lines, 0.8, panel, 0.2, 0.0, dst=panel)


def _draw_ids(
    image: NDArray[np.uint8],
    viewpoint: Viewpoint,
    shown: Sequence[tuple[str, ObjectMap, NDArray[np.float64]]],
    partner: Mapping[int, int],
    *,
    is_once: bool = False,
) -> None:
    """Label the objects of maps, each by its letter and its place; `is_once` leaves out those of b with a partner."""
    import cv2

    outlines: dict[int, list[NDArray[np.float32]]] = {}
    texts, colors = {}, {}
    for letter, objects, frame_from_map in shown:
        for object_id, box in zip(objects.ids.tolist(), objects.boxes, strict=True):
            if is_once and letter == "b" and object_id in partner:
                continue
            label = len(outlines)
            corners = viewpoint.project(apply(frame_from_map, box.corners_world()))
            outlines[label] = [cv2.convexHull(corners.astype(np.float32))[:, 0]]
            texts[label] = f"{letter}{object_id}"
            colors[label] = color_of_id(partner.get(object_id, object_id) if letter == "b" else object_id)
    draw_labels(image, flat_labels(outlines, (image.shape[1], image.shape[0]), texts), colors)


def _draw_apart(image: NDArray[np.uint8], middle: int, map_a: ObjectMap, map_b: ObjectMap) -> None:
    height, width = image.shape[:2]
    for objects, color, x0, x1 in ((map_a, BLUE, 0, middle - 1), (map_b, ORANGE, middle + 1, width)):
        corners = _corners(objects, np.eye(4))
        every = {int(i) for i in objects.ids}
        model = Model(
            solid=_surfaces(objects, np.eye(4), every, color),
            translucent=[],
            points=[],
            submaps=objects.submaps,
            floor=floor_around(corners, float(corners[:, 2].min())),
        )
        above = from_above(corners, x1 - x0, height, _MARGIN_PX)
        panel = draw_view(model, above)
        _draw_ids(panel, above, [("a" if objects is map_a else "b", objects, np.eye(4))], {})
        draw_scale(panel, above.focal_px)
        image[:, x0:x1] = panel


def _surfaces(
    objects: ObjectMap, frame_from_map: NDArray[np.float64], matched: AbstractSet[int], color: tuple[int, int, int]
) -> list[Surface]:
    """Return layer 3 of every object, or its box if it has none."""
    surfaces = []
    for object_id, shape, box in zip(objects.ids, objects.shapes, objects.boxes, strict=True):
        own = color if int(object_id) in matched else pale(color)
        if shape is None:
            parts: list[tuple[NDArray[Any], NDArray[Any]]] = [(apply(frame_from_map, box.corners_world()), _BOX_FACES)]
        else:
            placed = moved(shape, frame_from_map)
            parts = [display_mesh(placed, i) for i in range(len(placed))]
        for vertices, faces in parts:
            colors = np.tile(np.array(own, dtype=np.uint8), (len(vertices), 1))
            surfaces.append(Surface(vertices=vertices, faces=faces, colors=colors, owner=int(object_id)))
    return surfaces


def alignment_meanings(*, is_aligned: bool) -> list[tuple[str, tuple[int, int, int]]]:
    """Return the texts and colours of a legend."""
    entries = [("map a", BLUE), ("map b", ORANGE)]
    alone = [("of a without a partner", pale(BLUE)), ("of b without a partner", pale(ORANGE))]
    return entries + alone if is_aligned else entries


def pale(color: tuple[int, int, int]) -> tuple[int, int, int]:
    """Return the colour of an object without a partner."""
    r, g, b = (round(c + (225 - c) * _PALE) for c in color)
    return r, g, b


def _corners(objects: ObjectMap, frame_from_map: NDArray[np.float64]) -> NDArray[np.float64]:
    corners = corners_of(objects.boxes)
    return np.asarray(apply(frame_from_map, corners)) if len(objects) else corners


def _title(map_a: ObjectMap, map_b: ObjectMap, answer: Alignment | NoAlignment) -> str:
    sizes = f"a (blue) {len(map_a)} objects, b (orange) {len(map_b)}"
    if isinstance(answer, Alignment):
        sigma = f"+-{100 * answer.translation_sigma_m:.1f} cm, +-{np.degrees(answer.rotation_sigma_rad):.2f} deg"
        return f"{sizes}    {len(answer.pairs)} pairs    {sigma}    chance 1e{answer.log10_chance:.0f}"
    return f"{sizes}    not aligned: {answer.refusal.value}"
