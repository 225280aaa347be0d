"""The records that the parts of the system hand to each other.

All are frozen; array fields are checked for dtype and shape and made read-only on construction, so that a record can be
shared between threads and kept for ever. Stamps are integer nanoseconds; the world is z up; lengths are metres.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from hickory_stream.base.confined import plain_name, whole_number
from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.depth_sensor import DepthSensor
from hickory_stream.geometry.lazy_arrays import GivesUpArrays
from hickory_stream.geometry.rigid import no_directions
from hickory_stream.geometry.superquadric import check_bodies

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from hickory_stream.geometry.boxes import OrientedBox
    from hickory_stream.geometry.camera import Camera
    from hickory_stream.geometry.superquadric import Superquadrics


# ---- what a source yields -------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Frame:
    """A decoded, posed RGB-D frame; colour and depth are registered pixel by pixel.

    `rgb` (H, W, 3) uint8; `depth_m` (H, W) float32 along the optical axis, NaN = no return;
    `world_from_camera` (4, 4). `sensor` says what the depth is worth; its range and bias are seen to already.
    `degenerate` (K, 6) are unit directions in the camera's frame, rotation first, along which the scans that the pose
    was estimated from said nothing; none where it is the log's.
    """

    index: int
    stamp_ns: int
    rgb: NDArray[np.uint8]
    depth_m: NDArray[np.float32]
    camera: Camera
    world_from_camera: NDArray[np.float64]
    sensor: DepthSensor = field(default_factory=DepthSensor)
    degenerate: NDArray[np.float64] = field(default_factory=no_directions)

    def __post_init__(self) -> None:
        size = (self.camera.height, self.camera.width)
        freeze(self, "degenerate", np.float64, (None, 6))
        freeze(self, "rgb", np.uint8, (*size, 3))
        freeze(self, "depth_m", np.float32, size)
        freeze(self, "world_from_camera", np.float64, (4, 4))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RawFrame:
    """A posed frame that is still compressed: only keyframes are ever decoded.

    `decode()` returns the `Frame`, or raises `RecordingError` where an image is torn. `color_bytes` are the log's own
    compressed colour (JPEG or PNG), for the viewer; None when the log had none. `after_from_before` (4, 4) where the
    odometry jumped since the frame before: it takes the old world into the new one. The pose itself does not jump: a
    source that knows of a jump takes it out, so that all its poses are in the first world. `goes_back`: somebody went
    back in the log to this frame, and wants the map as it was known before it. `is_posed`: False where the pose is none
    and odometry has yet to put one in, before anybody is handed the source (`players/poses/odometry_source.py`).
    """

    index: int
    stamp_ns: int
    camera: Camera
    world_from_camera: NDArray[np.float64]
    decode: Callable[[], Frame]
    color_bytes: bytes | None = None
    after_from_before: NDArray[np.float64] | None = None
    goes_back: bool = False
    is_posed: bool = True

    def __post_init__(self) -> None:
        freeze(self, "world_from_camera", np.float64, (4, 4))
        if self.after_from_before is not None:
            freeze(self, "after_from_before", np.float64, (4, 4))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Scan:
    """A sweep of a LiDAR, for odometry: `points` (N, 3) float32 in the sensor's `frame`, all finite.

    `times_s` (N,) float32 is when each was measured, since the stamp; None where the log does not say.
    """

    stamp_ns: int
    frame: str
    points: NDArray[np.float32]
    times_s: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        freeze(self, "points", np.float32, (None, 3))
        if self.times_s is not None:
            freeze(self, "times_s", np.float32, (len(self.points),))


@dataclass(frozen=True, kw_only=True, slots=True)
class SourceInfo:
    """What a source found: for the operator, the progress bar and the manifest.

    `num_frames`, `start_ns` and `end_ns` are None where they are not known beforehand. `streams` maps a role
    (color, depth, camera_info, pose, ...) to the topic or file pattern that plays it. `identity` tells two logs apart.
    """

    uri: str
    kind: str
    identity: str
    camera: Camera
    num_frames: int | None
    start_ns: int | None
    end_ns: int | None
    streams: tuple[tuple[str, str], ...]


# ---- perception -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RejectedMask:
    """A mask that became no observation, and why; `box_px` = (x0, y0, x1, y1), the ends exclusive.

    `mask` (h, w) bool within the box, None where only the box is known.
    """

    box_px: tuple[int, int, int, int]
    reason: str
    mask: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        x0, y0, x1, y1 = self.box_px
        if self.mask is not None:
            freeze(self, "mask", np.bool_, (y1 - y0, x1 - x0))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SemanticImage:
    """Which class each pixel is of: `classes` (H, W) int32, places in `labels`, -1 where the model does not say."""

    classes: NDArray[np.int32]
    labels: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze(self, "classes", np.int32, (None, None))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Segmentation:
    """What a segmenter says of a frame.

    `instances` (H, W) int32, 0 = no object, 1..n = the n instances; `structure` (H, W) bool: floor, walls, ceiling.
    `structure_shown` (H, W) bool: what of it this frame shows by itself, without what the map knew; None: all of it.
    Only this is evidence for the map: what it knew, and had told the segmenter, proves nothing again.
    `alone` (H, W) int32: the instances as this frame has them by itself, each a union of some of `instances`; None: the
    same. `floor_z_m` is the height of the floor where this frame shows it.
    """

    instances: NDArray[np.int32]
    structure: NDArray[np.bool_]
    structure_shown: NDArray[np.bool_] | None = None
    alone: NDArray[np.int32] | None = None
    floor_z_m: float | None = None
    rejected: tuple[RejectedMask, ...] = ()

    def __post_init__(self) -> None:
        freeze(self, "instances", np.int32, (None, None))
        freeze(self, "structure", np.bool_, self.instances.shape)
        if self.structure_shown is not None:
            freeze(self, "structure_shown", np.bool_, self.instances.shape)
        if self.alone is not None:
            freeze(self, "alone", np.int32, self.instances.shape)

    @property
    def own_structure(self) -> NDArray[np.bool_]:
        """The structure (H, W) that this frame shows by itself."""
        return self.structure if self.structure_shown is None else self.structure_shown


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Returns:
    """The returns that the points of an observation were made of, where depth is in whole millimetres.

    `depth_mm` (h, w) uint16 within the box of the mask, 0 = not used; the points are their means over voxels of
    `voxel_m`. `checksum` is that of the points and of the pose of the frame: where it still is, the journal has the
    returns instead of the points.
    """

    depth_mm: NDArray[np.uint16]
    voxel_m: float
    checksum: int

    def __post_init__(self) -> None:
        freeze(self, "depth_mm", np.uint16, (None, None))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Observation:
    """One object in one keyframe, lifted to 3D; it has no feature yet.

    `index` numbers the observations of the frame from 0. `box_px` = (x0, y0, x1, y1), ends exclusive; `mask` (h, w)
    bool within it. `points_world` (N, 3) float32 and `colors` (N, 3) uint8, after depth filtering. `r_area` and
    `r_depth` are the cheap factors of S (Eq. for S in the paper), in 0..1. `is_cut`: the mask touches the border of the
    image. `group`: observations of one number > 0 are one thing as the frame by itself has it, without the map.
    `returns` are what the points were made of, where they can be made of it again to the byte.
    """

    index: int
    box_px: tuple[int, int, int, int]
    mask: NDArray[np.bool_]
    points_world: NDArray[np.float32]
    colors: NDArray[np.uint8]
    box: OrientedBox
    r_area: float
    r_depth: float
    is_cut: bool
    group: int = 0
    returns: Returns | None = None

    def __post_init__(self) -> None:
        x0, y0, x1, y1 = self.box_px
        freeze(self, "mask", np.bool_, (y1 - y0, x1 - x0))
        freeze(self, "points_world", np.float32, (None, 3))
        freeze(self, "colors", np.uint8, (len(self.points_world), 3))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SpaceObservation:
    """What one keyframe by itself says of space, as sorted voxel keys; the floor's height if it shows.

    `free_keys`: rays passed; `structure_keys`: on structure; `surface_keys`: on something, and on no structure.
    """

    free_keys: NDArray[np.int64]
    structure_keys: NDArray[np.int64]
    floor_z_m: float | None
    surface_keys: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    def __post_init__(self) -> None:
        freeze(self, "free_keys", np.int64, (None,))
        freeze(self, "structure_keys", np.int64, (None,))
        freeze(self, "surface_keys", np.int64, (None,))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MaskFeature:
    """The pooled feature of one mask: `pooled` (D,) float32 of unit norm; `variance` = sigma^2 over its patches."""

    observation_index: int
    variance: float
    pooled: NDArray[np.float32]

    def __post_init__(self) -> None:
        freeze(self, "pooled", np.float32, (None,))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CoarseFrame:
    """What the journal keeps of a keyframe's depth: the middle pixel of every cell of `stride_px` x `stride_px`.

    `depth_mm` (h, w) uint16 along the optical axis, 0 = no return; `structure` (h, w) bool: what was taken for floor,
    wall or ceiling; `camera` that of the whole image, None in older journals.
    """

    stride_px: int
    depth_mm: NDArray[np.uint16]
    structure: NDArray[np.bool_]
    camera: Camera | None = None

    def __post_init__(self) -> None:
        freeze(self, "depth_mm", np.uint16, (None, None))
        freeze(self, "structure", np.bool_, self.depth_mm.shape)
        if self.stride_px < 1 or self.depth_mm.size == 0:
            raise ValueError(f"cells of {self.stride_px} pixels, {self.depth_mm.shape} of them")


# ---- the map --------------------------------------------------------------------------------------------------------


class Phase(StrEnum):
    """The phases of a track; the rules between them are the table in `mapping/rules/lifecycle.py`."""

    TENTATIVE = "tentative"
    ACTIVE = "active"
    DORMANT = "dormant"
    ARCHIVED = "archived"
    ROOM = "room"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class View:
    """One kept view of an object; its pixels live in the file `name` of the map folder's `views/`.

    `score` is what the chosen strategy gives it (S by default); it, `variance` and `feature` (D,) are None for a view
    that was kept for its direction alone, whose features were never worth computing. `is_cut`: it touches the image's
    border.
    """

    object_id: int
    frame_index: int
    stamp_ns: int
    box_px: tuple[int, int, int, int]
    world_from_camera: NDArray[np.float64]
    r_area: float
    r_depth: float
    box_volume_m3: float
    score: float | None
    variance: float | None
    feature: NDArray[np.float32] | None
    is_cut: bool = False
    observation_index: int = 0

    def __post_init__(self) -> None:
        # They become the names of files.
        whole_number(self.frame_index, "frame")
        whole_number(self.observation_index, "observation")
        freeze(self, "world_from_camera", np.float64, (4, 4))
        if self.feature is not None:
            freeze(self, "feature", np.float32, (None,))

    @property
    def name(self) -> str:
        """The stem of the files that hold its pixels: frame and observation, which no merge ever changes."""
        return f"{self.frame_index:06d}-{self.observation_index:03d}"


@dataclass(frozen=True, kw_only=True, slots=True)
class Containment:
    """The certificate of layer 4: what was checked, how much of it lies in no primitive, the largest G of what does.

    Checked are the pieces of the surface and the points of layer 1, each with a ball of `margin_m` around it, and the
    cells of the inside. `is_certified` says that nothing is outside; `is_fallback` that a box around everything took
    the place of the primitives. Under the surface a shell of `shell_m` was not looked at: 0 for margins from about two
    hundredths of the longest side.
    """

    num_checked: int
    num_outside: int
    max_g: float
    is_certified: bool = False
    is_fallback: bool = False
    margin_m: float = 0.0
    shell_m: float = 0.0


FitKind = Literal["solid", "panels", "envelope"]


EMBEDDED = ("fused", "single_view")
"""The reconstructors that make up nothing but what follows from the views."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ObjectShape:
    """Layers 2 to 4 of an object.

    `mesh_name` is a file in the map folder's `shapes/`, in the object frame; `world_from_object` (4, 4) places it.
    `fitted` and `inflated` are in the world: the inflated ones in the order of those they hold, then boxes around what
    the fit left out; or one box around everything. `seen_share` (N,) is the share of each fitted primitive's surface
    that was seen rather than generated. `revision` is the ticket of the job that made it. `verdict` is why a generated
    shape took the place of the embedded one, or did not, with its numbers; "" where none was asked for. `fit_kind` says
    of what `fitted` is: of the solid, of a thing of thin panels, or of a hollow thing's envelope, which is larger.
    """

    revision: int
    reconstructor: str
    mesh_name: str
    mesh_sha256: str
    world_from_object: NDArray[np.float64]
    fitted: Superquadrics
    inflated: Superquadrics
    seen_share: NDArray[np.float64]
    containment: Containment
    verdict: str = ""
    fit_kind: FitKind = "solid"

    def __post_init__(self) -> None:
        plain_name(self.mesh_name, ".glb" if str(self.mesh_name).endswith(".glb") else ".mesh")
        check_bodies(self.fitted)
        check_bodies(self.inflated)
        if self.fit_kind not in get_args(FitKind):
            raise ValueError(f"layer 3 is of kind {self.fit_kind!r}, not one of {', '.join(get_args(FitKind))}")
        freeze(self, "world_from_object", np.float64, (4, 4))
        freeze(self, "seen_share", np.float64, (len(self.fitted),))

    @property
    def is_generated(self) -> bool:
        """Whether a generator made it: one was asked, and the embedded reconstructors did not have to stand in."""
        return bool(self.verdict) and self.reconstructor not in EMBEDDED


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, weakref_slot=True)
class TrackedObject(GivesUpArrays):
    """One object of the map: its layer 1, its views, and layers 2 to 4 once they were built.

    `points_world` (N, 3) float32, one per occupied voxel of the fixed lattice, with `colors` (N, 3) uint8; `feature`
    (D,) is the mean over its kept views, unit norm, or None; `views` is sorted by frame; `best_view` is among them;
    `merged_ids` are the tracks that were found to be this one. `sketch`, one superquadric in the world, is what the
    points alone say of its shape: of a confirmed object while it has no `shape`.
    """

    id: int
    phase: Phase
    submap_id: int
    sightings: int
    first_seen_ns: int
    last_seen_ns: int
    points_world: NDArray[np.float32]
    colors: NDArray[np.uint8]
    box: OrientedBox
    feature: NDArray[np.float32] | None
    views: tuple[View, ...]
    best_view: View | None
    shape: ObjectShape | None
    merged_ids: tuple[int, ...] = ()
    sketch: Superquadrics | None = None

    @property
    def superquadrics(self) -> Superquadrics | None:
        """Layer 3, or the sketch where there is none yet; None where there is neither."""
        return self.shape.fitted if self.shape is not None and len(self.shape.fitted) else self.sketch

    def __post_init__(self) -> None:
        # It becomes a part of files' names.
        whole_number(self.id, "object")
        freeze(self, "points_world", np.float32, (None, 3))
        freeze(self, "colors", np.uint8, (len(self.points_world), 3))
        if self.feature is not None:
            freeze(self, "feature", np.float32, (None,))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, weakref_slot=True)
