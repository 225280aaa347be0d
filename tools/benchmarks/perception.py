"""How good perception is: masks on labelled clouds and synthetic logs, its time and memory, the descriptor, S.

Clouds are single views that know no map. Logs are played through layer 1: each keyframe sees the map as it is after the
one before. Things and masks under 0.2 % of the image do not count.
"""

from __future__ import annotations

import time
from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from hickory_stream.evaluation.truth import instances_of, load_truth
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.perception.choose import make_segmenter
from hickory_stream.perception.descriptor import ColorTextureDescriptor
from hickory_stream.perception.perceive import PerceptionConfig, features_of, perceive
from tools.benchmarks.figures import Figure, Options
from tools.benchmarks.first_layer import PlayedKeyframe, play_first_layer
from tools.benchmarks.keyframe_memory import WARM_KEYFRAMES, keyframe_memory
from tools.benchmarks.labelled_clouds import clouds_in, load_cloud
from tools.benchmarks.mask_scores import UNKNOWN, MaskScore, score_masks, total
from tools.benchmarks.perception_models import measure_models
from tools.benchmarks.processes import ROOT
from tools.worlds.cache import cached_recording
from tools.worlds.recording_config import RecordingConfig

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from hickory_stream.evaluation.truth import Truth
    from hickory_stream.ports import Segmenter
    from hickory_stream.records import Frame
    from tools.benchmarks.labelled_clouds import LabelledFrame

_CLOUDS = ROOT.parent / "shared" / "data" / "mosd"
_APARTMENTS, _TABLETOPS = 4, 3
_MIN_SHARE = 0.002
_SCORED_EVERY = 3
_OWN_SHARE = 0.6
_TIMED_FRAMES, _REPEATS = 20, 3
_MEMORY_ROUNDS = 3
_MIN_VIEWS = 3


@dataclass(frozen=True, kw_only=True, slots=True)
class Played:
    """What a log showed: the score of its masks, the cosines of its objects, the feature evaluations of the core.

    `same` and `different` are the mean cosines of pooled features of one object across views and of two objects, one
    number per object and per pair. `frames` are some keyframes, for timing.
    """

    name: str
    score: MaskScore
    same: tuple[float, ...]
    different: tuple[float, ...]
    saved: float
    frames: tuple[PlayedKeyframe, ...]


def measure(options: Options) -> list[Figure]:
    """Return the figures; what cannot be measured here is said and absent.

    A quick run plays the embedded recording instead of apartments and table-tops.
    """
    figures = _of_clouds(options)
    logs = _logs(options)
    played = [_played(log, name) for log, name in logs]
    score = total(p.score for p in played)
    same = float(np.mean([c for p in played for c in p.same]))
    different = float(np.mean([c for p in played for c in p.different]))
    print(f"features: mean cosine {same:.3f} of one object across views, {different:.3f} of two")
    figures += [
        _figure("synthetic_f1_50", score.f1, "", "higher"),
        _figure("synthetic_best_iou", score.best_iou, "", "higher"),
        _figure("synthetic_found_fraction", score.found_fraction, "", "higher"),
        _figure("descriptor_margin", same - different, "", "higher"),
        _figure("s_saved_fraction", float(np.mean([p.saved for p in played])), "", "higher"),
    ]
    figures.append(_time_of([keyframe for p in played for keyframe in p.frames]))
    figures += _memory_of(*logs[0], 20 if options.quick else 60)
    return [*figures, *measure_models(options.seed)]


def score_cloud(cloud: LabelledFrame, config: PerceptionConfig | None = None) -> MaskScore:
    """Return the score of the embedded segmenter on a cloud, without any map."""
    masks = make_segmenter(config or PerceptionConfig()).segment(cloud.frame).instances
    truth = np.where(cloud.truth == 0, UNKNOWN, np.where(cloud.truth == 1, 0, cloud.truth))
    return score_masks(masks, truth, _min_pixels(truth))


def _of_clouds(options: Options) -> list[Figure]:
    folder = options.clouds or _CLOUDS
    if options.clouds is None and not folder.is_dir():
        print(f"no labelled clouds: {folder} is not there, and --clouds names no other folder")
        return [_figure("clouds", 0, "", "higher")]
    scores = []
    for path in clouds_in(folder):
        scores.append(score_cloud(load_cloud(path)))
        print(f"{path.stem}: {_line(scores[-1])}", flush=True)
    score = total(scores)
    return [
        _figure("mosd_f1_50", score.f1, "", "higher"),
        _figure("mosd_best_iou", score.best_iou, "", "higher"),
        _figure("clouds", len(scores), "", "higher"),
    ]


def _logs(options: Options) -> list[tuple[Path, str]]:
    """Return the logs with their truth beside them, and what they are called."""
    if options.scenes:
        return [(_log_of(folder), folder.stem) for folder in options.scenes]
    if options.quick:
        return [(ROOT / "recordings" / "demo.mcap", "demo")]
    base = 1000 + 10 * options.seed
    kinds = [("apartment", base + i) for i in range(_APARTMENTS)] + [("tabletop", base + i) for i in range(_TABLETOPS)]
    logs = []
    for scene, seed in kinds:
        print(f"recording {scene} {seed}", flush=True)
        config = RecordingConfig(
            scene=scene, seed=seed, walk_index=0, seconds=None, rate_hz=15.0, width=640, height=480
        )
        logs.append((cached_recording(config)[0], f"{scene} {seed}"))
    return logs


