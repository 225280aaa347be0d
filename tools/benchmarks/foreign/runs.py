"""One part of the gate, measured: a log played as `play` does on a rung of the ladder, clouds, the kitchen, speed."""

import json
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from hickory_stream.config import MapperConfig
from hickory_stream.errors import RecordingError
from hickory_stream.evaluation.evaluate import evaluate
from hickory_stream.evaluation.labels import load_labels, score_labels
from hickory_stream.evaluation.match import MIN_SEEN, best_box, meshes_of
from hickory_stream.evaluation.reach import depth_on_labels
from hickory_stream.evaluation.surface_score import area_m2, generated_m2
from hickory_stream.evaluation.truth import load_truth
from hickory_stream.evaluation.truth_sightings import middle
from hickory_stream.evaluation.why import investigate, why_of
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.perception.choose import make_segmenter
from hickory_stream.ports import Segmenter
from hickory_stream.records import Frame, MapPrior, Phase, Segmentation
from players import open_source
from tools.benchmarks.common.cached_runs import play_into
from tools.benchmarks.common.processes import ROOT, output_of, play
from tools.evaluation.masks.first_layer import play_first_layer
from tools.evaluation.masks.labelled_clouds import clouds_in, load_cloud, score_cloud
from tools.evaluation.oracle_ablation import Rung, TrueImages, core_of, segmenter_of

_TIMED_KEYFRAMES = 60
_WARM_KEYFRAMES = 5


def mapped_on(rung: Rung, log: Sequence[Path], truth_folder: Path, out: Path) -> dict[str, Any]:
    """Return what `mapped` does, on a rung of the ladder of oracles."""
    config = MapperConfig()
    images = TrueImages(load_truth(truth_folder))
    ports = {"segmenter": segmenter_of(rung, images, config), "core": core_of(rung, images, config)}
    return mapped(log, truth_folder, out, config, **ports)


def mapped(
    log: Path | Sequence[Path], truth_folder: Path, out: Path, config: MapperConfig, **ports: Any
) -> dict[str, Any]:
    """Return the true objects that count and the objects of a map, each with its match or the reason for none."""
    truth = load_truth(truth_folder)
    config = replace(config, run=replace(config.run, shape_cache=False))
    play_into(out, open_source(log), config, **ports)
    saved = open_map(out)
    history = investigate(saved, truth)
    found, meshes, why = evaluate(saved, truth, history.score), meshes_of(saved), why_of(history)
    reasons = {item.truth_id: item.reason for item in why.missed}
    origins = {item.map_id: item.origin for item in why.false}
    matched, strict = {row.map_id for row in found.objects}, {row.strict_map_id for row in found.objects}
    eyes = np.array([frame.world_from_camera[:3, 3] for frame in truth.frames])
    nearest_m = {item.id: float(np.linalg.norm(eyes - middle(truth, item), axis=1).min()) for item in truth.objects}
    return {
        "truth": [
            {
                **asdict(row),
                "id": row.truth_id,
                "size_m": round(row.diameter_m, 4),
                "found_25": row.map_id is not None,
                "found_50": row.strict_map_id is not None,
                "adds_10": row.add_s_m is not None and row.add_s_m < 0.1 * row.diameter_m,
                "tracks": len(row.track_ids),
                "missed_because": reasons.get(row.truth_id),
                "nearest_m": nearest_m[row.truth_id],
            }
            for row in found.objects
        ],
        "objects": [
            {
                "id": item.id,
                "size_m": round(float(2 * np.linalg.norm(best_box(item, meshes).half_extents_m)), 4),
                "right_25": item.id in matched,
                "right_50": item.id in strict,
                "ignored": item.id in found.ignored_ids,
                "is_structure": item.id in found.structure_ids,
                "surface_m2": area_m2(meshes[item.id]) if item.id in meshes else 0.0,
                "generated_m2": generated_m2(meshes[item.id]) if item.id in meshes else 0.0,
                "false_because": origins.get(item.id),
            }
            for item in saved.snapshot.objects
            if item.phase is not Phase.TENTATIVE
        ],
        "little_seen": sum(item.seen_fraction < MIN_SEEN for item in truth.objects),
    }


