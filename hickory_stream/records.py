"""Records that the parts of the system exchange.

All are frozen; arrays are checked for dtype and shape and made read-only, so that threads can share them. Stamps are
integer nanoseconds; the world is z up; lengths are metres.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.confined import plain_name, whole_number
from hickory_stream.geometry.arrays import freeze, freeze_all
from hickory_stream.geometry.boxes import OrientedBox
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.depth_sensor import DepthSensor
from hickory_stream.geometry.lazy_arrays import GivesUpArrays
from hickory_stream.geometry.rigid import no_directions
from hickory_stream.geometry.superquadric import Superquadrics, check_bodies


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Frame:
    """A decoded, posed RGB-D frame; colour and depth are registered pixel by pixel.

    `rgb` (H, W, 3) uint8; `depth_m` (H, W) float32 along the optical axis, NaN = no return, range and bias corrected;
    `world_from_camera` (4, 4). `sensor` models the depth. `degenerate` (K, 6): unit directions in the camera's frame,
    rotation first, about which the scans of an estimated pose gave no information.
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
    """A posed, compressed frame: only keyframes are decoded.

    `decode()` returns the `Frame`; raises `RecordingError` for a torn image. `color_bytes`: the log's own JPEG or PNG,
    or None. `after_from_before` (4, 4): the odometry jumped since the frame before, from its old world to its new one;
    poses themselves stay in the first world. `goes_back`: a seek back to this frame; the map becomes that of the time
    before it. `is_posed`: False while odometry has yet to add the pose (`players/poses/odometry_source.py`).
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
    """A sweep of a LiDAR, for odometry: `points` (N, 3) float32 in the sensor's `frame`, all finite."""

    stamp_ns: int
    frame: str
    points: NDArray[np.float32]
    #: (N,) float32 since the stamp; None if the log lacks them.
    times_s: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        freeze(self, "points", np.float32, (None, 3))
        if self.times_s is not None:
            freeze(self, "times_s", np.float32, (len(self.points),))


@dataclass(frozen=True, kw_only=True, slots=True)
class SourceInfo:
    """Facts about a source, for the operator, the progress bar and the manifest; None if unknown beforehand."""

    uri: str
    kind: str
    #: Distinguishes logs.
    identity: str
    camera: Camera
    num_frames: int | None
    start_ns: int | None
    end_ns: int | None
    #: Role (color, depth, camera_info, pose, ...) and its topic or file pattern.
    streams: tuple[tuple[str, str], ...]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RejectedMask:
    """A mask that became no observation, and why; `box_px` = (x0, y0, x1, y1), the ends exclusive."""

    box_px: tuple[int, int, int, int]
    reason: str
    #: (h, w) within the box, None if only the box is known.
    mask: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        x0, y0, x1, y1 = self.box_px
        if self.mask is not None:
            freeze(self, "mask", np.bool_, (y1 - y0, x1 - x0))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SemanticImage:
    """The class of each pixel: `classes` (H, W) int32, places in `labels`, -1 if unknown."""

    classes: NDArray[np.int32]
    labels: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze(self, "classes", np.int32, (None, None))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Segmentation:
    """The segmentation of a frame; images are (H, W).

    `instances` int32, 0 = no object, 1..n; `structure` bool: floor, walls, ceiling. `structure_shown`: the part that
    this frame shows without the map, None: all; only this is evidence for the map. `alone` int32: instances without the
    map, each a union of some `instances`, None: the same. `floor_z_m`: height of the floor, if visible.
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
        """The structure (H, W) that this frame shows without the map."""
        return self.structure if self.structure_shown is None else self.structure_shown


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Returns:
    """The returns behind the points of an observation, for depth in whole millimetres.

    `depth_mm` (h, w) uint16 of every `step_px`-th pixel within the mask's box, 0 = not used; points are their means
    over voxels of `voxel_m`. While `checksum` fits points and pose, the journal stores the returns instead of the
    points.
    """

    depth_mm: NDArray[np.uint16]
    voxel_m: float
    checksum: int
    step_px: int = 1

    def __post_init__(self) -> None:
        freeze(self, "depth_mm", np.uint16, (None, None))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Observation:
    """One object in one keyframe, lifted to 3D, without a feature yet.

    `index` counts in the frame from 0. `box_px` = (x0, y0, x1, y1), ends exclusive; `mask` (h, w) within it.
    `points_world` (N, 3) float32 and `colors` (N, 3) uint8, after depth filtering. `r_area`, `r_depth`: cheap factors
    of S (Eq. for S in the paper), in 0..1. `is_cut`: the mask touches the image's border. `group`: equal numbers > 0
    are one instance without the map. `returns`: if they give the points to the byte. `behind`: the plane (unit normal
    to the camera, offset) in the world that it is flush with, None: no such plane was seen beside it. `drawn`: the
    share of the mask's outline that has returns or a step in colour beside it.
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
    behind: tuple[float, float, float, float] | None = None
    drawn: float = 1.0

    def __post_init__(self) -> None:
        x0, y0, x1, y1 = self.box_px
        freeze(self, "mask", np.bool_, (y1 - y0, x1 - x0))
        freeze(self, "points_world", np.float32, (None, 3))
        freeze(self, "colors", np.uint8, (len(self.points_world), 3))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SpaceObservation:
    """The space that one keyframe shows, as sorted voxel keys; the floor's height if visible.

    `free_keys`: passed by rays; `structure_keys`: on structure; `surface_keys`: on other surfaces.
    """

    free_keys: NDArray[np.int64]
    structure_keys: NDArray[np.int64]
    floor_z_m: float | None
    surface_keys: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    def __post_init__(self) -> None:
        freeze_all(self, np.int64, free_keys=(None,), structure_keys=(None,), surface_keys=(None,))


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
    """A keyframe's depth in the journal: the middle pixel of every cell of `stride_px` x `stride_px`.

    `depth_mm` (h, w) uint16 along the optical axis, 0 = no return; `structure` (h, w): floor, wall or ceiling; `camera`
    of the whole image.
    """

    stride_px: int
    depth_mm: NDArray[np.uint16]
    structure: NDArray[np.bool_]
    camera: Camera

    def __post_init__(self) -> None:
        freeze(self, "depth_mm", np.uint16, (None, None))
        freeze(self, "structure", np.bool_, self.depth_mm.shape)
        if self.stride_px < 1 or self.depth_mm.size == 0:
            raise ValueError(f"cells of {self.stride_px} pixels, {self.depth_mm.shape} of them")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, weakref_slot=True)