class ObservedSpace(GivesUpArrays):
    """A sparse grid of what was seen: sorted voxel keys `free` and `structure`; everything else is unknown.

    `floor_z_m` is the floor's height, None while no floor was seen. All in the frame of the submap.
    """

    voxel_m: float
    free: NDArray[np.int64]
    structure: NDArray[np.int64]
    floor_z_m: float | None

    def __post_init__(self) -> None:
        freeze(self, "free", np.int64, (None,))
        freeze(self, "structure", np.int64, (None,))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MapPrior:
    """What the map knows before a keyframe, as the odometry has it since it last jumped.

    The observed `space`; the `objects`, tentative ones among them, with one point per voxel of `object_m`.
    """

    space: ObservedSpace
    objects: tuple[TrackedObject, ...]
    points_m: float


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Submap:
    """A piece of the map with one rigid place in the world: `world_from_submap` (4, 4), and the space seen in it.

    Its frame, in which the observed space is, is the world of the raw odometry: `world_from_submap` is the identity
    until it is corrected. Each voxel, like each object, is in the submap in which it was first seen.
    """

    id: int
    world_from_submap: NDArray[np.float64]
    observed_space: ObservedSpace

    def __post_init__(self) -> None:
        whole_number(self.id, "submap")
        freeze(self, "world_from_submap", np.float64, (4, 4))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, weakref_slot=True)
