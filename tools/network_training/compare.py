"""Comparison of ways to join fragments into masks, on the same frames: by trees with the network's odds and without.

Frames are those of labelled clouds, of the worlds that may be tuned on, each keyframe with the map as the trees leave
it, and synthetic rooms that nothing was trained on. Masks are scored as `tools/bench perception` does; `joins` is what
the truth would make of the same fragments, `network-joins` of those that the network divided further.
"""

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.caches import cache_root
from hickory_stream.evaluation.truth import load_truth
from hickory_stream.perception.affinity.odds_split import SplitConfig
from hickory_stream.perception.affinity.pixel_network import PixelNetwork
from hickory_stream.perception.geometric_segmenter import GeometricConfig, GeometricSegmenter
from hickory_stream.perception.network_segmenter import NetworkJoinConfig, NetworkSegmenter
from hickory_stream.records import Frame, MapPrior
from hickory_stream.worlds.depth_camera import DepthCameraConfig, sensed_depth
from tools.benchmarks.foreign.logs import foreign_log, worlds_folder
from tools.evaluation.masks.first_layer import play_first_layer
from tools.evaluation.masks.labelled_clouds import clouds_in, load_cloud
from tools.evaluation.masks.scores import UNKNOWN, MaskScore, score_masks, total
from tools.evaluation.oracle_ablation import TrueImages, truly_joined
from tools.network_training.frames import HEIGHT_PX, WIDTH_PX, Scene, frames_of_scene
from tools.network_training.scenes import HELD_OUT

MIN_SHARE = 0.002
_DIVIDING = 0.5
"""The shift of odds with which `network-joins` divides; the product divides nothing."""
_USUAL = DepthCameraConfig(disparity_sigma_px=0.03, correlation_px=1.6, disparity_step_px=1 / 32)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Shown:
    """A frame to be segmented, with the space as the map knew it, and what its pixels show: 0 for structure."""

    name: str
    frame: Frame
    prior: MapPrior | None
    truth: NDArray[np.int32]


SETS = ("clouds", "home", "bookstore", *(scene.name for scene in HELD_OUT))


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tools.network_training.compare", description=__doc__)
    parser.add_argument("--sets", nargs="+", choices=SETS, default=SETS)
    parser.add_argument("--ways", nargs="+", choices=("trees", "learned", "joins", "network-joins"))
    parser.add_argument("--every", type=int, default=3, help="keyframes of the worlds, one of so many")
    parser.add_argument("--most", type=int, default=40, help="frames of a set")
    parser.add_argument("--worlds", type=Path, help="folder of the worlds")
    parser.add_argument("--clouds", type=Path, help="folder of labelled clouds; by default beside that of the worlds")
    parser.add_argument("--frames", type=Path, help="folder of rendered frames, as of tools/train_network")
    parser.add_argument("--network", type=Path, help="a graph other than that of the package")
    options = parser.parse_args(arguments)
    ways = ways_of(PixelNetwork(options.network))
    ways = {name: ways[name] for name in options.ways or ways}
    for name in options.sets:
        scores: dict[str, list[MaskScore]] = {way: [] for way in ways}
        spent_s = dict.fromkeys(ways, 0.0)
        for shown in _frames_of_set(name, options):
            for way, segment in ways.items():
                started_s = time.process_time()
                masks = segment(shown)
                spent_s[way] += time.process_time() - started_s
                scores[way].append(scored(masks, shown))
        for way, of_frames in scores.items():
            each_ms = 1e3 * spent_s[way] / max(len(of_frames), 1)
            print(f"{told(f'{name}, {way}', of_frames)}, {each_ms:.0f} ms a frame", flush=True)
    return 0


def ways_of(network: PixelNetwork) -> dict[str, Callable[[Shown], NDArray[np.int32]]]:
    config = GeometricConfig()
    trees = GeometricSegmenter(config)

    learned = NetworkSegmenter(network, NetworkJoinConfig(), config)

    def by_truth(shown: Shown) -> NDArray[np.int32]:
        pieces = trees.fragments(shown.frame, shown.prior)
        return trees.segmentation(shown.frame, pieces, truly_joined(pieces, shown.truth)).instances

    divided = NetworkSegmenter(network, NetworkJoinConfig(split=SplitConfig(odds_shift=_DIVIDING)), config)

    def divided_by_truth(shown: Shown) -> NDArray[np.int32]:
        pieces = divided.fragments(shown.frame, shown.prior)
        return trees.segmentation(shown.frame, pieces, truly_joined(pieces, shown.truth)).instances

    return {
        "trees": lambda shown: trees.segment(shown.frame, shown.prior).instances,
        "learned": lambda shown: learned.segment(shown.frame, shown.prior).instances,
        "joins": by_truth,
        "network-joins": divided_by_truth,
    }


def _frames_of_set(name: str, options: argparse.Namespace) -> Iterator[Shown]:
    if name == "clouds":
        return of_clouds(options.clouds or worlds_folder(options.worlds).parent / "data" / "mosd")
    scene = next((scene for scene in HELD_OUT if scene.name == name), None)
    if scene is None:
        return of_world(options.worlds, name, options.every, options.most)
    return of_scene(scene, options.frames or cache_root() / "network-frames")


def of_clouds(folder: Path) -> Iterator[Shown]:
    for path in clouds_in(folder):
        cloud = load_cloud(path)
        truth = np.where(cloud.truth == 0, UNKNOWN, np.where(cloud.truth == 1, 0, cloud.truth)).astype(np.int32)
        yield Shown(name=path.stem, frame=cloud.frame, prior=None, truth=truth)


def of_world(worlds: Path | None, world: str, every: int, most: int) -> Iterator[Shown]:
    """Yield every so many keyframes of a foreign world, walk A held by hand, up to `most`."""
    log = foreign_log(worlds_folder(worlds), world, "A", "hand")
    images = TrueImages(load_truth(log.truth))
    count = 0
    for i, seen in enumerate(play_first_layer(log.log)):
        if i % every == 0:
            truth = images.at(seen.frame.stamp_ns)
            yield Shown(name=f"{world}-{seen.frame.index}", frame=seen.frame, prior=seen.prior, truth=truth)
            count += 1
            if count == most:
                return


def of_scene(scene: Scene, folder: Path) -> Iterator[Shown]:
    """Yield the frames of a synthetic scene as a usual depth camera sees them, or as the scene's own does."""
    rng = np.random.default_rng([scene.seed, 9])
    for i, true in enumerate(frames_of_scene(scene, folder)):
        sensed = true.sensed_m
        if sensed is None:
            sensed = sensed_depth(true.depth_m, true.cosine, true.camera.fx, _USUAL, rng)
        frame = Frame(
            index=i, stamp_ns=0, rgb=true.rgb, depth_m=sensed, camera=true.camera,
            world_from_camera=true.world_from_camera,
        )  # fmt: skip
        assert sensed.shape == (HEIGHT_PX, WIDTH_PX)
        yield Shown(name=f"{scene.name}-{i}", frame=frame, prior=None, truth=true.instances)


def scored(masks: NDArray[np.int32], shown: Shown) -> MaskScore:
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


if __name__ == "__main__":
    sys.exit(main())
