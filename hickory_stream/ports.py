"""The extension points: plain, blocking Python objects that know nothing of asyncio.

`hickory_stream.testing` has an in-memory fake of each.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.depth_sensor import DepthSensor

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    import numpy as np
    from numpy.typing import NDArray

    from hickory_stream.geometry.boxes import OrientedBox
    from hickory_stream.geometry.camera import Camera
    from hickory_stream.geometry.mesh import Mesh
    from hickory_stream.geometry.superquadric import Superquadrics
    from hickory_stream.records import (
        Containment,
        FitKind,
        Frame,
        FrameReport,
        MapPrior,
        RawFrame,
        Scan,
        Segmentation,
        SemanticImage,
        SourceInfo,
    )


class Source(Protocol):
    """A log or a camera: posed RGB-D frames in the order of their stamps."""

    @property
    def info(self) -> SourceInfo:
        """What was found when the source was opened."""

    def frames(self) -> Iterator[RawFrame]:
        """Yield the frames from the beginning; each call starts anew."""

    def ledger(self) -> Mapping[str, int]:
        """Return how many messages or files had which fate so far, e.g. `frames`, `color_without_depth`."""

    def close(self) -> None:
        """Release files and devices."""


class MessageAccount(Protocol):
    """Where every message of a source went: each in one bucket."""

    def as_dict(self) -> dict[str, Any]:
        """Return it as JSON knows it: the sums by bucket, and the entries of each topic."""


@runtime_checkable
class Accounting(Protocol):
    """An ability of a source: it keeps account of its messages, not only of its frames."""

    def account(self) -> MessageAccount | None:
        """Return where the messages went so far; None where a source that this one plays keeps no account."""


@runtime_checkable
class Interruptible(Protocol):
    """An ability of a source: it may wait for a frame for ever, and can be woken."""

    def interrupt(self) -> None:
        """End the frames; may be called from any thread."""


@runtime_checkable
class Seekable(Protocol):
    """An ability of a source: somebody may seek in it, and the map then cannot be made again from the log.

    A source whose frames ever say `goes_back` has it.
    """

    @property
    def num_seeks(self) -> int:
        """How often that has happened."""


@runtime_checkable
class Estimating(Protocol):
    """An ability of a source: it estimates its poses itself, and goes on from those of an earlier, interrupted run."""

    @property
    def poses_by(self) -> str:
        """What estimates them, "" where nothing does."""

    def continue_from(self, stamp_ns: int, world_from_camera: NDArray[np.float64]) -> None:
        """Place what follows the frame of this stamp by the pose (4, 4) that the journal has of it."""


def account_of(source: Source) -> MessageAccount | None:
    """Return where the messages of a source went; None where it keeps no account."""
    return source.account() if isinstance(source, Accounting) else None


def interrupt(source: Source) -> None:
    """Wake a source that may be waiting for a frame; one that never waits need not be able to."""
    if isinstance(source, Interruptible):
        source.interrupt()


def poses_by(source: Source) -> str:
    """Return what estimates the poses of a source, "" where they are in its log."""
    return source.poses_by if isinstance(source, Estimating) else ""


def continue_from(source: Source, stamp_ns: int, world_from_camera: NDArray[np.float64]) -> None:
    """Tell a source which pose its last frame had; one whose poses are in the log need not be told."""
    if isinstance(source, Estimating):
        source.continue_from(stamp_ns, world_from_camera)


def num_seeks(source: Source) -> int:
    """Return how often somebody sought in a source."""
    return source.num_seeks if isinstance(source, Seekable) else 0


class SourceAround:
    """A `Source` that plays another one; what a subclass does not change is passed on, optional abilities included."""

    def __init__(self, source: Source) -> None:
        self._source = source

    @property
    def info(self) -> SourceInfo:
        """That of the other one."""
        return self._source.info

    def frames(self) -> Iterator[RawFrame]:
        """Yield the frames of the other one."""
        return self._source.frames()

    def ledger(self) -> Mapping[str, int]:
        """Return that of the other one."""
        return self._source.ledger()

    def account(self) -> MessageAccount | None:
        """Return where the messages went, where the other source keeps account of them."""
        return account_of(self._source)

    def interrupt(self) -> None:
        """Wake the other source, where it may be waiting."""
        interrupt(self._source)

    @property
    def poses_by(self) -> str:
        """What estimates the poses of the other source."""
        return poses_by(self._source)

    def continue_from(self, stamp_ns: int, world_from_camera: NDArray[np.float64]) -> None:
        """Tell the other source which pose its last frame had."""
        continue_from(self._source, stamp_ns, world_from_camera)

    @property
    def num_seeks(self) -> int:
        """How often somebody sought in the other source."""
        return num_seeks(self._source)

    def close(self) -> None:
        """Close the other one."""
        self._source.close()


class Segmenter(Protocol):
    """Finds the instances in a frame."""

    def prepare(self, frame: Frame) -> object:
        """Return what can be computed of a frame without the map; called ahead, on another thread than `segment`."""

    def segment(self, frame: Frame, prior: MapPrior | None = None, prepared: object = None) -> Segmentation:
        """Return the instances and the structure of a frame.

        `prior` is what the map knows so far; `prepared` is what `prepare` returned, or None.
        """


@runtime_checkable
class Moving(Protocol):
    """An ability of a segmenter: what it has prepared of a frame need not be prepared anew where the pose changes."""

    def moved(self, prepared: object, world_from_camera: NDArray[np.float64]) -> object:
        """Return what was prepared of a frame for another pose (4, 4) of it; None where that must be done anew."""


def prepared_at(segmenter: Segmenter, prepared: object, world_from_camera: NDArray[np.float64]) -> object:
    """Return what a segmenter has prepared of a frame, for another pose (4, 4) of it; None: `segment` prepares."""
    return segmenter.moved(prepared, world_from_camera) if isinstance(segmenter, Moving) else None


class FeatureExtractor(Protocol):
    """Dense patch features, with DINOv2's interface."""

    @property
    def name(self) -> str:
        """What tells this extractor's features from those of others: cosines between two extractors mean nothing."""

    @property
    def patch_px(self) -> int:
        """The side of a patch."""

    @property
    def dim(self) -> int:
        """The length D of a feature."""

    def extract(self, rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Return (h, w, D) float32 features of unit norm, one per patch; h = ceil(H / patch), w = ceil(W / patch)."""


class SemanticModel(Protocol):
    """Names what pixels show: what is structure, and what moves of itself."""

    @property
    def labels(self) -> tuple[str, ...]:
        """The names of its classes, by their ids."""

    def classify(self, rgb: NDArray[np.uint8]) -> SemanticImage:
        """Return the class of every pixel of an image (H, W, 3)."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Crop:
    """The pixels of a kept view: a cut-out of a frame with its own camera.

    `rgb` (h, w, 3) uint8, `depth_m` (h, w) float32 with NaN, `mask` (h, w) bool; `world_from_camera` (4, 4); the
    depth is worth what `sensor` says.
    """

    rgb: NDArray[np.uint8]
    depth_m: NDArray[np.float32]
    mask: NDArray[np.bool_]
    camera: Camera
    world_from_camera: NDArray[np.float64]
    sensor: DepthSensor = field(default_factory=DepthSensor)

    def __post_init__(self) -> None:
        size = (self.camera.height, self.camera.width)
        freeze(self, "rgb", "u1", (*size, 3))
        freeze(self, "depth_m", "f4", size)
        freeze(self, "mask", "?", size)
        freeze(self, "world_from_camera", "f8", (4, 4))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ShapeInputs:
    """All that a reconstructor may use: `crops` (the best view first), layer 1, the box, and the height of the support.

    `points_world` (N, 3) float32, `colors` (N, 3) uint8.
    """

    crops: tuple[Crop, ...]
    points_world: NDArray[np.float32]
    colors: NDArray[np.uint8]
    box: OrientedBox
    support_z_m: float | None

    def __post_init__(self) -> None:
        freeze(self, "points_world", "f4", (None, 3))
        freeze(self, "colors", "u1", (len(self.points_world), 3))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Reconstruction:
    """Layer 2: a mesh in the object frame, and its place `world_from_object` (4, 4).

    Of a reconstructor that chooses between shapes `made_by` says whose this is, and `verdict` why; "" of others.
    `hit_limit`: something was given up at a limit of time or memory, so that it may come out otherwise again.
    """

    mesh: Mesh
    world_from_object: NDArray[np.float64]
    made_by: str = ""
    verdict: str = ""
    hit_limit: bool = False

    def __post_init__(self) -> None:
        freeze(self, "world_from_object", "f8", (4, 4))


@dataclass(frozen=True, kw_only=True, slots=True)
class NoShape:
    """No shape can be made of this input: an expected outcome; `hit_limit` as in `Reconstruction`."""

    reason: str
    hit_limit: bool = False


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class GeneratedMesh:
    """What a generator made: a mesh in a frame and scale of its own.

    `camera_from_mesh` (4, 4), a similarity, is where it says that it lies in the best view's camera, None where it does
    not say. `num_views` are the views that it was shown, the best ones first.
    """

    mesh: Mesh
    camera_from_mesh: NDArray[np.float64] | None = None
    num_views: int = 1

    def __post_init__(self) -> None:
        if self.camera_from_mesh is not None:
            freeze(self, "camera_from_mesh", "f8", (4, 4))


class MeshGenerator(Protocol):
    """Makes a whole mesh of an object from images of it, in no particular place and size."""

    @property
    def name(self) -> str:
        """What the map says that a shape is by."""

    def generate(self, inputs: ShapeInputs) -> GeneratedMesh | NoShape:
        """Return the mesh, or why there is none."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MeshPlacement:
    """Where a mesh of unknown place and size lies: `world_from_mesh` (4, 4), affine.

    It enlarges by `scale`, and by `stretch` (3,), whose product is 1, along `stretch_axes` (3, 3), columns in the
    mesh's frame. `cost` is what contradicts it, 0 for nothing. `sigma_m`, `sigma_rad` and `sigma_scale` (a share) say
    how sharply the evidence determines it. `is_symmetric`: turned otherwise the mesh fits as well and is the same
    surface; `margin` in 0..1 is by how much less the best pose with another surface fits, 0 for not at all.
    """

    world_from_mesh: NDArray[np.float64]
    scale: float
    stretch: NDArray[np.float64]
    stretch_axes: NDArray[np.float64]
    cost: float
    sigma_m: float
    sigma_rad: float
    sigma_scale: float
    is_symmetric: bool
    margin: float

    def __post_init__(self) -> None:
        freeze(self, "world_from_mesh", "f8", (4, 4))
        freeze(self, "stretch", "f8", (3,))
        freeze(self, "stretch_axes", "f8", (3, 3))


@dataclass(frozen=True, kw_only=True, slots=True)
class NotPlaced:
    """It cannot be said where a mesh lies: an expected outcome."""

    reason: str


class PoseRefiner(Protocol):
    """Places a mesh of unknown place and size in the world."""

    @property
    def name(self) -> str:
        """The name by which the configuration chooses it."""

    def place(
        self, mesh: Mesh, inputs: ShapeInputs, guess: NDArray[np.float64] | None = None
    ) -> MeshPlacement | NotPlaced:
        """Return where the mesh lies by what was seen of the object; `guess` is world_from_mesh as somebody has it."""


class Reconstructor(Protocol):
    """Makes layer 2."""

    @property
    def name(self) -> str:
        """The name by which the configuration chooses it."""

    def reconstruct(self, inputs: ShapeInputs) -> Reconstruction | NoShape:
        """Return a complete, closed, coloured mesh, or why there is none. Deterministic."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class BuiltShape:
    """Layers 2 to 4 as one job makes them; superquadrics in the world.

    `seen_share` (N,) and `fit_kind` are as in `ObjectShape`.
    `timings_s` are for people, not for the map.
    """

    reconstruction: Reconstruction
    fitted: Superquadrics
    inflated: Superquadrics
    seen_share: NDArray[np.float64]
    containment: Containment
    timings_s: Mapping[str, float]
    fit_kind: FitKind = "solid"

    def __post_init__(self) -> None:
        freeze(self, "seen_share", "f8", (len(self.fitted),))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Registered:
    """Where a scan was taken: `start_from_sensor` (4, 4), the sensor's pose in its frame at the first scan.

    `information` (6, 6) is that of the pose's error in the sensor's frame, rotation (rad) first, then translation (m);
    None where the method does not say. `degenerate` (K, 6) are unit directions, in the same order, along which the scan
    says nothing: there the pose is the predicted one.
    """

    stamp_ns: int
    start_from_sensor: NDArray[np.float64]
    information: NDArray[np.float64] | None
    degenerate: NDArray[np.float64]

    def __post_init__(self) -> None:
        freeze(self, "start_from_sensor", "f8", (4, 4))
        freeze(self, "degenerate", "f8", (None, 6))
        if self.information is not None:
            freeze(self, "information", "f8", (6, 6))


@dataclass(frozen=True, kw_only=True, slots=True)
class NotRegistered:
    """It cannot be said where a scan was taken: an expected outcome."""

    reason: str


class Odometry(Protocol):
    """Estimates the motion of a sensor from its scans; the same scans in the same order give the same poses."""

    @property
    def name(self) -> str:
        """The name by which `--odometry` chooses it."""

    def register(self, scan: Scan, last_from_scan: NDArray[np.float64] | None = None) -> Registered | NotRegistered:
        """Return where a scan was taken; `last_from_scan` (4, 4) is the motion since the last, where somebody knows.

        The first scan is where the poses start, at the identity. A scan that cannot be registered changes nothing.
        """


class Sink(Protocol):
    """Shows or stores what happened. Called from one thread of its own, in the order of the frames."""

    def show(self, report: FrameReport) -> None:
        """Take one report."""

    def close(self) -> None:
        """Finish what was begun; no `show` follows."""