class SurveyedSubmap(GivesUpArrays):
    """A submap as a search for loops has it, when it was asked for.

    `anchor` (4, 4) is the camera's first pose in its frame, the node of the pose graph; `way_m` and `turn_rad` are how
    far the camera moved and turned in it, `after_jump` whether the odometry jumped before it. `registered` (6, 6) is
    the covariance of its least sure keyframe, None if not all were registered. `blind` and `unfixed` (6, 6) are the
    lengths of its way along which the odometry, and the registration of keyframes, saw nothing
    (`mapping/entities/submaps.py`); None: of no length. `points` and unit `normals` (N, 3) are its surface, `free` the
    sorted keys of voxels of `voxel_m` that were seen to be free.
    """

    id: int
    world_from_submap: NDArray[np.float64]
    anchor: NDArray[np.float64]
    way_m: float
    turn_rad: float
    after_jump: bool
    points: NDArray[np.float32]
    normals: NDArray[np.float32]
    free: NDArray[np.int64]
    voxel_m: float
    registered: NDArray[np.float64] | None = None
    blind: NDArray[np.float64] | None = None
    unfixed: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        whole_number(self.id, "submap")
        freeze(self, "world_from_submap", np.float64, (4, 4))
        freeze(self, "anchor", np.float64, (4, 4))
        for name in ("registered", "blind", "unfixed"):
            if getattr(self, name) is not None:
                freeze(self, name, np.float64, (6, 6))
        freeze(self, "points", np.float32, (None, 3))
        freeze(self, "normals", np.float32, (len(self.points), 3))
        freeze(self, "free", np.int64, (None,))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Loop:
    """Where a submap lies in an earlier one, as a search for loops found it, or why the search did not believe it.

    `earlier_from_later` (4, 4) is between the frames of the two submaps, both that of the odometry: the identity where
    the odometry did not drift. `covariance` (6, 6) is that of a small turn (radians), then shift (metres), of the
    later submap's anchor, in the frame of that anchor. `method` says what found it: the surfaces, from where the graph
    had them, or the objects, by an alignment; `score` is the share of the later surface that lies on the earlier one,
    where they overlap. `reason` says why it is no loop, None where it may be one: that is for the graph to decide.
    """

    earlier: int
    later: int
    earlier_from_later: NDArray[np.float64]
    covariance: NDArray[np.float64]
    method: Literal["surface", "objects"]
    score: float
    reason: str | None = None

    def __post_init__(self) -> None:
        whole_number(self.earlier, "submap")
        whole_number(self.later, "submap")
        freeze(self, "earlier_from_later", np.float64, (4, 4))
        freeze(self, "covariance", np.float64, (6, 6))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class GraphNode:
    """A submap in the pose graph: where its first camera pose is, and where odometry alone had put it.

    `place` and `uncorrected` (4, 4) are world_from_node; `stamp_ns` is when the submap was opened. `sigma_m` and
    `sigma_rad` are how uncertain the place is relative to the first node: the root of the summed variances along, and
    about, the three axes. `covariance_xy` (2, 2), m^2, is that of the place in the plane, along the world's axes.
    """

    submap_id: int
    stamp_ns: int
    place: NDArray[np.float64]
    uncorrected: NDArray[np.float64]
    sigma_m: float
    sigma_rad: float
    covariance_xy: NDArray[np.float64]

    def __post_init__(self) -> None:
        whole_number(self.submap_id, "submap")
        freeze(self, "place", np.float64, (4, 4))
        freeze(self, "uncorrected", np.float64, (4, 4))
        freeze(self, "covariance_xy", np.float64, (2, 2))


