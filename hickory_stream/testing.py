"""The in-memory twin of every port, for tests of your own parts and of ours: no file, no network, no weights.

The scene is three boxes on a floor that a camera walks around, cast analytically: colour, depth, instances and poses
are exact, so that what a part makes of them can be compared with the truth.
"""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.errors import InputError, RecordingError
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.rigid import apply
from hickory_stream.ports import NoShape, Reconstruction, SourceAround
from hickory_stream.records import Frame, RawFrame, Segmentation, SourceInfo

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from hickory_stream.ports import ShapeInputs, Sink, Source
    from hickory_stream.records import FrameReport, MapPrior

SCENE_CAMERA = Camera(width=240, height=180, fx=210.0, fy=210.0, cx=119.5, cy=89.5)
START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 300_000_000

_EYE_HEIGHT_M, _EYE_DISTANCE_M, _STEP_RAD = 1.1, 2.0, 0.12


# ---- a scene and its source -----------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, slots=True)
class SceneBox:
    """A box on the floor: its lowest and highest corner in the world (metres), and its colour."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    rgb: tuple[int, int, int]


SCENE_BOXES = (
    SceneBox(low=(-0.45, -0.35, 0.0), high=(-0.10, -0.05, 0.40), rgb=(190, 80, 60)),
    SceneBox(low=(0.15, -0.30, 0.0), high=(0.50, 0.05, 0.25), rgb=(70, 130, 190)),
    SceneBox(low=(-0.15, 0.25, 0.0), high=(0.20, 0.50, 0.55), rgb=(120, 170, 80)),
)


def scene_pose(index: int) -> NDArray[np.float64]:
    """Return world_from_camera (4, 4) of a frame: on a circle around the boxes, looking at their middle."""
    angle = index * _STEP_RAD
    eye = np.array([_EYE_DISTANCE_M * np.cos(angle), _EYE_DISTANCE_M * np.sin(angle), _EYE_HEIGHT_M])
    forward = np.array([0.0, 0.0, 0.2]) - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    pose[:3, 3] = eye
    return pose


def cast_scene(
    boxes: Sequence[SceneBox], camera: Camera, world_from_camera: NDArray[np.float64]
) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.int32]]:
    """Return colour (H, W, 3), depth (H, W) along the axis, NaN for none, and instances: 0 floor, i + 1 box i."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
    rays, eye = rays @ world_from_camera[:3, :3].T, world_from_camera[:3, 3]
    with np.errstate(divide="ignore"):
        floor = np.where(rays[..., 2] < 0, -eye[2] / rays[..., 2], np.inf)
        depths = np.stack([floor, *(_entry(box, eye, rays) for box in boxes)])
    instances = depths.argmin(axis=0).astype(np.int32)
    depth = depths.min(axis=0)
    points = eye + rays * np.where(np.isfinite(depth), depth, 0.0)[..., None]
    # Stripes: a surface without texture would have no gradients to describe.
    shade = 0.8 + 0.2 * np.sign(np.sin(40.0 * points.sum(axis=-1)))
    palette = np.array([(150, 145, 140), *(box.rgb for box in boxes)])
    return (
        (palette[instances] * shade[..., None]).astype(np.uint8),
        np.where(np.isfinite(depth), depth, np.nan).astype(np.float32),
        instances,
    )


