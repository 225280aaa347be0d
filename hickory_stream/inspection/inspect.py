"""A map in numbers: its objects, and the storage and time of the four layers as in the paper's table.

Storage counts content, not file packing: 15 bytes a point, the GLB of a mesh, eleven float64 a superquadric.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from math import hypot
from typing import TYPE_CHECKING, Any, Literal

from hickory_stream.config import as_far_as_known
from hickory_stream.inspection.graph_summary import GraphSummary, summary_of, summary_text
from hickory_stream.inspection.object_geometry import Place, place_of
from hickory_stream.inspection.supports import support_text, supports_of
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.mapping.floor_warnings import floor_warnings
from hickory_stream.records import Containment, FitKind, ObjectKind, ObjectShape, Phase, TrackedObject, kind_text

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from hickory_stream.map_folder.saved_map import SavedMap
    from hickory_stream.mapping.rules.support_graph import Support

SortBy = Literal["id", "distance", "volume", "height", "sightings"]

LAYERS = (1, 2, 3, 4)
LAYER_NAMES = ("points", "mesh", "superquadrics", "inflated")
_POINT_BYTES = 3 * 4 + 3
_PRIMITIVE_BYTES = 11 * 8


@dataclass(frozen=True, kw_only=True, slots=True)
class ObjectSummary:
    """One object in numbers."""

    id: int
    phase: Phase
    kind: ObjectKind
    fixture_probability: float
    submap_id: int
    #: pose and size of its best layer
    place: Place
    sightings: int
    #: sides of the box of layer 1
    size_m: tuple[float, float, float]
    num_points: int
    num_views: int
    num_superquadrics: int
    num_inflated: int
    reconstructor: str | None
    layers: tuple[int, ...]
    #: of layers 1 to 4, 0 if missing
    layer_bytes: tuple[int, int, int, int]
    containment: Containment | None
    #: without layers 2 to 4, but with one superquadric fitted to its points
    is_sketched: bool = False
    supports: tuple[Support, ...] = ()
    #: why a generated shape was accepted or not, "" without one
    verdict: str = ""
    #: as in `ObjectShape`, None without a shape
    fit_kind: FitKind | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class LayerSummary:
    """One layer of all objects; `seconds` is the time to build it, None if it was not recorded."""

    layer: int
    num_objects: int
    total_bytes: int
    seconds: float | None


@dataclass(frozen=True, kw_only=True, slots=True)
class MapSummary:
    """A map in numbers; `objects` are the selected ones.

    `num_checked` and `num_outside` sum up the containment. `num_shaped` of `num_objects` have a layer 4;
    `num_certified` have one that provably contains them, `num_fallbacks` of these a box.
    """

    objects: tuple[ObjectSummary, ...]
    layers: tuple[LayerSummary, ...]
    #: of the objects as found
    digest: str
    finished_cleanly: bool
    revision: int
    source: str
    num_checked: int
    num_outside: int
    num_certified: int
    num_fallbacks: int
    num_objects: int
    num_shaped: int
    #: the objects differ from the saved ones, so that none counts as certified
    is_altered: bool
    #: why statements about layer 4 may not hold, "" if they do
    doubt: str
    #: warnings about floor and gravity
    notes: tuple[str, ...]
    graph: GraphSummary | None = None
    #: Frames of the run by outcome, {} while it goes on.
    frames: dict[str, int] = field(default_factory=dict)


def summarize(saved: SavedMap) -> MapSummary:
    """Return the numbers of a map."""
    supports = supports_of(saved.snapshot, as_far_as_known(saved.manifest.config).mapping)
    objects = tuple(_summarize_object(saved, tracked, supports[tracked.id]) for tracked in saved.snapshot.objects)
    checks = [summary.containment for summary in objects if summary.containment]
    return MapSummary(
        objects=objects,
        layers=tuple(_summarize_layer(saved, objects, layer) for layer in LAYERS),
        digest=map_digest(saved.snapshot),
        finished_cleanly=saved.manifest.finished_cleanly,
        revision=saved.snapshot.revision,
        source=str(saved.manifest.source.get("uri", "unknown")),
        num_checked=sum(check.num_checked for check in checks),
        num_outside=sum(check.num_outside for check in checks),
        num_certified=sum(check.is_certified for check in checks),
        num_fallbacks=sum(check.is_fallback for check in checks),
        num_objects=len(objects),
        num_shaped=sum(row.containment is not None for row in objects),
        is_altered=saved.is_altered,
        doubt=saved.doubt,
        notes=floor_warnings(saved.snapshot),
        graph=None if saved.snapshot.graph is None else summary_of(saved.snapshot.graph),
        frames=dict(saved.ledger.get("frames", {})),
    )


def chosen(
    summary: MapSummary,
    *,
    sort: SortBy = "id",
    near: tuple[float, float] = (0.0, 0.0),
    within_m: float | None = None,
    min_size_m: float = 0.0,
) -> MapSummary:
    """Return the summary with the selected objects in the given order; its totals stay the map's.

    Args:
        summary: of the whole map.
        sort: by id or distance, ascending; by size, height or sightings, descending. Ties by id.
        near: x and y in the map, metres; distances are horizontal, to the objects' centres.
        within_m: leaves out farther objects.
        min_size_m: leaves out objects whose longest side is shorter.
    """
    keys: dict[SortBy, Callable[[ObjectSummary], float]] = {
        "id": lambda row: row.id,
        "distance": lambda row: _distance_m(row, near),
        "volume": lambda row: -row.place.volume_m3,
        "height": lambda row: -row.place.size_m[2],
        "sightings": lambda row: -row.sightings,
    }
    kept = [row for row in summary.objects if max(row.place.size_m) >= min_size_m]
    if within_m is not None:
        kept = [row for row in kept if _distance_m(row, near) <= within_m]
    return replace(summary, objects=tuple(sorted(kept, key=lambda row: (keys[sort](row), row.id))))


def as_json(summary: MapSummary) -> dict[str, Any]:
    """Return the summary as JSON data; keys are the field names."""
    return asdict(summary)


def format_table(summary: MapSummary, *, with_layers: bool = False, near: tuple[float, float] | None = None) -> str:
    """Return the summary as text: a row for each object, with its horizontal distance from `near`, if given.

    `with_layers` adds the content and storage of each object, and the storage and time of each layer.
    """
    layers = [
        "",
        *_columns([_OBJECT_HEADER, *(_object_row(row) for row in summary.objects)]),
        *(f"shape of {row.id}: {row.verdict}" for row in summary.objects if row.verdict),
        "",
        *_columns([_LAYER_HEADER, *(_layer_row(row) for row in summary.layers)]),
    ]
    header = (*_PLACE_HEADER, *(("away m",) if near is not None else ()))
    return "\n".join(
        [
            f"{summary.source}: {_count_objects(summary)}, {_ending(summary)}",
            "",
            *_columns([header, *(_place_row(row, near) for row in summary.objects)]),
            *(layers if with_layers else []),
            "",
            _containment_line(summary),
            *summary.notes,
            *([_frames_line(summary.frames)] if summary.frames else []),
            *([summary_text(summary.graph)] if summary.graph is not None else []),
            f"digest {summary.digest}",
        ]
    )


def _summarize_object(saved: SavedMap, tracked: TrackedObject, supports: tuple[Support, ...]) -> ObjectSummary:
    width, depth, height = (round(2 * float(half), 6) for half in tracked.box.half_extents_m)
    shape = tracked.shape
    sizes = (
        len(tracked.points_world) * _POINT_BYTES,
        saved.mesh_path(shape).stat().st_size if shape else 0,
        len(shape.fitted) * _PRIMITIVE_BYTES if shape else 0,
        len(shape.inflated) * _PRIMITIVE_BYTES if shape else 0,
    )
    return ObjectSummary(
        id=tracked.id,
        phase=tracked.phase,
        kind=tracked.kind,
        fixture_probability=tracked.fixture_probability,
        submap_id=tracked.submap_id,
        place=place_of(tracked, saved.mesh(shape) if shape else None),
        sightings=tracked.sightings,
        size_m=(width, depth, height),
        num_points=len(tracked.points_world),
        num_views=len(tracked.views),
        num_superquadrics=len(shape.fitted) if shape else 0,
        num_inflated=len(shape.inflated) if shape else 0,
        reconstructor=shape.reconstructor if shape else None,
        layers=tuple(layer for layer, size in zip(LAYERS, sizes, strict=True) if size),
        layer_bytes=sizes,
        containment=_containment(saved, shape) if shape else None,
        is_sketched=tracked.sketch is not None,
        supports=supports,
        verdict=shape.verdict if shape else "",
        fit_kind=shape.fit_kind if shape else None,
    )


def _distance_m(row: ObjectSummary, near: tuple[float, float]) -> float:
    return hypot(row.place.center_m[0] - near[0], row.place.center_m[1] - near[1])


def _containment(saved: SavedMap, shape: ObjectShape) -> Containment:
    return replace(shape.containment, is_certified=False) if saved.is_altered else shape.containment


def _summarize_layer(saved: SavedMap, objects: tuple[ObjectSummary, ...], layer: int) -> LayerSummary:
    seconds = saved.timings.get(f"layer{layer}_s")
    return LayerSummary(
        layer=layer,
        num_objects=sum(layer in summary.layers for summary in objects),
        total_bytes=sum(summary.layer_bytes[layer - 1] for summary in objects),
        seconds=None if seconds is None else float(seconds),
    )


# ---- text -----------------------------------------------------------------------------------------------------------

_PLACE_HEADER = ("id", "kind", "phase", "sighted", "layers", "x m", "y m", "z m", "yaw deg", "size m", "litres",
                 "color", "held by")  # fmt: skip
_OBJECT_HEADER = ("id", "submap", "placed by", "views", *LAYER_NAMES, "outside")
_LAYER_HEADER = ("layer", "", "objects", "storage", "mean", "time", "mean")


def _object_row(row: ObjectSummary) -> tuple[str, ...]:
    return (
        str(row.id),
        str(row.submap_id),
        f"layer {row.place.layer}",
        str(row.num_views),
        f"{row.num_points} ({_bytes(row.layer_bytes[0])})",
        _bytes(row.layer_bytes[1]) if row.layer_bytes[1] else "-",
        _superquadrics_cell(row),
        f"{row.num_inflated} ({_bytes(row.layer_bytes[3])})" if row.layer_bytes[3] else "-",
        _share(row.containment.num_outside, row.containment.num_checked) if row.containment else "-",
    )


def _place_row(row: ObjectSummary, near: tuple[float, float] | None) -> tuple[str, ...]:
    place = row.place
    return (
        str(row.id),
        kind_text(row.fixture_probability),
        row.phase,
        str(row.sightings),
        "".join(str(layer) if layer in row.layers else "-" for layer in LAYERS),
        *(f"{part:.2f}" for part in place.center_m),
        f"{place.yaw_deg:.0f}",
        " x ".join(f"{side:.2f}" for side in place.size_m),
        f"{1000 * place.volume_m3:.1f}",
        place.color,
        support_text(row.supports),
        *(() if near is None else (f"{_distance_m(row, near):.2f}",)),
    )


def _superquadrics_cell(row: ObjectSummary) -> str:
    if not row.layer_bytes[2]:
        return "1 from points" if row.is_sketched else "-"
    kind = "" if row.fit_kind == "solid" else f"{row.fit_kind}, "
    return f"{row.num_superquadrics} ({kind}{_bytes(row.layer_bytes[2])})"


def _layer_row(row: LayerSummary) -> tuple[str, ...]:
    count = max(row.num_objects, 1)
    return (
        str(row.layer),
        LAYER_NAMES[row.layer - 1],
        str(row.num_objects),
        _bytes(row.total_bytes),
        _bytes(row.total_bytes // count),
        "-" if row.seconds is None else f"{row.seconds:.2f} s",
        "-" if row.seconds is None else f"{1000 * row.seconds / count:.0f} ms",
    )


def _columns(rows: list[tuple[str, ...]]) -> list[str]:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    is_text = [row_i in ("kind", "phase", "layers", "color", "held by", "") for row_i in rows[0]]
    return [
        "  ".join(
            cell.ljust(width) if text else cell.rjust(width)
            for cell, width, text in zip(row, widths, is_text, strict=True)
        ).rstrip()
        for row in rows
    ]


def _bytes(size: int) -> str:
    if size < 1024:
        return f"{size} B"
    return f"{size / 1024:.1f} KiB" if size < 1024**2 else f"{size / 1024**2:.2f} MiB"


def _share(part: int, whole: int) -> str:
    return f"{100 * part / whole:.2f} %" if whole else "-"


def _count_objects(summary: MapSummary) -> str:
    if len(summary.objects) < summary.num_objects:
        return f"{len(summary.objects)} of {summary.num_objects} objects"
    counts = [(phase, sum(row.phase == phase for row in summary.objects)) for phase in Phase]
    fixtures = sum(row.kind is ObjectKind.FIXTURE for row in summary.objects)
    phases = ", ".join(f"{n} {phase}" for phase, n in counts if n) or "none"
    also = f", {fixtures} of them fixtures" if fixtures else ""
    return f"{len(summary.objects)} objects{also} ({phases})"


def _ending(summary: MapSummary) -> str:
    if summary.finished_cleanly:
        return "finished cleanly"
    return f"not finished: {'this is its last complete save' if summary.revision else 'nothing was saved yet'}"


def _frames_line(frames: Mapping[str, int]) -> str:
    kinds = {"keyframes_at_rest": "of a camera at rest", "keyframes_without_depth": "without depth"}
    some = [f"{frames[name]} {text}" for name, text in kinds.items() if frames.get(name)]
    also = f" ({', '.join(some)})" if some else ""
    return f"{frames.get('keyframes', 0)} keyframes{also} of {frames.get('read', 0)} frames"


def _containment_line(summary: MapSummary) -> str:
    if not summary.num_checked:
        return "layer 4: nothing checked"
    if summary.is_altered:
        return f"layer 4: NOT PROVEN: {summary.doubt}"
    share = _share(summary.num_checked - summary.num_outside, summary.num_checked)
    certified = f"{summary.num_certified} of {summary.num_shaped} objects certified"
    boxes = f", {summary.num_fallbacks} as boxes" if summary.num_fallbacks else ""
    return f"layer 4: {certified}{boxes}; {share} of {summary.num_checked} pieces checked are inside{_margins(summary)}"


def _margins(summary: MapSummary) -> str:
    # Containment without a margin proves little.
    margins = [row.containment.margin_m for row in summary.objects if row.containment]
    if not margins:
        return ""
    ends = dict.fromkeys((min(margins), max(margins)))
    return f", with a margin of {' to '.join(f'{margin:g}' for margin in ends)} m"