EdgeKind = Literal["odometry", "loop"]
EdgeStatus = Literal["accepted", "rejected", "withdrawn"]
EDGE_KINDS: tuple[EdgeKind, ...] = get_args(EdgeKind)
EDGE_STATUSES: tuple[EdgeStatus, ...] = get_args(EdgeStatus)


@dataclass(frozen=True, kw_only=True, slots=True)
class GraphEdge:
    """What odometry or a loop says of two submaps, by their ids, and whether the solution believes it.

    `residual_m` and `residual_rad` are how far the solution is from what it says; `score` is what the search said for a
    loop, None of odometry; `reason` says why a loop is not believed, or what is wrong with odometry, else it is "".
    `stamp_ns` is when the edge was found.
    """

    kind: EdgeKind
    earlier: int
    later: int
    status: EdgeStatus
    score: float | None
    reason: str
    residual_m: float
    residual_rad: float
    stamp_ns: int

    def __post_init__(self) -> None:
        if not 0 <= self.earlier < self.later:
            raise ValueError(f"an edge goes from an earlier submap to a later one, found {self.earlier}, {self.later}")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PoseGraphRecord:
    """The pose graph as of one moment: `nodes` sorted by submap, `edges` between them."""

    nodes: tuple[GraphNode, ...]
    edges: tuple[GraphEdge, ...]

    def __post_init__(self) -> None:
        ids = [node.submap_id for node in self.nodes]
        if ids != sorted(set(ids)):
            raise ValueError(f"the submaps of a graph's nodes are not in ascending order: {ids[:10]}")
        if unknown := {i for edge in self.edges for i in (edge.earlier, edge.later)} - set(ids):
            raise ValueError(f"an edge ends at submap {min(unknown)}, which the graph does not have")

    @property
    def loops(self) -> tuple[GraphEdge, ...]:
        """The edges that are loops."""
        return tuple(edge for edge in self.edges if edge.kind == "loop")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MapSnapshot:
    """The map as of one moment; `objects` sorted by id. `graph` is None of a map without a search for loops."""

    revision: int
    stamp_ns: int
    submaps: tuple[Submap, ...]
    objects: tuple[TrackedObject, ...]
    graph: PoseGraphRecord | None = None


