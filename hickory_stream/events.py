"""Events and effects: the input and output of the core, `MapperCore.handle(event) -> list[Effect]`.

Events say what happened outside, effects what to do. Both are plain records: a run can be written, replayed and
compared.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

from hickory_stream.geometry.arrays import freeze, freeze_all
from hickory_stream.geometry.rigid import is_rigid, no_directions

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from hickory_stream.geometry.boxes import OrientedBox
    from hickory_stream.records import (
        CoarseFrame,
        Decision,
        Keypoints,
        Loop,
        MapSnapshot,
        MaskFeature,
        ObjectShape,
        Observation,
        PoseGraphRecord,
        RejectedMask,
        SpaceObservation,
        SurveyedSubmap,
        View,
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FrameObserved:
    """A perceived keyframe."""

    frame_index: int
    stamp_ns: int
    world_from_camera: NDArray[np.float64]
    observations: tuple[Observation, ...]
    space: SpaceObservation
    rejected: tuple[RejectedMask, ...] = ()
    #: For the submap's surface (loop search) and for people.
    coarse: CoarseFrame | None = None
    #: (K, 6), of the frame.
    degenerate: NDArray[np.float64] = field(default_factory=no_directions)
    #: Of the depth's standard deviation; by default no return is worth more than another.
    depth_law: tuple[float, float, float] = (2.0**-7, 0.0, 0.0)
    #: None: loops are not searched.
    keypoints: Keypoints | None = None

    def __post_init__(self) -> None:
        freeze_all(self, float, world_from_camera=(4, 4), degenerate=(None, 6))


@dataclass(frozen=True, kw_only=True, slots=True)
class FeaturesReady:
    """The answer to `ComputeFeatures`, for the same keyframe."""

    frame_index: int
    features: tuple[MaskFeature, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class ShapeReady:
    """A shape job succeeded; `stamp_ns` is the time of its commit."""

    ticket: int
    object_id: int
    stamp_ns: int
    shape: ObjectShape


@dataclass(frozen=True, kw_only=True, slots=True)
class ShapeFailed:
    """A shape job ended without a shape."""

    ticket: int
    object_id: int
    stamp_ns: int
    reason: str


@dataclass(frozen=True, kw_only=True, slots=True)
class TimeJumped:
    """The stamps of the source went backwards or far ahead; late messages are no jump.

    `kind`: "loop", a log begins again; "restart", a clock went back before everything seen; else "seek".
    """

    from_ns: int
    to_ns: int
    kind: Literal["loop", "seek", "restart"] = "seek"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PoseJumped:
    """The odometry jumped before the frame of `stamp_ns`: its own loop closure, or a lost track.

    `after_from_before` (4, 4) goes from its old world to its new one. Poses of frames continue in the old world.
    """

    stamp_ns: int
    after_from_before: NDArray[np.float64]

    def __post_init__(self) -> None:
        freeze(self, "after_from_before", float, (4, 4))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PosesCorrected:
    """New poses of submaps, e.g. of a pose graph: `world_from_submap` (N, 4, 4) of `submap_ids`; others stay.

    Poses are absolute: the identity undoes all corrections. `graph` is the solved pose graph, None from other origins;
    if only the graph changed, no submap is listed.

    Raises `ValueError`: a submap is named twice, or a transform is not rigid.
    """

    stamp_ns: int
    submap_ids: tuple[int, ...]
    world_from_submap: NDArray[np.float64]
    graph: PoseGraphRecord | None = None

    def __post_init__(self) -> None:
        freeze(self, "world_from_submap", float, (len(self.submap_ids), 4, 4))
        if len(set(self.submap_ids)) < len(self.submap_ids):
            raise ValueError(f"submaps {self.submap_ids}: one is named twice")
        for submap_id, pose in zip(self.submap_ids, self.world_from_submap, strict=True):
            if not is_rigid(pose):
                raise ValueError(f"world_from_submap of submap {submap_id} is no rigid transform: {pose.tolist()}")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class KeyframeRegistered:
    """A keyframe was registered to the surface of earlier ones; its `FrameObserved`, at `map_from_camera`, follows.

    Poses (4, 4) are by odometry and as mapped; `covariance` (6, 6) of the latter against the surface: rotation vector,
    then translation, along the map's axes. `how`: it fits; or nothing comparable: it is the `first`, on new ground, or
    the surface begins again after a long misfit. `corrects`: the odometry was contradicted before, else
    `map_from_camera` is its pose; `num_against` keyframes in a row contradict it. Later ones may be registered to an
    `is_anchor`; `spread_per_m` is the noise of its inverse depth. `fit`: share of comparable points on the surface,
    None for too few. Along the unit directions `degenerate` (K, 6), in the map's axes, rotation first, the surface gave
    no information.
    """

    frame_index: int
    stamp_ns: int
    how: Literal["first", "fits", "new ground", "begun anew"]
    odometry_from_camera: NDArray[np.float64]
    map_from_camera: NDArray[np.float64]
    map_from_odometry: NDArray[np.float64]
    covariance: NDArray[np.float64]
    corrects: bool
    num_against: int
    is_anchor: bool
    spread_per_m: float
    fit: float | None
    degenerate: NDArray[np.float64] = field(default_factory=no_directions)

    def __post_init__(self) -> None:
        for name in ("odometry_from_camera", "map_from_camera", "map_from_odometry"):
            freeze(self, name, float, (4, 4))
        freeze_all(self, float, degenerate=(None, 6), covariance=(6, 6))


@dataclass(frozen=True, kw_only=True, slots=True)
class KeyframeKeptOut:
    """A keyframe does not fit the surface of earlier ones, and is not mapped."""

    frame_index: int
    stamp_ns: int
    reason: str


@dataclass(frozen=True, kw_only=True, slots=True)
class LoopsSearched:
    """The answer to `SearchLoops`: all candidates, accepted or not; `stamp_ns` is the time of the commit."""

    submap_id: int
    stamp_ns: int
    loops: tuple[Loop, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class WayEnded:
    """The last frame was mapped; the core requests loops of the open submap."""

    stamp_ns: int


@dataclass(frozen=True, kw_only=True, slots=True)
class SourceEnded:
    """No frame will follow; the core requests the remaining shapes."""

    stamp_ns: int


Event = (
    FrameObserved
    | FeaturesReady
    | ShapeReady
    | ShapeFailed
    | TimeJumped
    | PoseJumped
    | PosesCorrected
    | LoopsSearched
    | WayEnded
    | KeyframeRegistered
    | KeyframeKeptOut
    | SourceEnded
)


@dataclass(frozen=True, kw_only=True, slots=True)
class ComputeFeatures:
    """Compute the features of these masks in the current frame, and answer with `FeaturesReady`."""

    frame_index: int
    observation_indices: tuple[int, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class KeepView:
    """Write the pixels of this view of the current frame."""

    view: View
    observation_index: int


@dataclass(frozen=True, kw_only=True, slots=True)
class DropView:
    """Remove the pixels of this view."""

    name: str


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RequestShape:
    """Build layers 2 to 4 of an object.

    `views`: kept ones, the best first. `points_world`, `colors` and `box`: layer 1. `support_z_m`: height of the
    supporting surface, if known. A playback commits the result at the first keyframe at or after `due_ns`.
    """

    ticket: int
    object_id: int
    views: tuple[View, ...]
    points_world: NDArray[np.float32]
    colors: NDArray[np.uint8]
    box: OrientedBox
    support_z_m: float | None
    due_ns: int

    def __post_init__(self) -> None:
        freeze(self, "points_world", "f4", (None, 3))
        freeze(self, "colors", "u1", (len(self.points_world), 3))


@dataclass(frozen=True, kw_only=True, slots=True)
class CancelShape:
    """The result of this job is not needed any more."""

    ticket: int


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SearchLoops:
    """Search the place of the ended submap `submap_id` in earlier ones; answer with `LoopsSearched`.

    `submaps`: it and all before it. `snapshot`: the current map. `loops`: found before. A playback commits the answer
    at the first keyframe at or after `due_ns`.
    """

    submap_id: int
    due_ns: int
    submaps: tuple[SurveyedSubmap, ...]
    loops: tuple[Loop, ...]
    snapshot: MapSnapshot


@dataclass(frozen=True, kw_only=True, slots=True)
class Publish:
    """Show the current map, its decisions, and the object of each observation.

    `metrics`: the core's counts under `core/...`, and S of the best views under `score/ID`.
    """

    snapshot: MapSnapshot
    decisions: tuple[Decision, ...]
    object_ids: tuple[int | None, ...] = ()
    metrics: tuple[tuple[str, float], ...] = ()


Effect = ComputeFeatures | KeepView | DropView | RequestShape | CancelShape | SearchLoops | Publish