def _log_of(truth: Path) -> Path:
    return truth.resolve().with_suffix(".mcap")


def _played(log: Path, name: str) -> Played:
    truth = load_truth(log.with_suffix(".truth"))
    stamps = np.array([frame.stamp_ns for frame in truth.frames])
    scores: list[MaskScore] = []
    features: dict[int, list[NDArray[np.float32]]] = defaultdict(list)
    frames: list[PlayedKeyframe] = []
    saved = 0.0
    for i, seen in enumerate(play_first_layer(log)):
        saved = seen.metrics["core/features_saved"]
        if i % _SCORED_EVERY:
            continue
        shown = _shown(truth, int(np.argmin(np.abs(stamps - seen.frame.stamp_ns))))
        scores.append(score_masks(seen.perceived.segmentation.instances, shown, _min_pixels(shown)))
        for thing, feature in _features(seen, shown):
            features[thing].append(feature)
        if i % (10 * _SCORED_EVERY) == 0:
            frames.append(seen)
    same, different = _cosines(features)
    result = Played(name=name, score=total(scores), same=same, different=different, saved=saved, frames=tuple(frames))
    print(f"{name}: {_line(result.score)}, {saved:.0%} of the feature evaluations saved", flush=True)
    return result


def _shown(truth: Truth, index: int) -> NDArray[np.int32]:
    """Return what each pixel of a true frame shows: an object, 0 for structure, `UNKNOWN` for a passer-by."""
    shown = instances_of(truth, truth.frames[index]).astype(np.int32)
    things = [item.id for item in truth.objects]
    return np.where(np.isin(shown, things) | (shown == 0), shown, UNKNOWN).astype(np.int32)


def _features(seen: PlayedKeyframe, shown: NDArray[np.int32]) -> list[tuple[int, NDArray[np.float32]]]:
    """Return the true object and the pooled feature of every mask that is mostly of one object."""
    observations = seen.perceived.observations
    owners = []
    for observation in observations:
        x0, y0, x1, y1 = observation.box_px
        ids, counts = np.unique(shown[y0:y1, x0:x1][observation.mask], return_counts=True)
        most = int(np.argmax(counts))
        owners.append(int(ids[most]) if counts[most] > _OWN_SHARE * counts.sum() else 0)
    chosen = [observation.index for observation, owner in zip(observations, owners, strict=True) if owner > 0]
    pooled, _ = features_of(seen.frame, observations, chosen, ColorTextureDescriptor())
    return [(owners[feature.observation_index], feature.pooled) for feature in pooled]


def _cosines(
    features: dict[int, list[NDArray[np.float32]]],
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the mean cosine between two views of each object, and between views of each two objects."""
    views = [np.stack(features[thing]) for thing in sorted(features) if len(features[thing]) >= _MIN_VIEWS]
    same = []
    for own in views:
        count = len(own)
        same.append(float(((own @ own.T).sum() - count) / (count * (count - 1))))
    different = [float((a @ b.T).mean()) for i, a in enumerate(views) for b in views[i + 1 :]]
    return tuple(same), tuple(different)


def _time_of(keyframes: Sequence[PlayedKeyframe]) -> Figure:
    """Return the time of perception on one core, over keyframes with the maps that they left."""
    chosen = keyframes[:: max(1, len(keyframes) // _TIMED_FRAMES)][:_TIMED_FRAMES]
    config = PerceptionConfig()
    segmenter = make_segmenter(config)
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    best = []
    try:
        for seen in chosen:
            times = []
            for _ in range(_REPEATS):
                started = time.process_time()
                _perceive_again(seen, segmenter, config)
                times.append(time.process_time() - started)
            best.append(min(times))
    finally:
        cv2.setNumThreads(threads)
    frame = chosen[0].frame.camera
    print(f"timed on {len(chosen)} keyframes of {frame.width}x{frame.height}, least of {_REPEATS} repeats each")
    return _figure("keyframe_ms", 1e3 * float(np.mean(best)), "ms", "lower")


def _perceive_again(seen: PlayedKeyframe, segmenter: Segmenter, config: PerceptionConfig) -> None:
    frame: Frame = seen.frame
    perceive(frame, seen.prior, None, segmenter, config, lattice=Lattice())


def _memory_of(log: Path, name: str, keyframes: int) -> list[Figure]:
    """Return the memory of layer 1: all of it, what keyframes and their map add, and what is not given back."""
    memory = keyframe_memory(log, keyframes=keyframes, rounds=_MEMORY_ROUNDS)
    print(f"memory on {memory.keyframes} keyframes of {name}, {_MEMORY_ROUNDS} rounds; {WARM_KEYFRAMES} to warm up")
    return [
        _figure("layer1_memory_mb", memory.layer1_mb, "MB", "lower"),
        _figure("keyframe_memory_mb", memory.keyframes_mb, "MB", "lower"),
        _figure("repeated_memory_mb", memory.rounds_mb, "MB", "lower"),
    ]


def _min_pixels(truth: NDArray[np.int32]) -> int:
    return int(_MIN_SHARE * truth.size)


def _line(score: MaskScore) -> str:
    return (
        f"F1 {score.f1:.3f}, best IoU {score.best_iou:.3f}, {score.num_right} of {score.num_things} things right, "
        f"{score.num_masks} masks"
    )


def _figure(name: str, value: float, unit: str, better: str) -> Figure:
    return Figure(name=name, value=float(value), unit=unit, better="lower" if better == "lower" else "higher")
