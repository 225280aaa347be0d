"""The four layers of every object, logged when they change.

Entities are layer first (`world/layer2/7`): one switch in the viewer's tree then hides a layer of the whole map.
"""

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from hickory_stream.errors import MapFolderError
from hickory_stream.geometry.display import color_of_id, shaded
from hickory_stream.geometry.rigid import compose, invert, quaternion_from_rotation
from hickory_stream.geometry.superquadric import Superquadrics
from hickory_stream.records import ObjectShape, Phase, TrackedObject, kind_text
from hickory_stream.sinks.rerun.items import LogItem, Span, Weight, clear_item, pose_item
from hickory_stream.sinks.rerun.meshes import placed_mesh, superquadric_mesh, textured_layer2

LAYERS = ("world/layer1", "world/layer2", "world/layer3", "world/layer4")
POINTS_LAYER, MESH_LAYER, FITTED_LAYER, INFLATED_LAYER = LAYERS
# Filled boxes; the layout hides them, since they veil their content.
FILLED = "world/filled"
_INFLATED_ALPHA = 96
# Sketches are drawn as lightly.
_SKETCH_ALPHA = 112
_FADED = {Phase.TENTATIVE: 0.45, Phase.ACTIVE: 1.0, Phase.DORMANT: 0.75, Phase.ARCHIVED: 0.55}

logger = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Shown:
    # Last logged state of an object; `cloud_of` has the logged cloud, of the stamp `cloud_ns`. The meshes were logged
    # where the object was at `laid`; `is_moved`: a pose places them elsewhere since then.
    object: TrackedObject
    cloud_of: TrackedObject
    cloud_ns: int
    laid: NDArray[np.float64] | None = None
    is_moved: bool = False


class ObjectLayers:
    """Returns the items that bring the viewer's objects up to date.

    A growing cloud is logged once per `cloud_period_ns`; `finish` catches up, and adds textures to layer 2. Records are
    immutable: an object with an unchanged record is skipped.
    """

    def __init__(self, *, folder: Path, max_points: int, cloud_period_ns: int, texture_px: int) -> None:
        self._folder = folder
        self._texture_px = texture_px
        self._max_points = max_points
        self._cloud_period_ns = cloud_period_ns
        self._shown: dict[int, _Shown] = {}

    def update(self, objects: tuple[TrackedObject, ...], stamp_ns: int) -> list[LogItem]:
        """Return the items that show these objects."""
        items = self._gone({o.id for o in objects})
        for seen in objects:
            shown = self._shown.get(seen.id)
            if shown is not None and shown.object is seen and shown.cloud_of is seen:
                continue
            items += self._changed_cloud(seen, shown, stamp_ns)
            if shown is None or not _same_box(seen, shown.object):
                items += _box_items(seen)
            now = replace(self._shown[seen.id], object=seen)
            if seen.shape is not None and (shown is None or not _same_shape(seen, shown.object)):
                if now.is_moved:
                    items += _pose_items(seen.id, np.eye(4))
                items += self._shape_items(seen, seen.shape)
                now = replace(now, laid=seen.shape.world_from_object, is_moved=False)
            elif seen.shape and shown and now.laid is not None and not _is_at(seen, shown.object):
                items += _pose_items(seen.id, compose(seen.shape.world_from_object, invert(now.laid)))
                now = replace(now, is_moved=True)
            elif seen.sketch is not None and (shown is None or shown.object.sketch is not seen.sketch):
                items.append(_sketch_item(seen, seen.sketch))
            self._shown[seen.id] = now
        return items

    def finish(self) -> list[LogItem]:
        """Return clouds that are out of date, and textured meshes."""
        clouds = [
            _cloud_item(shown.object, self._max_points)
            for _, shown in sorted(self._shown.items())
            if not _same_cloud(shown.object, shown.cloud_of)
        ]
        return clouds + self._textured_items() if self._texture_px else clouds

    def corners(self) -> NDArray[np.float64]:
        """Return the (N, 3) corners of the boxes of all confirmed objects."""
        known = [s.object for s in self._shown.values() if s.object.phase is not Phase.TENTATIVE]
        return np.concatenate([np.empty((0, 3)), *(o.box.corners_world() for o in known)])

    def _gone(self, present: set[int]) -> list[LogItem]:
        gone = sorted(self._shown.keys() - present)
        for object_id in gone:
            del self._shown[object_id]
        return [clear_item(f"{layer}/{i}") for i in gone for layer in (*LAYERS, FILLED)]

    def _changed_cloud(self, seen: TrackedObject, shown: _Shown | None, stamp_ns: int) -> list[LogItem]:
        # A log that starts over has stamps before the last one: abs() lets it through.
        if shown is not None and abs(stamp_ns - shown.cloud_ns) < self._cloud_period_ns:
            return []
        if shown is not None and _same_cloud(seen, shown.cloud_of):
            self._shown[seen.id] = replace(shown, cloud_of=seen)
            return []
        fresh = _Shown(object=seen, cloud_of=seen, cloud_ns=stamp_ns)
        self._shown[seen.id] = fresh if shown is None else replace(shown, cloud_of=seen, cloud_ns=stamp_ns)
        return [_cloud_item(seen, self._max_points)]

    def _textured_items(self) -> list[LogItem]:
        items = []
        for object_id, shown in sorted(self._shown.items()):
            if shown.object.shape is None:
                continue
            try:
                mesh = textured_layer2(self._folder, shown.object, self._texture_px)
            except (OSError, ValueError, MapFolderError) as error:
                logger.warning("object %d: its mesh has no texture: %s", object_id, error)
                continue
            path = f"{MESH_LAYER}/{object_id}"
            items.append(LogItem(path=path, archetypes=(mesh,), weight=Weight.HEAVY, span=Span.LASTING))
            if shown.is_moved:
                items += _pose_items(object_id, np.eye(4))[:1]
        return items

    def _shape_items(self, seen: TrackedObject, shape: ObjectShape) -> list[LogItem]:
        object_id, color = seen.id, color_of_id(seen.id, is_fixture=seen.is_fixture)
        path = self._folder / "shapes" / shape.mesh_name
        layers: list[tuple[str, tuple[Any, ...]]] = []
        try:
            layers = [(MESH_LAYER, (placed_mesh(path, shape.world_from_object),))]
        except (OSError, ValueError) as error:
            # The picture misses one mesh; the map does not.
            logger.warning("object %d: its mesh %s cannot be shown: %s", object_id, path, error)
        layers.append((FITTED_LAYER, (superquadric_mesh(shape.fitted, color), _facts(shape))))
        layers.append((INFLATED_LAYER, (superquadric_mesh(shape.inflated, color, alpha=_INFLATED_ALPHA),)))
        return [
            LogItem(path=f"{layer}/{object_id}", archetypes=shown, weight=Weight.HEAVY, span=Span.LASTING)
            for layer, shown in layers
        ]