def _entry(box: SceneBox, eye: NDArray[np.float64], rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (H, W) where each ray enters a box, infinity where it misses (slab method)."""
    a, b = (np.array(box.low) - eye) / rays, (np.array(box.high) - eye) / rays
    near, far = np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)
    return np.where((near < far) & (near > 0), near, np.inf)


class SceneSource:
    """A `Source` of the scene: `num_frames` frames, 0.3 s and 7 degrees apart, each of them a keyframe by default."""

    def __init__(self, num_frames: int = 8, boxes: Sequence[SceneBox] = SCENE_BOXES) -> None:
        self._num_frames = num_frames
        self._boxes = tuple(boxes)
        self._num_yielded = 0
        self.is_closed = False

    @property
    def info(self) -> SourceInfo:
        """What there is to play."""
        return SourceInfo(
            uri="memory:scene",
            kind="synthetic scene",
            identity=f"scene-{self._num_frames}-{len(self._boxes)}",
            camera=SCENE_CAMERA,
            num_frames=self._num_frames,
            start_ns=START_NS,
            end_ns=START_NS + (self._num_frames - 1) * PERIOD_NS,
            streams=(("color", "cast"), ("depth", "cast"), ("pose", "circle")),
        )

    @cached_property
    def instances(self) -> Mapping[int, NDArray[np.int32]]:
        """The true instances (H, W) of every frame, by its stamp: what `InstanceSegmenter` reads."""
        poses = {START_NS + i * PERIOD_NS: scene_pose(i) for i in range(self._num_frames)}
        return {stamp_ns: cast_scene(self._boxes, SCENE_CAMERA, pose)[2] for stamp_ns, pose in poses.items()}

    def frames(self) -> Iterator[RawFrame]:
        """Yield the frames from the beginning."""
        self._num_yielded = 0
        for i in range(self._num_frames):
            self._num_yielded += 1
            yield RawFrame(
                index=i,
                stamp_ns=START_NS + i * PERIOD_NS,
                camera=SCENE_CAMERA,
                world_from_camera=scene_pose(i),
                decode=partial(self._decode, i),
            )

    def _decode(self, index: int) -> Frame:
        rgb, depth_m, _ = cast_scene(self._boxes, SCENE_CAMERA, scene_pose(index))
        return Frame(
            index=index,
            stamp_ns=START_NS + index * PERIOD_NS,
            rgb=rgb,
            depth_m=depth_m,
            camera=SCENE_CAMERA,
            world_from_camera=scene_pose(index),
        )

    def ledger(self) -> Mapping[str, int]:
        """Return how many frames the latest pass has yielded."""
        return {"frames": self._num_yielded}

    def close(self) -> None:
        """Note that it was closed."""
        self.is_closed = True


class BreakingSource:
    """A `Source` that plays another one, and raises `error` in place of the frame `at`."""

    def __init__(self, source: Source, at: int, error: Exception) -> None:
        self._source = source
        self._at = at
        self._error = error

    @property
    def info(self) -> SourceInfo:
        """That of the other one."""
        return self._source.info

    def frames(self) -> Iterator[RawFrame]:
        """Yield the frames before the failure."""
        for frame in self._source.frames():
            if frame.index == self._at:
                raise self._error
            yield frame

    def ledger(self) -> Mapping[str, int]:
        """Return that of the other one."""
        return self._source.ledger()

    def close(self) -> None:
        """Close the other one."""
        self._source.close()


class BlindSource:
    """A `Source` that plays another one without a single return of depth."""

    def __init__(self, source: Source) -> None:
        self._source = source

    @property
    def info(self) -> SourceInfo:
        """That of the other one."""
        return self._source.info

    def frames(self) -> Iterator[RawFrame]:
        """Yield the frames with NaN for depth."""
        for frame in self._source.frames():
            yield replace(frame, decode=partial(_without_depth, frame))

    def ledger(self) -> Mapping[str, int]:
        """Return that of the other one."""
        return self._source.ledger()

    def close(self) -> None:
        """Close the other one."""
        self._source.close()


def _without_depth(raw: RawFrame) -> Frame:
    frame = raw.decode()
    return replace(frame, depth_m=np.full_like(frame.depth_m, np.nan))


@dataclass(frozen=True, kw_only=True, slots=True)
class Faults:
    """What goes wrong with a source, each as the share of its frames; `stall_s` is how long a stalled frame takes.

    `drop`, `duplicate`, `delay` (a frame comes three frames later, with its own stamp), `reorder` (two neighbours
    change places), `corrupt` (decoding raises), `stall`, `freeze` (a frame has the stamp of the one before), `teleport`
    (the pose is metres off for one frame), `blind` (no return of depth), `shrink` (half the size, once for all).
    """

    drop: float = 0.0
    duplicate: float = 0.0
    delay: float = 0.0
    reorder: float = 0.0
    corrupt: float = 0.0
    stall: float = 0.0
    freeze: float = 0.0
    teleport: float = 0.0
    blind: float = 0.0
    shrink: float = 0.0
    stall_s: float = 0.5

    def __post_init__(self) -> None:
        for name in FAULTS:
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InputError(f"found {name}={getattr(self, name):g}, expected a share of the frames, 0 to 1")
        if not 0.0 <= self.stall_s < 3600.0:
            raise InputError(f"found stall_s={self.stall_s:g}, expected seconds")


FAULTS = ("drop", "duplicate", "delay", "reorder", "corrupt", "stall", "freeze", "teleport", "blind", "shrink")


def parse_faults(text: str) -> Faults:
    """Return the faults that a text such as `drop=0.1,teleport=0.02` names.

    Raises:
        InputError: a name or a number in it is wrong.
    """
    values: dict[str, float] = {}
    for part in text.split(","):
        name, _, number = part.partition("=")
        try:
            values[name.strip()] = float(number)
        except ValueError as error:
            raise InputError(f"found {part!r} among the faults, expected NAME=SHARE such as drop=0.1") from error
    unknown = values.keys() - {*FAULTS, "stall_s"}
    if unknown:
        raise InputError(f"found the faults {', '.join(sorted(unknown))}, expected some of {', '.join(FAULTS)}")
    return Faults(**values)


class FaultySource(SourceAround):
    """A `Source` that plays another one badly: the same faults at the same frames for the same seed."""

    def __init__(self, source: Source, faults: Faults, seed: int = 0) -> None:
        super().__init__(source)
        self._faults = faults
        self._seed = seed
        self._injected: Counter[str] = Counter()

    def frames(self) -> Iterator[RawFrame]:
        """Yield the frames, some of them with faults; indices count what is yielded."""
        self._injected = Counter()
        for index, frame in enumerate(self._in_disorder()):
            yield replace(frame, index=index, decode=partial(_renumbered, frame.decode, index))

    def _in_disorder(self) -> Iterator[RawFrame]:
        """Yield the frames in the order that delays and swaps give."""
        held: list[tuple[int, RawFrame]] = []
        swapped: RawFrame | None = None
        for number, frame in enumerate(self._with_faults()):
            for due, late in [entry for entry in held if entry[0] <= number]:
                held.remove((due, late))
                yield late
            rng = np.random.default_rng([self._seed, 1, number])
            if self._happens("delay", rng):
                held.append((number + 3, frame))
            elif swapped is None and self._happens("reorder", rng):
                swapped = frame
            else:
                yield frame
                if swapped is not None:
                    yield swapped
                    swapped = None
        yield from ([swapped] if swapped is not None else [])
        yield from (frame for _, frame in held)

    def _with_faults(self) -> Iterator[RawFrame]:
        """Yield the frames with what happens to each of them alone."""
        last_ns: int | None = None
        is_small = False
        for number, frame in enumerate(self._source.frames()):
            rng = np.random.default_rng([self._seed, 0, number])
            happens = {name: self._happens(name, rng) for name in FAULTS if name not in ("delay", "reorder")}
            if happens["stall"]:
                time.sleep(self._faults.stall_s)
            if happens["drop"]:
                continue
            is_small = is_small or happens["shrink"]
            changed = frame
            if happens["freeze"] and last_ns is not None:
                changed = replace(changed, stamp_ns=last_ns)
            last_ns = frame.stamp_ns
            if happens["teleport"]:
                pose = changed.world_from_camera.copy()
                pose[:3, 3] += rng.uniform(-5.0, 5.0, 3)
                changed = replace(changed, world_from_camera=pose)
            if changed is not frame:
                changed = replace(changed, decode=partial(_restamped, changed))
            if happens["blind"]:
                changed = replace(changed, decode=partial(_without_depth, changed))
            if is_small:
                camera = changed.camera.scaled(0.5)
                changed = replace(changed, camera=camera, color_bytes=None, decode=partial(_halved, changed))
            if happens["corrupt"]:
                changed = replace(changed, decode=partial(_torn, number))
            yield changed
            if happens["duplicate"]:
                yield changed

    def _happens(self, name: str, rng: np.random.Generator) -> bool:
        happens = bool(rng.random() < getattr(self._faults, name))
        self._injected[name] += happens
        return happens

    def ledger(self) -> Mapping[str, int]:
        """Return that of the other one, and how often each fault was made, as `injected_NAME`."""
        made = {f"injected_{name}": number for name, number in sorted(self._injected.items()) if number}
        return {**self._source.ledger(), **made}


def _renumbered(decode: Callable[[], Frame], index: int) -> Frame:
    return replace(decode(), index=index)


def _restamped(raw: RawFrame) -> Frame:
    """Return what the frame shows, under the stamp and the pose that it pretends to have."""
    return replace(raw.decode(), stamp_ns=raw.stamp_ns, world_from_camera=raw.world_from_camera)


def _halved(raw: RawFrame) -> Frame:
    frame = raw.decode()
    camera = frame.camera.scaled(0.5)
    size = (slice(0, 2 * camera.height, 2), slice(0, 2 * camera.width, 2))
    return replace(frame, rgb=frame.rgb[size].copy(), depth_m=frame.depth_m[size].copy(), camera=camera)


def _torn(number: int) -> Frame:
    raise RecordingError(f"frame {number} is torn: a fault that was asked for")


# ---- perception ------------------------------------------------------------------------------------------------------


class InstanceSegmenter:
    """A `Segmenter` that reads instance images (H, W) by stamp: 0 = floor or nothing, 1..n = objects."""

    def __init__(self, instances: Mapping[int, NDArray[np.int32]]) -> None:
        self._instances = instances

    def prepare(self, frame: Frame) -> object:
        """Return nothing: there is nothing to compute ahead."""
        del frame
        return None

    def segment(self, frame: Frame, prior: MapPrior | None = None, prepared: object = None) -> Segmentation:
        """Return the instances of the frame's stamp; whatever is none of them and has depth is structure."""
        del prior, prepared
        instances = self._instances[frame.stamp_ns]
        return Segmentation(instances=instances, structure=(instances == 0) & np.isfinite(frame.depth_m), floor_z_m=0.0)


class MeanColorExtractor:
    """A `FeatureExtractor`: the mean colour of a patch of 16 pixels, and a constant."""

    name = "mean-color"
    patch_px = 16
    dim = 4

    def extract(self, rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Return (h, w, 4) float32 features of unit norm; h = ceil(H / 16)."""
        height, width = rgb.shape[:2]
        padding = ((0, -height % self.patch_px), (0, -width % self.patch_px), (0, 0))
        padded = np.pad(rgb, padding, mode="edge").astype(np.float32) / 255
        h, w = padded.shape[0] // self.patch_px, padded.shape[1] // self.patch_px
        means = padded.reshape(h, self.patch_px, w, self.patch_px, 3).mean(axis=(1, 3))
        features = np.concatenate([means, np.full((h, w, 1), 0.1, np.float32)], axis=-1)
        features /= np.linalg.norm(features, axis=-1, keepdims=True)
        return features.astype(np.float32)


# ---- shapes ----------------------------------------------------------------------------------------------------------


class BoxReconstructor:
    """A `Reconstructor` that answers at once: the box of the object as a mesh, seen at corners that layer 1 is near."""

    name = "box"

    def reconstruct(self, inputs: ShapeInputs) -> Reconstruction | NoShape:
        """Return the twelve triangles of the box, or no shape where layer 1 is empty."""
        import trimesh

        if len(inputs.points_world) == 0:
            return NoShape(reason="layer 1 is empty")
        box = trimesh.creation.box(2 * inputs.box.half_extents_m)
        corners_world = apply(inputs.box.world_from_box, np.asarray(box.vertices))
        gaps_m = np.linalg.norm(corners_world[:, None] - inputs.points_world[None], axis=-1).min(axis=1)
        mesh = Mesh(
            vertices=box.vertices,
            faces=box.faces,
            colors=np.tile(inputs.colors.mean(axis=0).astype(np.uint8), (len(box.vertices), 1)),
            is_seen=gaps_m < 0.1 * inputs.box.diagonal_m,
        )
        return Reconstruction(mesh=mesh, world_from_object=inputs.box.world_from_box)


# ---- sinks -----------------------------------------------------------------------------------------------------------


class RememberingSink:
    """A `Sink` that keeps every report."""

    def __init__(self) -> None:
        self.reports: list[FrameReport] = []
        self.is_closed = False

    def show(self, report: FrameReport) -> None:
        """Keep one report."""
        self.reports.append(report)

    def close(self) -> None:
        """Note that it was closed."""
        self.is_closed = True


class FailingSink:
    """A `Sink` that raises `error` on its n-th report, counted from 1, and on each that follows."""

    def __init__(self, at: int, error: Exception) -> None:
        self._at = at
        self._error = error
        self.num_shown = 0

    def show(self, report: FrameReport) -> None:
        """Count one report, or fail."""
        del report
        self.num_shown += 1
        if self.num_shown >= self._at:
            raise self._error

    def close(self) -> None:
        """Do nothing: a sink that failed is closed all the same."""


class SlowSink:
    """A `Sink` that takes `seconds` for each report before it hands it to another sink."""

    def __init__(self, sink: Sink, seconds: float) -> None:
        self._sink = sink
        self._seconds = seconds

    def show(self, report: FrameReport) -> None:
        """Wait, and hand one report on."""
        time.sleep(self._seconds)
        self._sink.show(report)

    def close(self) -> None:
        """Close the other one."""
        self._sink.close()
