"""Ways to come from fragments to masks, compared on the same frames: learned trees, the network, and both.

Frames are those of labelled clouds, of the worlds that may be tuned on, each keyframe with the map as the trees leave
it, and own rooms that nothing was trained on. Masks are scored as `tools/bench perception` does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from hickory_stream.evaluation.ladder import TrueImages
from hickory_stream.evaluation.truth import load_truth
from hickory_stream.evaluation.worlds.depth_camera import DepthCameraConfig, sensed_depth
from hickory_stream.records import Frame
from tools.benchmarks.first_layer import play_first_layer
from tools.benchmarks.foreign_logs import foreign_log, worlds_folder
from tools.benchmarks.labelled_clouds import clouds_in, load_cloud
from tools.benchmarks.mask_scores import UNKNOWN, MaskScore, score_masks, total
from tools.network_training.frames import HEIGHT_PX, WIDTH_PX, Scene, frames_of_scene

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from hickory_stream.records import ObservedSpace

MIN_SHARE = 0.002
_CLEAN = DepthCameraConfig(disparity_sigma_px=0.03, correlation_px=1.6, disparity_step_px=1 / 32)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Shown:
    """A frame to be segmented, with the space as the map knew it, and what its pixels show: 0 for structure."""

    name: str
    frame: Frame
    prior: ObservedSpace | None
    truth: NDArray[np.int32]


Way = "Callable[[Shown], NDArray[np.int32]]"


def of_clouds(folder: Path) -> Iterator[Shown]:
    """Yield the labelled clouds of a folder."""
    for path in clouds_in(folder):
        cloud = load_cloud(path)
        truth = np.where(cloud.truth == 0, UNKNOWN, np.where(cloud.truth == 1, 0, cloud.truth)).astype(np.int32)
        yield Shown(name=path.stem, frame=cloud.frame, prior=None, truth=truth)


def of_world(worlds: Path | None, world: str, every: int, most: int) -> Iterator[Shown]:
    """Yield every so many keyframes of a foreign world, walk A held by hand, up to `most`."""
    log = foreign_log(worlds_folder(worlds), world, "A", "hand")
    images = TrueImages(load_truth(log.truth))
    prior: ObservedSpace | None = None
    count = 0
    for i, seen in enumerate(play_first_layer(log.log)):
        if i % every == 0:
            truth = images.at(seen.frame.stamp_ns)
            yield Shown(name=f"{world}-{seen.frame.index}", frame=seen.frame, prior=prior, truth=truth)
            count += 1
            if count == most:
                return
        prior = seen.snapshot.submaps[0].observed_space


def of_scenes(scenes: Sequence[Scene], folder: Path) -> Iterator[Shown]:
    """Yield the frames of synthetic scenes as a usual depth camera sees them."""
    for scene in scenes:
        rng = np.random.default_rng([scene.seed, 9])
        for i, true in enumerate(frames_of_scene(scene, folder)):
            depth = sensed_depth(true.depth_m, true.cosine, true.camera.fx, _CLEAN, rng)
            frame = Frame(
                index=i,
                stamp_ns=0,
                rgb=true.rgb,
                depth_m=depth,
                camera=true.camera,
                world_from_camera=true.world_from_camera,
            )
            assert depth.shape == (HEIGHT_PX, WIDTH_PX)
            yield Shown(name=f"{scene.name}-{i}", frame=frame, prior=None, truth=true.instances)


def scored(masks: NDArray[np.int32], shown: Shown) -> MaskScore:
    """Return the score of the masks of a frame."""
    return score_masks(masks, shown.truth, int(MIN_SHARE * shown.truth.size))


def told(name: str, scores: Sequence[MaskScore]) -> str:
    """Return a line of figures over frames."""
    score = total(scores)
    precision = score.num_right / max(score.num_masks, 1)
    recall = score.num_right / max(score.num_things, 1)
    return (
        f"{name:34s} F1 {score.f1:.3f}  precision {precision:.3f}  recall {recall:.3f}  best IoU {score.best_iou:.3f}  "
        f"found {score.found_fraction:.3f}  ({score.num_right} of {score.num_things} things, {score.num_masks} masks)"
    )


def picture(shown: Shown, masks: Mapping[str, NDArray[np.int32]], width_px: int = 480) -> NDArray[np.uint8]:
    """Return a row of pictures (h, w, 3): the frame, the truth, and the masks of each way."""
    truth = np.where(shown.truth > 0, shown.truth, 0)
    images = [np.asarray(shown.frame.rgb), *(painted(shown.frame.rgb, m) for m in (truth, *masks.values()))]
    height_px = round(width_px * images[0].shape[0] / images[0].shape[1])
    row = []
    for name, image in zip(("frame", "truth", *masks), images, strict=True):
        small = np.ascontiguousarray(cv2.resize(image, (width_px, height_px), interpolation=cv2.INTER_NEAREST))
        cv2.putText(small, name, (6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1)
        row.append(small)
    return np.hstack(row)


def painted(rgb: NDArray[np.uint8], masks: NDArray[np.int32]) -> NDArray[np.uint8]:
    """Return an image with its masks in colours of their own."""
    colors = np.random.default_rng(3).integers(60, 256, (int(masks.max(initial=0)) + 1, 3))
    colors[0] = 0
    grey = np.asarray(rgb).mean(axis=2, keepdims=True)
    mixed = np.where((masks > 0)[..., None], 0.35 * grey + 0.65 * colors[masks], 0.5 * grey)
    return np.asarray(mixed.astype(np.uint8))