# ---- what sinks are shown -------------------------------------------------------------------------------------------

DropCause = Literal["structure", "in structure", "looked through", "never confirmed"]
"""Why a track is no object: structure, a piece of some, nothing where it should be, or seen too seldom."""


DecisionKind = Literal[
    "associate",  # a mask with a track
    "create",  # a track, of a mask
    "merge",  # of two tracks
    "split",  # of a track off another one
    "part",  # of two tracks that a correction of the poses had merged
    "trim",  # of the points of a track that are those of a wall
    "phase",  # of a track
    "room",  # a track: set aside as part of the room, or an object after all
    "view",  # of a track: a better one, or none
    "shape",  # of a track: asked for, made, failed
    "reject",  # a mask
    "drop",  # a track
    "time_jump",  # of the stamps
    "pose_jump",  # of the odometry
    "keep_out",  # a keyframe that does not fit
    "pose_correction",  # of submaps
    "loop",  # was found, or is not believed
    "floor",  # is another one
]


@dataclass(frozen=True, kw_only=True, slots=True)
class Decision:
    """One decision and its reason, for people who ask why.

    `text` names the candidates and numbers. `observation_index`: the observation that went to the object (associate,
    create). `other_id`: the track that is now a part of the object (merge), or off which it was split (split). `cause`:
    why it was dropped.
    """

    kind: DecisionKind
    object_id: int | None
    text: str
    observation_index: int | None = None
    other_id: int | None = None
    cause: DropCause | None = None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FrameReport:
    """Everything about one frame that a sink may show.

    `keyframe_index` is None between keyframes; then there is no `frame`, no `segmentation`, no `snapshot`.
    `object_ids` (per observation) says which object each observation went to; `rejected` are the masks that became
    none; `space` is what the keyframe by itself says of space. `patches` (h, w, D) are the patch features of the frame,
    None where none were computed. `metrics` are named numbers for plots: stage timings in seconds under `time/...`,
    queue lengths under `queue/...`, S under `score/ID`.
    """

    index: int
    stamp_ns: int
    keyframe_index: int | None
    camera: Camera
    world_from_camera: NDArray[np.float64]
    color_bytes: bytes | None
    frame: Frame | None = None
    segmentation: Segmentation | None = None
    observations: tuple[Observation, ...] = ()
    object_ids: tuple[int | None, ...] = ()
    rejected: tuple[RejectedMask, ...] = ()
    space: SpaceObservation | None = None
    patches: NDArray[np.float32] | None = None
    decisions: tuple[Decision, ...] = ()
    snapshot: MapSnapshot | None = None
    metrics: tuple[tuple[str, float], ...] = field(default=())

    def __post_init__(self) -> None:
        freeze(self, "world_from_camera", np.float64, (4, 4))
        if self.patches is not None:
            freeze(self, "patches", np.float32, (None, None, None))