def clouds_scored(folder: Path) -> dict[str, Any]:
    """Return the counts of the masks of each labelled cloud of a folder."""
    # Raises RecordingError: there are none.
    clouds = []
    for path in clouds_in(folder):
        cloud = load_cloud(path)
        ids, pixels = np.unique(cloud.truth[cloud.truth > 1], return_counts=True)
        score = score_cloud(cloud)
        small = int((pixels < cloud.min_pixels).sum())
        counts = {"things": score.num_things, "masks": score.num_masks, "right": score.num_right}
        clouds.append({"name": path.stem, "small": small, "labelled": len(ids), **counts})
    return {"clouds": clouds}


def kitchen_scored(data: Path, scorer: Path) -> dict[str, Any]:
    """Return the report of the scorer, run as a program, on a map of the labelled kitchen."""
    # Raises RecordingError: the frames, the truth or the scorer are not there, or it fails.
    frames, boxes = data / "redkitchen", data / "redkitchen_truth" / "boxes.json"
    for needed in (frames, boxes, scorer):
        if not needed.exists():
            raise RecordingError(f"{needed} is not there: the kitchen cannot be scored")
    with tempfile.TemporaryDirectory() as temporary:
        out = Path(temporary) / "map"
        play(frames, out)
        try:
            report = json.loads(output_of(scorer, out, boxes, "--json"))
        except RuntimeError as error:
            raise RecordingError(f"{scorer} failed: {error}") from error
        saved, labels = open_map(out), load_labels(boxes)
        score = score_labels(saved.snapshot, meshes_of(saved), labels, depth_on_labels(saved, labels))
    entries = {row["id"]: row for row in json.loads(boxes.read_text(encoding="utf-8"))["objects"]}
    levels, reachable = ("0.25", "0.5"), {row.truth_id for row in score.truth if row.is_reachable}
    return {
        "truth": [
            {
                "name": row["name"],
                "size_m": float(np.linalg.norm(entries[row["id"]]["size"])),
                "found_25": row["object"] is not None,
                "reachable": row["id"] in reachable,
            }
            for row in report["objects"]
        ],
        "generated_share": score.generated_share,
        "ignored_truth": sum(bool(row["ignore"]) for row in entries.values()),
        **{key: {level: report[level][key] for level in levels} for key in ("found", "false", "not_counted")},
    }


class _Timed:
    def __init__(self, segmenter: Segmenter) -> None:
        self._segmenter = segmenter
        self.seconds: list[float] = []

    def prepare(self, frame: Frame) -> object:
        return self._segmenter.prepare(frame)

    def segment(self, frame: Frame, prior: MapPrior | None = None, prepared: object = None) -> Segmentation:
        started = time.process_time()
        found = self._segmenter.segment(frame, prior, prepared)
        self.seconds.append(time.process_time() - started)
        return found


def timed(log: Path) -> dict[str, Any]:
    """Return the processor time of layer 1 and of its segmenter, medians over keyframes, and the size of the weights.

    A keyframe has all of layer 1: reading, decoding, masks, lifting, the space, features and the core.
    """
    config = MapperConfig()
    segmenter = _Timed(make_segmenter(config.perception))
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        moments = [time.process_time()]
        for _ in play_first_layer(log, config=config, segmenter=segmenter, max_keyframes=_TIMED_KEYFRAMES):
            moments.append(time.process_time())  # noqa: PERF401 # each is of the moment
    finally:
        cv2.setNumThreads(threads)
    seconds = np.diff(moments)
    weights = (ROOT / "hickory_stream" / "perception" / "weights").rglob("*")
    return {
        "segmenter": config.perception.segmenter,
        "segmenter_ms": 1e3 * float(np.median(segmenter.seconds[_WARM_KEYFRAMES:])),
        "keyframe_ms": 1e3 * float(np.median(seconds[_WARM_KEYFRAMES:])),
        "keyframes": len(seconds) - _WARM_KEYFRAMES,
        "weights_mb": sum(path.stat().st_size for path in weights if path.suffix in (".npz", ".onnx")) / 1e6,
    }
