"""How soon a robot keeps off the things that it sees: a live run of the embedded recording against its truth."""
# Counted from the first keyframe with a hundredth of a steradian of a thing within 3 m, to the first snapshot whose
# collision bodies hold 0.98 of the surface seen by then.

import asyncio
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.config_text import read_config
from hickory_stream.config import MapperConfig
from hickory_stream.engine.mapper import Mapper
from hickory_stream.evaluation.truth import Truth, frame_at, instances_of, load_truth
from hickory_stream.geometry.camera import backproject
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.superquadric import Superquadrics, implicit_value, volumes_m3, world_bounds
from hickory_stream.geometry.voxels import cells_of_keys, contains, keys_of_points, sorted_unique, union
from hickory_stream.navigation.stand_ins import SeenSurface, early_obstacles
from hickory_stream.records import FrameReport, MapSnapshot
from hickory_stream.testing import RememberingSink
from players import make_source_note, open_from_note
from players.options import SourceOptions
from players.playback import PlaybackClock
from tools.benchmarks.common.processes import NO_SHAPES

CONTAINED = 0.98
_NEAR_M = 3.0
_LEAST_SR = 0.01
_POINTS_M = 0.01


@dataclass(slots=True)
class Safety:
    """Of each true thing: when it was shown and first avoided (seconds after that), and its share in the bodies."""

    # `safe_log_s`: by stamps, without computing time. `contained`: shares of seen surface in stand-ins and layers 4;
    # `avoided`: with occupied space. `volumes`: stand-ins over final layers 4.

    shown_s: dict[int, float] = field(default_factory=dict)
    safe_s: dict[int, float] = field(default_factory=dict)
    safe_log_s: dict[int, float] = field(default_factory=dict)
    contained: list[float] = field(default_factory=list)
    avoided: list[float] = field(default_factory=list)
    volumes: list[float] = field(default_factory=list)


class Evaluation:
    """Compares the bodies that a robot avoids after each keyframe with the truth."""

    def __init__(self, truth: Truth) -> None:
        self.found = Safety()
        self._truth = truth
        self._stamps = np.array([frame.stamp_ns for frame in truth.frames])
        self._seen = SeenSurface()
        self._surface: dict[int, NDArray[np.int64]] = {}
        self._stand_ins: defaultdict[int, list[float]] = defaultdict(list)

    def add(self, report: FrameReport) -> None:
        at = frame_at(self._stamps, report.stamp_ns)
        if at is None:
            return
        assert report.frame is not None and report.space is not None and report.snapshot is not None
        self._seen.add(report.space, report.snapshot)
        instances = instances_of(self._truth, self._truth.frames[at])
        depth = report.frame.depth_m
        points = apply(report.world_from_camera, backproject(depth, report.camera))
        is_near = np.isfinite(depth) & (depth < _NEAR_M)
        per_pixel_sr = 1.0 / (report.camera.fx * report.camera.fy)
        for item in self._truth.objects:
            # Beside an edge the depth of a pixel may be another thing's.
            inner = cv2.erode((instances == item.id).astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)
            shown = is_near & inner
            if shown.sum() * per_pixel_sr >= _LEAST_SR:
                self.found.shown_s.setdefault(item.id, report.stamp_ns / 1e9)
            keys = sorted_unique(keys_of_points(points[shown], _POINTS_M))
            self._surface[item.id] = np.union1d(self._surface.get(item.id, np.empty(0, np.int64)), keys)
        self._compare(report, report.snapshot)

    def end(self, last: MapSnapshot) -> None:
        """Compare the stand-ins' volumes with those of the final layers 4."""
        for obstacle in early_obstacles(last.objects):
            if not obstacle.is_observed_only:
                final_m3 = float(volumes_m3(obstacle.body).sum())
                self.found.volumes += [volume / final_m3 for volume in self._stand_ins[obstacle.id]]

    def _compare(self, report: FrameReport, snapshot: MapSnapshot) -> None:
        obstacles = early_obstacles(snapshot.objects)
        for obstacle in obstacles:
            if obstacle.is_observed_only:
                self._stand_ins[obstacle.id].append(float(volumes_m3(obstacle.body).sum()))
        latency_s = dict(report.metrics)["time/latency"]
        space = snapshot.submaps[-1].observed_space
        occupied = union(self._seen.keys(), space.structure)
        for item_id, shown_s in self.found.shown_s.items():
            points = (cells_of_keys(self._surface[item_id]) + 0.5) * _POINTS_M
            is_held = np.zeros(len(points), bool)
            for obstacle in obstacles:
                is_held |= _inside(obstacle.body, points)
            is_avoided = is_held | contains(occupied, keys_of_points(points, space.voxel_m))
            self.found.contained.append(float(is_held.mean()))
            self.found.avoided.append(float(is_avoided.mean()))
            if is_avoided.mean() >= CONTAINED:
                waited_s = report.stamp_ns / 1e9 - shown_s
                self.found.safe_log_s.setdefault(item_id, waited_s)
                self.found.safe_s.setdefault(item_id, waited_s + latency_s)


def early_safety(log: Path, out: Path, *, seconds: float, has_shapes: bool = True) -> Safety:
    """Map the beginning of a log live, and return how soon and how well its things were avoided."""
    # A live run does not wait, and its evaluation takes longer than mapping.
    collected = RememberingSink()
    config = read_config(MapperConfig, None, () if has_shapes else (NO_SHAPES,))
    source = open_from_note(
        make_source_note([str(log)], SourceOptions(), end_s=seconds), PlaybackClock(1.0), config.keyframes
    )

    async def run() -> None:
        async with Mapper(config, out=out, overwrite=True) as mapper:
            async for _ in mapper.run(source, sinks=lambda _folder: [(collected, True)], mode="live"):
                pass

    asyncio.run(run())
    source.close()
    evaluation = Evaluation(load_truth(log.with_suffix(".truth")))
    mapped = [report for report in collected.reports if report.snapshot is not None]
    for report in mapped:
        if report.frame is not None and report.space is not None:
            evaluation.add(report)
    if mapped and (last := mapped[-1].snapshot) is not None:
        evaluation.end(last)
    return evaluation.found


def _inside(body: Superquadrics, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    is_inside = np.zeros(len(points), bool)
    for i, (low, high) in enumerate(world_bounds(body)):
        near = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
        is_inside[near] |= implicit_value(body, i, points[near]) <= 1.0
    return is_inside