def _pose_items(object_id: int, after_from_before: NDArray[np.float64]) -> list[LogItem]:
    """Return the pose of layers 2 to 4 against where they were logged: a correction moves shapes that stay as they are.

    Layer 2 is the first.
    """
    return [pose_item(f"{layer}/{object_id}", after_from_before) for layer in LAYERS[1:]]


def _cloud_item(seen: TrackedObject, max_points: int) -> LogItem:
    points, colors = seen.points_world, seen.colors
    if len(points) > max_points:
        kept = np.linspace(0, len(points) - 1, max_points).astype(np.int64)
        points, colors = points[kept], colors[kept]
    cloud = rr.Points3D(points, colors=colors, radii=0.006)
    path = f"{POINTS_LAYER}/{seen.id}/points"
    return LogItem(path=path, archetypes=(cloud,), weight=Weight.HEAVY, span=Span.LASTING)


def _facts(shape: ObjectShape) -> rr.DynamicArchetype:
    facts = {
        "reconstructor": shape.reconstructor,
        "verdict": shape.verdict or "none was asked for",
        "layer_3_of": shape.fit_kind,
        "is_certified": shape.containment.is_certified,
    }
    return rr.DynamicArchetype("hickory_stream.Shape", components=facts)


def _sketch_item(seen: TrackedObject, sketch: Superquadrics) -> LogItem:
    """Return the sketch in the place of layer 3, which replaces it when it comes."""
    mesh = superquadric_mesh(sketch, color_of_id(seen.id, is_fixture=seen.is_fixture), alpha=_SKETCH_ALPHA)
    return LogItem(path=f"{FITTED_LAYER}/{seen.id}", archetypes=(mesh,), span=Span.LASTING)


def _box_items(seen: TrackedObject) -> list[LogItem]:
    box: dict[str, Any] = {
        "centers": [seen.box.center],
        "half_sizes": [seen.box.half_extents_m],
        "quaternions": [rr.Quaternion(xyzw=quaternion_from_rotation(seen.box.world_from_box[:3, :3]))],
        "colors": shaded(color_of_id(seen.id, is_fixture=seen.is_fixture), _FADED[seen.phase]),
        "radii": -1.5 if seen.phase is Phase.ACTIVE else -0.7,
        "labels": [_label(seen)],
        "show_labels": False,
    }
    lines, filled = rr.components.FillMode.MajorWireframe, rr.components.FillMode.TransparentFillMajorWireframe
    return [
        LogItem(
            path=f"{POINTS_LAYER}/{seen.id}/box", archetypes=(rr.Boxes3D(**box, fill_mode=lines),), span=Span.LASTING
        ),
        LogItem(path=f"{FILLED}/{seen.id}", archetypes=(rr.Boxes3D(**box, fill_mode=filled),), span=Span.LASTING),
    ]


def _label(seen: TrackedObject) -> str:
    phase = (seen.phase,) * (seen.phase is not Phase.ACTIVE)
    return " ".join((str(seen.id), kind_text(seen.fixture_probability), *phase))


def _same_box(a: TrackedObject, b: TrackedObject) -> bool:
    return (
        a.phase is b.phase
        and kind_text(a.fixture_probability) == kind_text(b.fixture_probability)
        and _same(a.box.world_from_box, b.box.world_from_box)
        and _same(a.box.half_extents_m, b.box.half_extents_m)
    )


def _same_shape(one: TrackedObject, other: TrackedObject) -> bool:
    # In the same colour, at any pose.
    a, b = one.shape, other.shape
    return a is not None and b is not None and one.kind is other.kind and a.revision == b.revision


def _is_at(one: TrackedObject, other: TrackedObject) -> bool:
    # Whether the same shape is at the same pose: a corrected submap moves its shapes.
    return (
        one.shape is not None
        and other.shape is not None
        and _same(one.shape.world_from_object, other.shape.world_from_object)
    )


def _same_cloud(a: TrackedObject, b: TrackedObject) -> bool:
    return a is b or np.array_equal(a.points_world, b.points_world)


def _same(a: NDArray[Any], b: NDArray[Any]) -> bool:
    return a is b or np.array_equal(a, b)