class Keypoints(GivesUpArrays):
    """Point features of a keyframe with depth, by which its place is recognised: 44 bytes each.

    Binary `descriptors` (N, 32) and `points` (N, 3) in its `camera`, which is at `world_from_camera` (4, 4).
    """

    camera: Camera
    world_from_camera: NDArray[np.float64]
    descriptors: NDArray[np.uint8]
    points: NDArray[np.float32]

    def __post_init__(self) -> None:
        freeze(self, "world_from_camera", np.float64, (4, 4))
        freeze(self, "descriptors", np.uint8, (None, 32))
        freeze(self, "points", np.float32, (len(self.descriptors), 3))


class Phase(StrEnum):
    """The phases of a track; the rules between them are the table in `mapping/rules/lifecycle.py`."""

    TENTATIVE = "tentative"
    ACTIVE = "active"
    DORMANT = "dormant"
    ARCHIVED = "archived"

    @classmethod
    def _missing_(cls, value: object) -> "Phase | None":
        # Earlier versions kept tracks of the room apart; they were no objects.
        return cls.TENTATIVE if value == "room" else None


class ObjectKind(StrEnum):
    """What a track is: a fixture is built in, hangs, is attached to the room, or is too large to be carried."""

    OBJECT = "object"
    FIXTURE = "fixture"

    @classmethod
    def of(cls, fixture_probability: float) -> "ObjectKind":
        """Return the likelier kind."""
        return cls.FIXTURE if fixture_probability > 0.5 else cls.OBJECT


