"""Perception of single frames: masks of synthetic logs, its memory, the descriptor, S."""
# Logs are played through layer 1: each keyframe sees the map as it is after the one before. Things and masks under
# 0.2 % of the image do not count. Masks of labelled clouds, and times, are parts of `tools/bench foreign`.

from collections import defaultdict, deque
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.config import MapperConfig
from hickory_stream.evaluation.truth import load_truth
from hickory_stream.events import ComputeFeatures
from hickory_stream.perception.choose import make_segmenter
from hickory_stream.perception.descriptor import ColorTextureDescriptor
from hickory_stream.perception.perceive import features_of
from tools.benchmarks.common.cached_runs import walk_recording
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.common.processes import DEMO, in_child, resident_mb
from tools.evaluation.masks.first_layer import PlayedKeyframe, keyframes_of, play_first_layer
from tools.evaluation.masks.scores import MaskScore, min_pixels, score_masks, total
from tools.evaluation.oracle_ablation import TrueImages
from tools.worlds.cache import cached_recording

_APARTMENTS, _TABLETOPS = 4, 3
_SCORED_EVERY = 3
_OWN_SHARE = 0.6
_MEMORY_ROUNDS = 3
_MIN_VIEWS = 3


@dataclass(frozen=True, kw_only=True, slots=True)
class Played:
    """A log played: the score of its masks, the cosines of its objects, the feature evaluations saved by the core."""

    # `same` and `different` are the mean cosines of pooled features of one object across views and of two objects, one
    # number per object and per pair.

    score: MaskScore
    same: list[float]
    different: list[float]
    saved: float


def measure(options: Options) -> list[Figure]:
    """Return the figures; a quick run plays the embedded recording instead of apartments and table-tops."""
    logs = _logs(options)
    played = [_played(log) for log in logs]
    score = total(p.score for p in played)
    same, different = (np.mean([c for p in played for c in getattr(p, kind)]) for kind in ("same", "different"))
    print(f"features: mean cosine {same:.3f} of one object across views, {different:.3f} of two")
    return [
        figure("synthetic_f1_50", score.f1), figure("synthetic_best_iou", score.best_iou),
        figure("synthetic_found_fraction", score.found_fraction), figure("descriptor_margin", same - different),
        figure("s_saved_fraction", np.mean([p.saved for p in played])),
        *_memory_of(logs[0], 20 if options.quick else 60),
    ]  # fmt: skip


def _logs(options: Options) -> list[Path]:
    if options.scenes:
        return [folder.resolve().with_suffix(".mcap") for folder in options.scenes]
    if options.quick:
        return [DEMO]
    base = 1000 + 10 * options.seed
    kinds = [("apartment", base + i) for i in range(_APARTMENTS)] + [("tabletop", base + i) for i in range(_TABLETOPS)]
    return [cached_recording(walk_recording(*kind))[0] for kind in kinds]


def _played(log: Path) -> Played:
    images = TrueImages(load_truth(log.with_suffix(".truth")))
    scores: list[MaskScore] = []
    features: dict[int, list[NDArray[np.float32]]] = defaultdict(list)
    saved = 0.0
    for i, seen in enumerate(play_first_layer(log)):
        saved = seen.metrics["core/features_saved"]
        if i % _SCORED_EVERY:
            continue
        shown = images.at(seen.frame.stamp_ns)
        scores.append(score_masks(seen.perceived.segmentation.instances, shown, min_pixels(shown)))
        for thing, feature in _features(seen, shown):
            features[thing].append(feature)
    score, (same, different) = total(scores), _cosines(features)
    print(f"{log.stem}: {_line(score)}, {saved:.0%} of the feature evaluations saved", flush=True)
    return Played(score=score, same=same, different=different, saved=saved)


