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
        """The diagnosis on opening."""

    def frames(self) -> Iterator[RawFrame]:
        """Yield the frames from the beginning, at every call."""

    def ledger(self) -> Mapping[str, int]:
        """Return counts of messages or files by use, e.g. `frames`, `color_without_depth`."""

    def close(self) -> None:
        """Release files and devices."""


class MessageAccount(Protocol):
    """Account of every message of a source, each in one bucket."""

    def as_dict(self) -> dict[str, Any]:
        """Return JSON: sums by bucket, and the entries of each topic."""


@runtime_checkable
class Accounting(Protocol):
    """An optional ability of a source: it accounts for its messages, not only for frames."""

    def account(self) -> MessageAccount | None:
        """Return the account so far; None if a source that this one plays keeps none."""


@runtime_checkable
class Interruptible(Protocol):
    """An optional ability of a source: it may wait for a frame without limit, and can be woken."""

    def interrupt(self) -> None:
        """End the frames, from any thread."""


@runtime_checkable
class Seekable(Protocol):
    """An optional ability of a source: seeks, after which the log alone cannot reproduce the map.

    A source whose frames ever say `goes_back` has it.
    """

    @property
    def num_seeks(self) -> int:
        """Number of seeks so far."""


@runtime_checkable
class Estimating(Protocol):
    """An optional ability of a source: it estimates its poses, and continues those of an interrupted run."""

    @property
    def poses_by(self) -> str:
        """Name of the estimator, "" without one."""

    def continue_from(self, stamp_ns: int, world_from_camera: NDArray[np.float64]) -> None:
        """Continue after the frame of this stamp, from its pose (4, 4) in the journal."""


def account_of(source: Source) -> MessageAccount | None:
    """Return the account of a source's messages; None if it keeps none."""
    return source.account() if isinstance(source, Accounting) else None


def interrupt(source: Source) -> None:
    """Wake a source that may wait for a frame."""
    if isinstance(source, Interruptible):
        source.interrupt()


def poses_by(source: Source) -> str:
    """Return the estimator of a source's poses, "" for poses of the log."""
    return source.poses_by if isinstance(source, Estimating) else ""


def continue_from(source: Source, stamp_ns: int, world_from_camera: NDArray[np.float64]) -> None:
    """Give a source that estimates poses the pose of its last frame."""
    if isinstance(source, Estimating):
        source.continue_from(stamp_ns, world_from_camera)


def num_seeks(source: Source) -> int:
    """Return the number of seeks in a source."""
    return source.num_seeks if isinstance(source, Seekable) else 0


class SourceAround:
    """A `Source` that plays another one; whatever a subclass does not override is passed on, optional abilities too."""

    def __init__(self, source: Source) -> None:
        self._source = source

    @property
    def played(self) -> Source:
        """The other source."""
        return self._source

    @property
    def info(self) -> SourceInfo:
        """The other source's."""
        return self._source.info

    def frames(self) -> Iterator[RawFrame]:
        """Yield the other source's frames."""
        return self._source.frames()

    def ledger(self) -> Mapping[str, int]:
        """Return the other source's ledger."""
        return self._source.ledger()

    def account(self) -> MessageAccount | None:
        """Return the other source's account, if it keeps one."""
        return account_of(self._source)

    def interrupt(self) -> None:
        """Wake the other source."""
        interrupt(self._source)

    @property
    def poses_by(self) -> str:
        """Estimator of the other source's poses."""
        return poses_by(self._source)

    def continue_from(self, stamp_ns: int, world_from_camera: NDArray[np.float64]) -> None:
        """Give the other source the pose of its last frame."""
        continue_from(self._source, stamp_ns, world_from_camera)

    @property
    def num_seeks(self) -> int:
        """Number of seeks in the other source."""
        return num_seeks(self._source)

    def close(self) -> None:
        """Close the other source."""
        self._source.close()


class Segmenter(Protocol):
    """Finds the instances in a frame."""

    def prepare(self, frame: Frame) -> object:
        """Return what needs no map; called ahead, on another thread than `segment`."""

    def segment(self, frame: Frame, prior: MapPrior | None = None, prepared: object = None) -> Segmentation:
        """Return the instances and the structure of a frame; `prepared` is the result of `prepare`, or None."""


@runtime_checkable
class Moving(Protocol):
    """An optional ability of a segmenter: its preparation of a frame survives a change of the pose."""

    def moved(self, prepared: object, world_from_camera: NDArray[np.float64]) -> object:
        """Return a frame's preparation for another pose (4, 4); None if it must be repeated."""


def prepared_at(segmenter: Segmenter, prepared: object, world_from_camera: NDArray[np.float64]) -> object:
    """Return a frame's preparation for another pose (4, 4); None: `segment` prepares."""
    return segmenter.moved(prepared, world_from_camera) if isinstance(segmenter, Moving) else None


@runtime_checkable
class Sharing(Protocol):
    """An optional ability of segmenters, extractors and models: frames of several threads share runs of a network."""

    def share_runs(self) -> int:
        """Let frames share runs from now on, without a change of results; return how many share one, 1 for none."""


def shared_by(part: object) -> int:
    """Return how many frames share a run of a part's network from now on."""
    return part.share_runs() if isinstance(part, Sharing) else 1


