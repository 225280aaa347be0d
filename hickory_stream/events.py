"""Events and effects: everything that the core is told, and everything that it asks for.

`MapperCore.handle(event) -> list[Effect]`: events say what happened outside, effects say what the core wants done. Both
are plain records, so that a run can be written down, replayed and compared.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.rigid import is_rigid, no_directions

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from hickory_stream.geometry.boxes import OrientedBox
    from hickory_stream.records import (
        CoarseFrame,
        Decision,
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

# ---- events ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FrameObserved:
    """A keyframe was perceived.

    `coarse` becomes the surface of the submap, in which loops are searched, and is for people who ask why; None in
    older journals. `degenerate` (K, 6) is that of the frame.
    """

    frame_index: int
    stamp_ns: int
    world_from_camera: NDArray[np.float64]
    observations: tuple[Observation, ...]
    space: SpaceObservation
    rejected: tuple[RejectedMask, ...] = ()
    coarse: CoarseFrame | None = None
    degenerate: NDArray[np.float64] = field(default_factory=no_directions)

    def __post_init__(self) -> None:
        freeze(self, "world_from_camera", float, (4, 4))
        freeze(self, "degenerate", float, (None, 6))


@dataclass(frozen=True, kw_only=True, slots=True)
class FeaturesReady:
    """The answer to `ComputeFeatures`, for the same keyframe."""

    frame_index: int
    features: tuple[MaskFeature, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class ShapeReady:
    """A shape job has ended well; `stamp_ns` is when it is committed."""

    ticket: int
    object_id: int
    stamp_ns: int
    shape: ObjectShape


@dataclass(frozen=True, kw_only=True, slots=True)
class ShapeFailed:
    """A shape job has ended without a shape."""

    ticket: int
    object_id: int
    stamp_ns: int
    reason: str


@dataclass(frozen=True, kw_only=True, slots=True)
class TimeJumped:
    """The stamps of the source went backwards or far ahead.

    `kind` is "loop" where a log begins anew, "restart" where a clock went back before everything that was seen, else
    "seek". A message that is merely late is no jump.
    """

    from_ns: int
    to_ns: int
    kind: Literal["loop", "seek", "restart"] = "seek"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PoseJumped:
    """The odometry jumped before the frame of `stamp_ns`: a loop closure of its own, or a lost track.

    `after_from_before` (4, 4) takes what was in its old world into its new one. The poses of the frames do not jump:
    they go on in the old world, as right as the jump can be known.
    """

    stamp_ns: int
    after_from_before: NDArray[np.float64]

    def __post_init__(self) -> None:
        freeze(self, "after_from_before", float, (4, 4))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PosesCorrected:
    """Somebody, e.g. a pose graph, knows better where submaps lie: `world_from_submap` (N, 4, 4) of `submap_ids`.

    Where a submap lies is said anew, not by how much it moves: the identity undoes all corrections. The others stay.
    `graph` is the pose graph whose solution that is, None of somebody else's; no submap may be named where only the
    graph has changed.

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
    """A keyframe was registered to the surface of those before; its `FrameObserved`, at `map_from_camera`, follows.

    `odometry_from_camera` and `map_from_camera` (4, 4) are its pose as the odometry has it, and as it is mapped;
    `covariance` (6, 6) is that of the latter against the surface, rotation vector, then translation, along the map's
    axes. `how` says why: it fits the surface; or there is none to compare it with, because it is the `first`, because
    the ground is new, or because nothing fitted for so long that the surface begins anew. `corrects`: the odometry was
    contradicted before, else `map_from_camera` is its pose; `num_against` keyframes in a row contradict it. Later ones
    may be registered to an `is_anchor`, and the depth of this one has the noise `spread_per_m` in inverse depth.
    `fit` is the share of the points to compare that lie on the surface, None where there are too few. Along the unit
    directions `degenerate` (K, 6), of the map's axes, rotation first, its surface said nothing.
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
        freeze(self, "degenerate", float, (None, 6))
        freeze(self, "covariance", float, (6, 6))


@dataclass(frozen=True, kw_only=True, slots=True)
class KeyframeKeptOut:
    """A keyframe does not fit the surface of those before: nothing of it is mapped."""

    frame_index: int
    stamp_ns: int
    reason: str


@dataclass(frozen=True, kw_only=True, slots=True)
class LoopsSearched:
    """The answer to `SearchLoops`: what was found, believed or not; `stamp_ns` is when it is committed."""

    submap_id: int
    stamp_ns: int
    loops: tuple[Loop, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class WayEnded:
    """The last frame was mapped; the core asks for the loops of the open submap, before the map is finished."""

    stamp_ns: int


@dataclass(frozen=True, kw_only=True, slots=True)
class SourceEnded:
    """No frame will follow; the core asks for what is still worth building."""

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

# ---- effects --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, slots=True)
class ComputeFeatures:
    """Compute the features of these masks while the frame is still at hand, and answer with `FeaturesReady`."""

    frame_index: int
    observation_indices: tuple[int, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class KeepView:
    """Write the pixels of this view; the frame is still at hand."""

    view: View
    observation_index: int


@dataclass(frozen=True, kw_only=True, slots=True)
class DropView:
    """The pixels of this view are no longer needed."""

    name: str


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RequestShape:
    """Build layers 2 to 4 of an object.

    `views` are its kept views, the best one first. `points_world` and `colors` are its layer 1; `box` its box;
    `support_z_m` the height of the surface it stands on, where known. The result is committed at the first keyframe at
    or after `due_ns` (playback).
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
    """The result of this job is no longer wanted."""

    ticket: int


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SearchLoops:
    """Search where the submap `submap_id`, which has ended, lies in those before it; answer with `LoopsSearched`.

    `submaps` are it and all before it, `snapshot` the map, both as they are now; `loops` what was found before. The
    answer is committed at the first keyframe at or after `due_ns` (playback).
    """

    submap_id: int
    due_ns: int
    submaps: tuple[SurveyedSubmap, ...]
    loops: tuple[Loop, ...]
    snapshot: MapSnapshot


@dataclass(frozen=True, kw_only=True, slots=True)
class Publish:
    """Show the map as it is now, the decisions that led here, and the object that each observation went to.

    `metrics` are the core's own counts under `core/...`, and S of the best views under `score/ID`.
    """

    snapshot: MapSnapshot
    decisions: tuple[Decision, ...]
    object_ids: tuple[int | None, ...] = ()
    metrics: tuple[tuple[str, float], ...] = ()


Effect = ComputeFeatures | KeepView | DropView | RequestShape | CancelShape | SearchLoops | Publish