def kind_text(fixture_probability: float) -> str:
    """Return the likelier kind and its probability as text, e.g. "fixture 0.93"."""
    return f"{ObjectKind.of(fixture_probability)} {max(fixture_probability, 1 - fixture_probability):.2f}"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class View:
    """One kept view of an object; its pixels are the file `name` in the map folder's `views/`.

    `score` is of the chosen strategy (S by default); it, `variance` and `feature` (D,) are None for a view kept for its
    direction alone. `is_cut`: it touches the image's border.
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
        """The stem of its files: frame and observation, which merges never change."""
        return f"{self.frame_index:06d}-{self.observation_index:03d}"


@dataclass(frozen=True, kw_only=True, slots=True)
class Containment:
    """The certificate of layer 4: what was checked, how much is in no primitive, and the largest G of the rest.

    Checked are pieces of the surface and points of layer 1, each with a ball of `margin_m`, and cells of the inside.
    `is_certified`: nothing is outside. `is_fallback`: one box replaces the primitives. A shell of `shell_m` under the
    surface is not checked: 0 for margins from about two hundredths of the longest side.
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
    """Layers 2 to 4 of an object, made by the job `revision`.

    `mesh_name`: a file in `shapes/`, in the object frame, placed by `world_from_object` (4, 4). `fitted`, `inflated`:
    in the world; inflated ones in the same order, then boxes around the rest, or one box for all. `seen_share` (N,):
    share of each fitted surface that was seen, not generated. `verdict`: why a generated shape replaced the embedded
    one or not, "" without one. `fit_kind`: `fitted` is of the solid, of thin panels, or of a hollow thing's envelope,
    which is larger.
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
        freeze_all(self, np.float64, world_from_object=(4, 4), seen_share=(len(self.fitted),))

    @property
    def is_generated(self) -> bool:
        """Whether a generator made it, without fallback to the embedded reconstructors."""
        return bool(self.verdict) and self.reconstructor not in EMBEDDED


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, weakref_slot=True)
class TrackedObject(GivesUpArrays):
    """One object of the map: layer 1, views, and layers 2 to 4 once built.

    `points_world` (N, 3) float32, one per occupied lattice voxel, with `colors` (N, 3) uint8; `feature` (D,): mean over
    kept views, unit norm, or None; `views`: by frame, `best_view` among them; `merged_ids`: tracks merged into it.
    `sketch`: one superquadric in the world from points alone, of a confirmed object without `shape`. `kind` is the
    likelier one by `fixture_probability`.
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
    kind: ObjectKind = ObjectKind.OBJECT
    fixture_probability: float = 0.0

    @property
    def is_fixture(self) -> bool:
        """Whether it is a fixture rather than an object."""
        return self.kind is ObjectKind.FIXTURE

    @property
    def superquadrics(self) -> Superquadrics | None:
        """Layer 3, else the sketch; None without either."""
        return self.shape.fitted if self.shape is not None and len(self.shape.fitted) else self.sketch

    def __post_init__(self) -> None:
        # It becomes a part of files' names.
        whole_number(self.id, "object")
        freeze(self, "points_world", np.float32, (None, 3))
        freeze(self, "colors", np.uint8, (len(self.points_world), 3))
        if self.feature is not None:
            freeze(self, "feature", np.float32, (None,))


def number_of_kinds(items: Collection[TrackedObject]) -> str:
    """Return how many objects and fixtures there are, in words."""
    fixtures = sum(item.is_fixture for item in items)
    objects = len(items) - fixtures
    words = f"{objects} {'object' if objects == 1 else 'objects'}"
    return f"{words}, {fixtures} {'fixture' if fixtures == 1 else 'fixtures'}" if fixtures else words


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, weakref_slot=True)
class ObservedSpace(GivesUpArrays):
    """A sparse grid in the submap's frame: sorted voxel keys `free` and `structure`; all else is unknown."""

    voxel_m: float
    free: NDArray[np.int64]
    structure: NDArray[np.int64]
    #: None while no floor was seen.
    floor_z_m: float | None

    def __post_init__(self) -> None:
        freeze_all(self, np.int64, free=(None,), structure=(None,))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MapPrior:
    """The map before a keyframe, in the odometry's world since its last jump."""

    space: ObservedSpace
    #: Tentative ones included, with one point per voxel of `object_m`.
    objects: tuple[TrackedObject, ...]
    points_m: float


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Submap:
    """A piece of the map with one rigid pose, `world_from_submap` (4, 4), and the space seen in it.

    Its frame is the world of the raw odometry: the pose is the identity until corrected. Voxels and objects belong to
    the submap in which they were first seen.
    """

    id: int
    world_from_submap: NDArray[np.float64]
    observed_space: ObservedSpace

    def __post_init__(self) -> None:
        whole_number(self.id, "submap")
        freeze(self, "world_from_submap", np.float64, (4, 4))