class FeatureExtractor(Protocol):
    """Dense patch features, with DINOv2's interface."""

    @property
    def name(self) -> str:
        """Identity of the features: cosines between two extractors mean nothing."""

    @property
    def patch_px(self) -> int:
        """The side of a patch."""

    @property
    def dim(self) -> int:
        """The length D of a feature."""

    def extract(self, rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Return (h, w, D) float32 features of unit norm, one per patch; h = ceil(H / patch), w = ceil(W / patch)."""


class SemanticModel(Protocol):
    """Names the classes of pixels, for structure and self-moving things."""

    @property
    def labels(self) -> tuple[str, ...]:
        """The names of its classes, by their ids."""

    def classify(self, rgb: NDArray[np.uint8]) -> SemanticImage:
        """Return the class of every pixel of an image (H, W, 3)."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Crop:
    """The pixels of a kept view: a cut-out of a frame with its own camera and pose (4, 4).

    `rgb` (h, w, 3) uint8, `depth_m` (h, w) float32 with NaN, `mask` (h, w) bool; `sensor` models the depth.
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
    """All input of a reconstructor: `crops` (the best view first), layer 1, the box, and the height of the support."""

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
    """Layer 2: a mesh in the object frame, and its place `world_from_object` (4, 4)."""

    mesh: Mesh
    world_from_object: NDArray[np.float64]
    #: Maker of the chosen shape, "" without a choice; `verdict` gives the reason.
    made_by: str = ""
    verdict: str = ""
    #: A step was given up at a limit of time or memory, so that a repetition may differ.
    hit_limit: bool = False

    def __post_init__(self) -> None:
        freeze(self, "world_from_object", "f8", (4, 4))


@dataclass(frozen=True, kw_only=True, slots=True)
class NoShape:
    """No shape for this input: an expected outcome; `hit_limit` as in `Reconstruction`."""

    reason: str
    hit_limit: bool = False


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class GeneratedMesh:
    """A generator's mesh, in its own frame and scale."""

    mesh: Mesh
    #: (4, 4), a similarity: its place in the best view's camera, None if unknown.
    camera_from_mesh: NDArray[np.float64] | None = None
    #: Number of views that it was shown, the best ones first.
    num_views: int = 1

    def __post_init__(self) -> None:
        if self.camera_from_mesh is not None:
            freeze(self, "camera_from_mesh", "f8", (4, 4))


class MeshGenerator(Protocol):
    """Makes a whole mesh of an object from images, in any place and size."""

    @property
    def name(self) -> str:
        """The map names it as the maker of a shape."""

    def generate(self, inputs: ShapeInputs) -> GeneratedMesh | NoShape:
        """Return the mesh, or why there is none."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MeshPlacement:
    """Place of a mesh of unknown pose and size: `world_from_mesh` (4, 4), affine.

    It enlarges by `scale`, and by `stretch` (3,), of product 1, along `stretch_axes` (3, 3), columns in the mesh's
    frame. `cost` measures contradiction, 0 for none. `sigma_...` are standard deviations (`sigma_scale`: a share).
    `is_symmetric`: another rotation gives the same surface. `margin` in 0..1: how much worse the best pose with another
    surface fits.
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
    """The place of a mesh is unknown: an expected outcome."""

    reason: str


class PoseRefiner(Protocol):
    """Places a mesh of unknown pose and size in the world."""

    @property
    def name(self) -> str:
        """Its name in the configuration."""

    def place(
        self, mesh: Mesh, inputs: ShapeInputs, guess: NDArray[np.float64] | None = None
    ) -> MeshPlacement | NotPlaced:
        """Return the mesh's place by the views of the object; `guess` is a first world_from_mesh."""


class Reconstructor(Protocol):
    """Makes layer 2."""

    @property
    def name(self) -> str:
        """Its name in the configuration."""

    def reconstruct(self, inputs: ShapeInputs) -> Reconstruction | NoShape:
        """Return a complete, closed, coloured mesh, or why there is none. Deterministic."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class BuiltShape:
    """Layers 2 to 4 of one job, superquadrics in the world; `seen_share` (N,) and `fit_kind` as in `ObjectShape`."""

    reconstruction: Reconstruction
    fitted: Superquadrics
    inflated: Superquadrics
    seen_share: NDArray[np.float64]
    containment: Containment
    #: For people, not for the map.
    timings_s: Mapping[str, float]
    fit_kind: FitKind = "solid"

    def __post_init__(self) -> None:
        freeze(self, "seen_share", "f8", (len(self.fitted),))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Registered:
    """A registered scan: `start_from_sensor` (4, 4), the sensor's pose in its frame at the first scan."""

    stamp_ns: int
    start_from_sensor: NDArray[np.float64]
    #: (6, 6) of the pose's error in the sensor's frame, rotation (rad), then translation (m), or None.
    information: NDArray[np.float64] | None
    #: (K, 6) unit directions, same order, without information: there the pose is predicted.
    degenerate: NDArray[np.float64]

    def __post_init__(self) -> None:
        freeze(self, "start_from_sensor", "f8", (4, 4))
        freeze(self, "degenerate", "f8", (None, 6))
        if self.information is not None:
            freeze(self, "information", "f8", (6, 6))


@dataclass(frozen=True, kw_only=True, slots=True)
class NotRegistered:
    """The pose of a scan is unknown: an expected outcome."""

    reason: str


class Odometry(Protocol):
    """Estimates the motion of a sensor from its scans, deterministically."""

    @property
    def name(self) -> str:
        """Its name for `--odometry`."""

    def register(self, scan: Scan, last_from_scan: NDArray[np.float64] | None = None) -> Registered | NotRegistered:
        """Return the pose of a scan; `last_from_scan` (4, 4) is the motion since the last scan, if known.

        The first scan is at the identity. A scan that cannot be registered changes nothing.
        """


class Sink(Protocol):
    """Shows or stores reports, on one thread of its own, in the order of frames."""

    def show(self, report: FrameReport) -> None:
        """Show or store one report."""

    def close(self) -> None:
        """Finish; no `show` follows."""
