"""Two aligned maps as a Rerun recording: overlaid, and one lifted above the other with a line per pair.

Map a is blue, map b orange, objects without a partner are pale. Overlaid maps are translucent, since their shared
surfaces nearly coincide.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.alignment.answer import Alignment, NoAlignment
from hickory_stream.alignment.object_map import ObjectMap
from hickory_stream.geometry.display import color_of_id
from hickory_stream.geometry.rigid import apply, from_rotation_translation
from hickory_stream.geometry.superquadric import moved
from hickory_stream.pictures.render_alignment import BLUE, ORANGE, alignment_meanings, pale
from hickory_stream.sinks.rerun.items import new_stream
from hickory_stream.sinks.rerun.piped_file import recorded_to

_GAP = 1.2
_ALPHA = 140


def write_alignment(path: Path, map_a: ObjectMap, map_b: ObjectMap, answer: Alignment | NoAlignment) -> None:
    """Write an .rrd; without an alignment map b stands beside map a. Raises `OSError` on a disk error."""
    import rerun as rr

    from hickory_stream.sinks.rerun.blueprint import side_by_side
    from hickory_stream.sinks.rerun.labels import WIDE_LEGEND_PX, legend_item

    stream = new_stream(f"alignment-{path.stem}")
    with recorded_to(path, stream):
        stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        if isinstance(answer, Alignment):
            views = _log_joined(stream, map_a, map_b, answer)
        else:
            b_from = _beside(map_a, map_b)
            _log_map(stream, "world/a", map_a, np.eye(4), BLUE, set(map_a.ids.tolist()), 255)
            _log_map(stream, "world/b", map_b, b_from, ORANGE, set(map_b.ids.tolist()), 255)
            corners = np.concatenate([_corners(map_a, np.eye(4)), _corners(map_b, b_from)])
            views = {"Not aligned": (["/world/**"], corners)}
        legend = legend_item(alignment_meanings(is_aligned=isinstance(answer, Alignment)), WIDE_LEGEND_PX)
        stream.log(legend.path, *legend.archetypes, static=True)
        stream.send_blueprint(side_by_side(views), make_active=True, make_default=True)


def _log_joined(
    stream: Any, map_a: ObjectMap, map_b: ObjectMap, answer: Alignment
) -> dict[str, tuple[list[str], NDArray[np.float64]]]:
    in_a, in_b = {pair.id_a for pair in answer.pairs}, {pair.id_b for pair in answer.pairs}
    corners_a, corners_b = _corners(map_a, np.eye(4)), _corners(map_b, answer.a_from_b)
    both = np.concatenate([corners_a, corners_b])
    # As high as shows both.
    lift_m = 0.4 * float(np.ptp(both[:, :2], axis=0).max()) + float(np.ptp(both[:, 2]))
    lifted = from_rotation_translation(np.eye(3), np.array([0.0, 0.0, lift_m])) @ answer.a_from_b
    _log_map(stream, "world/joined/a", map_a, np.eye(4), BLUE, in_a, _ALPHA)
    _log_map(stream, "world/joined/b", map_b, answer.a_from_b, ORANGE, in_b, _ALPHA)
    _log_map(stream, "world/apart/a", map_a, np.eye(4), BLUE, in_a, 255)
    _log_map(stream, "world/apart/b", map_b, lifted, ORANGE, in_b, 255)
    apart = np.concatenate([corners_a, _corners(map_b, lifted)])
    _log_pairs(stream, map_a, map_b, answer, lifted, apart)
    return {"Joined": (["/world/joined/**"], both), "Pairs: map b lifted off map a": (["/world/apart/**"], apart)}


def _log_pairs(
    stream: Any,
    map_a: ObjectMap,
    map_b: ObjectMap,
    answer: Alignment,
    lifted: NDArray[np.float64],
    in_view: NDArray[np.float64],
) -> None:
    import rerun as rr

    from hickory_stream.sinks.rerun.eye import SIDE_ASPECT, eye_on
    from hickory_stream.sinks.rerun.labels import label_items

    place_a = dict(zip(map_a.ids.tolist(), map_a.centroids, strict=True))
    place_b = dict(zip(map_b.ids.tolist(), apply(lifted, map_b.centroids), strict=True))
    box_b = dict(zip(map_b.ids.tolist(), map_b.boxes, strict=True))
    colors = {pair.id_a: color_of_id(pair.id_a) for pair in answer.pairs}
    texts = {pair.id_a: f"a{pair.id_a} = b{pair.id_b}" for pair in answer.pairs}
    ends = [[place_a[pair.id_a], place_b[pair.id_b]] for pair in answer.pairs]
    stream.log("world/apart/pairs", rr.LineStrips3D(ends, colors=list(colors.values()), radii=-1.0), static=True)
    boxes = {pair.id_a: apply(lifted, box_b[pair.id_b].corners_world()) for pair in answer.pairs}
    for item in label_items("world/apart/labels", boxes, texts, colors, eye_on(in_view, SIDE_ASPECT)):
        stream.log(item.path, *item.archetypes, static=True)


def _log_map(
    stream: Any,
    path: str,
    objects: ObjectMap,
    frame_from_map: NDArray[np.float64],
    color: tuple[int, int, int],
    matched: set[int],
    alpha: int,
) -> None:
    from hickory_stream.sinks.rerun.meshes import superquadric_mesh, wire_box

    for object_id, shape, box in zip(objects.ids.tolist(), objects.shapes, objects.boxes, strict=True):
        own = color if object_id in matched else pale(color)
        if shape is None:
            item = wire_box(frame_from_map @ box.world_from_box, box.half_extents_m, own)
        else:
            item = superquadric_mesh(moved(shape, frame_from_map), own, alpha=alpha, is_shaded=False)
        stream.log(f"{path}/{object_id}", item, static=True)


def _corners(objects: ObjectMap, frame_from_map: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (N, 3) corners of all boxes."""
    return np.concatenate([np.empty((0, 3)), *(apply(frame_from_map, b.corners_world()) for b in objects.boxes)])


def _beside(map_a: ObjectMap, map_b: ObjectMap) -> NDArray[np.float64]:
    pose = np.eye(4)
    if len(map_a) and len(map_b):
        pose[0, 3] = map_a.centroids[:, 0].max() - map_b.centroids[:, 0].min() + _GAP
    return pose
