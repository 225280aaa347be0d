"""In-memory fakes of every port, for tests: no file, no network, no weights.

`box_scene` has a source.
"""

import time
from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.rigid import apply
from hickory_stream.ports import NoShape, Reconstruction, ShapeInputs, Sink, Source, SourceAround
from hickory_stream.records import Frame, FrameReport, MapPrior, RawFrame, Segmentation


class BreakingSource(SourceAround):
    """A `Source` that plays another one, and raises `error` in place of the frame `at`."""

    def __init__(self, source: Source, at: int, error: Exception) -> None:
        super().__init__(source)
        self._at = at
        self._error = error

    def frames(self) -> Iterator[RawFrame]:
        """Yield the frames before the failure."""
        for frame in self._source.frames():
            if frame.index == self._at:
                raise self._error
            yield frame


class InstanceSegmenter:
    """A `Segmenter` that reads instance images (H, W) by stamp: 0 = floor or nothing, 1..n = objects."""

    def __init__(self, instances: Mapping[int, NDArray[np.int32]]) -> None:
        self._instances = instances

    def prepare(self, frame: Frame) -> object:
        """Return nothing: there is nothing to compute ahead."""
        del frame
        return None

    def segment(self, frame: Frame, prior: MapPrior | None = None, prepared: object = None) -> Segmentation:
        """Return the instances by the frame's stamp; other pixels with depth are structure."""
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


class BoxReconstructor:
    """A `Reconstructor` that returns the object's box as a mesh at once; corners near layer 1 count as seen."""

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


class RememberingSink:
    """A `Sink` that keeps every report."""

    def __init__(self) -> None:
        self.reports: list[FrameReport] = []
        self.is_closed = False

    def show(self, report: FrameReport) -> None:
        """Keep one report."""
        self.reports.append(report)

    def close(self) -> None:
        """Record the call."""
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
    """A `Sink` that waits `seconds` before it passes a report on."""

    def __init__(self, sink: Sink, seconds: float) -> None:
        self._sink = sink
        self._seconds = seconds

    def show(self, report: FrameReport) -> None:
        """Wait, and pass one report on."""
        time.sleep(self._seconds)
        self._sink.show(report)

    def close(self) -> None:
        """Close the other sink."""
        self._sink.close()