# Sigmas of a jump of the odometry of unknown size.
OPEN_JUMP_M, OPEN_JUMP_RAD = 30.0, 3.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, weakref_slot=True)
class SurveyedSubmap(GivesUpArrays):
    """A submap at the time of a loop search.

    `anchor` (4, 4): first camera pose in its frame, the node of the pose graph. `way_m`, `turn_rad`: path length and
    turns of the camera; `after_jump`: the odometry jumped before it, which leaves `jump_m`, `jump_rad` (1 sigma) open.
    `registered` (6, 6): covariance of its least certain keyframe, or None. `blind`, `unfixed` (6, 6): path lengths
    without information of odometry, of registration (`mapping/entities/submaps.py`), None: zero. `points`, unit
    `normals` (N, 3): its surface; `free`: sorted keys of free voxels of `voxel_m`. `keypoints`: of its
    keyframes.
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
    keypoints: tuple[Keypoints, ...] = ()
    jump_m: float = OPEN_JUMP_M
    jump_rad: float = OPEN_JUMP_RAD

    def __post_init__(self) -> None:
        whole_number(self.id, "submap")
        freeze_all(self, np.float64, world_from_submap=(4, 4), anchor=(4, 4))
        for name in ("registered", "blind", "unfixed"):
            if getattr(self, name) is not None:
                freeze(self, name, np.float64, (6, 6))
        freeze_all(self, np.float32, points=(None, 3), normals=(len(self.points), 3))
        freeze(self, "free", np.int64, (None,))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Loop:
    """The pose of a submap in an earlier one, found by a loop search, or why it was rejected.

    `earlier_from_later` (4, 4): between the submaps' frames, the identity without drift. `covariance` (6, 6): small
    rotation (rad), then shift (m), of the later anchor in its own frame. `method`: by surfaces from the graph's poses,
    by keypoints, or by an alignment of objects. `score`: share of the overlapping later surface on the earlier one.
    `reason`: why it is no loop, None for a candidate, which the graph decides.
    """

    earlier: int
    later: int
    earlier_from_later: NDArray[np.float64]
    covariance: NDArray[np.float64]
    method: Literal["surface", "appearance", "objects"]
    score: float
    reason: str | None = None

    def __post_init__(self) -> None:
        whole_number(self.earlier, "submap")
        whole_number(self.later, "submap")
        freeze_all(self, np.float64, earlier_from_later=(4, 4), covariance=(6, 6))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class GraphNode:
    """A submap in the pose graph: its first camera pose (4, 4) by the solution (`place`) and by odometry.

    `stamp_ns`: the submap's beginning. `sigma_m`, `sigma_rad`: uncertainty relative to the first node, root of the
    summed variances along and about three axes. `covariance_xy` (2, 2), m^2: in the plane, along the world's axes.
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
        freeze_all(self, np.float64, place=(4, 4), uncorrected=(4, 4), covariance_xy=(2, 2))


EdgeKind = Literal["odometry", "loop"]
EdgeStatus = Literal["accepted", "rejected", "withdrawn"]
EDGE_KINDS: tuple[EdgeKind, ...] = get_args(EdgeKind)
EDGE_STATUSES: tuple[EdgeStatus, ...] = get_args(EdgeStatus)


@dataclass(frozen=True, kw_only=True, slots=True)
class GraphEdge:
    """A constraint of odometry or a loop between two submaps, and whether the solution accepts it.

    `residual_m`, `residual_rad`: its distance from the solution. `score`: of a loop's search, else None. `reason`: why
    a loop is rejected, or what is wrong with odometry, else "". `stamp_ns`: when it was found.
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
    """The pose graph at one moment: `nodes` by submap, `edges` between them."""

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
    """The map at one moment; `objects` by id; `graph` is None without loop search."""

    revision: int
    stamp_ns: int
    submaps: tuple[Submap, ...]
    objects: tuple[TrackedObject, ...]
    graph: PoseGraphRecord | None = None


DropCause = Literal["structure", "in structure", "looked through", "never confirmed"]
"""Why a track is not in the map: nothing where it should be, or seen too seldom; the first two by earlier versions."""


DecisionKind = Literal[
    "associate",  # a mask with a track
    "create",  # a track, of a mask
    "merge",  # of two tracks
    "split",  # of a track off another one
    "part",  # of two tracks that a correction of the poses had merged
    "trim",  # of a track's points in a wall, by earlier versions
    "phase",  # of a track
    "kind",  # of a track: an object or a fixture
    "room",  # the same, by earlier versions
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
    """One decision and its reason, for people.

    `text` has candidates and numbers. `observation_index`: the observation of the object (associate, create).
    `other_id`: the track merged into the object, or the one it was split off. `cause`: of a drop.
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

    `keyframe_index`: None between keyframes, then without `frame`, `segmentation`, `snapshot`. `object_ids`: the object
    of each observation; `rejected`: masks without one; `space`: seen by this keyframe. `patches` (h, w, D): features,
    or None. `metrics`: numbers for plots: seconds under `time/...`, queue lengths under `queue/...`, S under
    `score/ID`.
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