def _features(seen: PlayedKeyframe, shown: NDArray[np.int32]) -> list[tuple[int, NDArray[np.float32]]]:
    observations = seen.perceived.observations
    owners = {}
    for observation in observations:
        x0, y0, x1, y1 = observation.box_px
        ids, counts = np.unique(shown[y0:y1, x0:x1][observation.mask], return_counts=True)
        most = int(np.argmax(counts))
        if ids[most] > 0 and counts[most] > _OWN_SHARE * counts.sum():
            owners[observation.index] = int(ids[most])
    asked = ComputeFeatures(frame_index=seen.frame.index, observation_indices=tuple(owners))
    patches = ColorTextureDescriptor().extract(np.asarray(seen.frame.rgb))
    pooled = features_of(asked, observations, patches, ColorTextureDescriptor.patch_px).features
    return [(owners[feature.observation_index], feature.pooled) for feature in pooled]


def _cosines(features: Mapping[int, list[NDArray[np.float32]]]) -> tuple[list[float], list[float]]:
    views = [np.stack(features[thing]) for thing in sorted(features) if len(features[thing]) >= _MIN_VIEWS]
    same = [float(((own @ own.T).sum() - len(own)) / (len(own) * (len(own) - 1))) for own in views]
    return same, [float((a @ b.T).mean()) for i, a in enumerate(views) for b in views[i + 1 :]]


def _memory_of(log: Path, keyframes: int) -> list[Figure]:
    memory = keyframe_memory(log, keyframes=keyframes, rounds=_MEMORY_ROUNDS)
    print(f"memory on {memory.keyframes} keyframes of {log.stem}, {_MEMORY_ROUNDS} rounds; {WARM_KEYFRAMES} to warm up")
    return [
        figure("layer1_memory_mb", memory.layer1_mb, "MB", "lower"),
        figure("keyframe_memory_mb", memory.keyframes_mb, "MB", "lower"),
        figure("repeated_memory_mb", memory.rounds_mb, "MB", "lower"),
    ]


def _line(score: MaskScore) -> str:
    return (
        f"F1 {score.f1:.3f}, best IoU {score.best_iou:.3f}, {score.num_right} of {score.num_things} things right, "
        f"{score.num_masks} masks"
    )


# The memory of layer 1 in a process of its own: a log's keyframes are perceived and mapped, round after round.
# The memory of the process before is subtracted. Memory that a later round takes beyond the first was not released.
# Linux alone.
WARM_KEYFRAMES = 5
"""The first ones load weights and kernels."""


@dataclass(frozen=True, kw_only=True, slots=True)
class KeyframeMemory:
    """Megabytes of resident memory, of so many keyframes in each round."""

    # `layer1_mb`: the peak of all rounds; `keyframes_mb`: its rise after `WARM_KEYFRAMES`; `rounds_mb`: later rounds'
    # excess.

    keyframes: int
    layer1_mb: float
    keyframes_mb: float
    rounds_mb: float


def keyframe_memory(log: Path, *, keyframes: int, rounds: int) -> KeyframeMemory:
    """Return the memory of layer 1 on the first keyframes of a log, measured in a child process."""
    found: KeyframeMemory = in_child(_measured, log, keyframes=keyframes, rounds=rounds)
    return found


def _measured(log: Path, *, keyframes: int, rounds: int) -> KeyframeMemory:
    cv2.setNumThreads(1)
    config = MapperConfig()
    # The readers of logs are loaded before anything is counted.
    next(keyframes_of(log, config, 1))
    before_mb = resident_mb()
    segmenter = make_segmenter(config.perception)
    played = play_first_layer(log, config=config, segmenter=segmenter, max_keyframes=keyframes)
    first_mb = [resident_mb("VmHWM") for _ in played]
    for _ in range(rounds - 1):
        deque(play_first_layer(log, config=config, segmenter=segmenter, max_keyframes=keyframes), maxlen=0)
    last_mb = resident_mb("VmHWM")
    return KeyframeMemory(
        keyframes=len(first_mb),
        layer1_mb=last_mb - before_mb,
        keyframes_mb=first_mb[-1] - first_mb[min(WARM_KEYFRAMES, len(first_mb)) - 1],
        # The system updates the peak a little late, by up to some hundred kilobytes.
        rounds_mb=max(0.0, last_mb - first_mb[-1]),
    )
