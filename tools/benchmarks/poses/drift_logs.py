"""Walks with odometry that drifts: each is rendered once, with exact poses; the odometries are put in as it is played.

What the camera sees does not depend on the odometry: the images are those of `make_recording --drift`, or of the
foreign program with `--drift`, and so are the poses, which both make of the true walk by a seed. A log of each would be
three times the rendering.
"""

from __future__ import annotations

import runpy
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import RecordingError
from hickory_stream.evaluation.open3d_import import import_open3d
from hickory_stream.evaluation.truth import load_truth
from hickory_stream.geometry.rigid import invert
from hickory_stream.ports import Source
from hickory_stream.records import Frame, RawFrame, SourceInfo
from hickory_stream.worlds.cache import cached_recording
from hickory_stream.worlds.drift import DriftConfig, drifted
from hickory_stream.worlds.recording_config import RecordingConfig
from hickory_stream.worlds.walkable import walkable_world
from players import open_source
from tools.benchmarks.common.figures import Options
from tools.benchmarks.foreign.logs import PROGRAM, WorldLog, foreign_log, worlds_folder

Poses = dict[int, "NDArray[np.float64]"]
"""Poses of the camera by stamp."""

FACTORS = (1.0, 3.0)
"""The default drift, and three times it."""

_SECONDS = 100.0
"""Long enough to go round twice, or nearly."""
_RATE_HZ = 3.0
"""More frames become no more keyframes, at the pace of these walks."""
_OWN_SEED = 24
_FOREIGN = "home"
_FOREIGN_SEED = 1
_DEFAULT = DriftConfig()


@dataclass(frozen=True, kw_only=True, slots=True)
class DriftingWalk:
    """A walk: its log, with exact poses, and odometries of it by how much they drift."""

    name: str
    log: WorldLog
    odometry: Mapping[float, Poses]

    def open(self, factor: float) -> Source:
        """Return the log as a source, with the odometry that drifts by this factor; 0: with exact poses."""
        source = open_source(str(self.log.log))
        return source if factor == 0.0 else _Drifting(source, self.odometry[factor])


def drifting_walks(options: Options) -> list[DriftingWalk]:
    """Return a walk through an apartment of ours, and one through a home by others if its folder is there.

    Both were used for tuning; they are rendered where they are not kept yet.
    """
    walks = [_own_walk(_OWN_SEED)]
    try:
        worlds = worlds_folder(options.worlds)
    except RecordingError:
        return walks
    return [*walks, _foreign_walk(worlds, _FOREIGN)]


def second_walks(options: Options) -> list[WorldLog]:
    """Return another walk through each of the same places, with exact poses."""
    config = replace(_own_config(_OWN_SEED), walk_index=1)
    log, truth = cached_recording(config)
    own = WorldLog(log=log, truth=truth.folder, key=log.stem.rsplit("-", 1)[-1])
    try:
        worlds = worlds_folder(options.worlds)
    except RecordingError:
        return [own]
    return [own, foreign_log(worlds, _FOREIGN, "B", "hand", _SECONDS, rate_hz=_RATE_HZ)]


def drift_of(factor: float) -> DriftConfig:
    """Return so many times the default drift of our worlds."""
    return replace(_DEFAULT, scale=factor * _DEFAULT.scale, yaw_deg_per_m=factor * _DEFAULT.yaw_deg_per_m)


def own_odometry(config: RecordingConfig, stamps_ns: list[int], factor: float) -> Poses:
    """Return the poses that the recording of a config would have at stamps if its odometry drifted by a factor."""
    _, trajectory = walkable_world(config)
    odometry = drifted(trajectory, drift_of(factor), np.random.default_rng([config.seed, 6, config.walk_index]))
    return {stamp_ns: odometry.pose_at((stamp_ns - stamps_ns[0]) / 1e9) for stamp_ns in stamps_ns}


def _own_walk(seed: int) -> DriftingWalk:
    config = _own_config(seed)
    log, truth = cached_recording(config)
    stamps_ns = [frame.stamp_ns for frame in truth.frames]
    return DriftingWalk(
        name=f"own{seed}",
        log=WorldLog(log=log, truth=truth.folder, key=log.stem.rsplit("-", 1)[-1]),
        odometry={factor: own_odometry(config, stamps_ns, factor) for factor in FACTORS},
    )


def _own_config(seed: int) -> RecordingConfig:
    return RecordingConfig(scene="apartment", seed=seed, seconds=_SECONDS, rate_hz=_RATE_HZ, width=640, height=480)


def _foreign_walk(worlds: Path, world: str) -> DriftingWalk:
    log = foreign_log(worlds, world, "A", "hand", _SECONDS, rate_hz=_RATE_HZ)
    frames = load_truth(log.truth).frames
    import_open3d()  # as the program needs it
    program = runpy.run_path(str(worlds / PROGRAM))
    link_from_camera = program["link_from_optical"]()
    exact = np.array([frame.world_from_camera for frame in frames]) @ invert(link_from_camera)
    odometry = {}
    for factor in FACTORS:
        link = program["drifted"](exact, _RATE_HZ, _FOREIGN_SEED, factor)
        odometry[factor] = {f.stamp_ns: pose @ link_from_camera for f, pose in zip(frames, link, strict=True)}
    return DriftingWalk(name=world, log=log, odometry=odometry)


class _Drifting:
    """The frames of a source at the poses of another odometry."""

    def __init__(self, source: Source, poses: Poses) -> None:
        self._source = source
        self._poses = poses

    @property
    def info(self) -> SourceInfo:
        """The info of the source."""
        return self._source.info

    def frames(self) -> Iterator[RawFrame]:
        """Yield its frames where the odometry has them."""
        for raw in self._source.frames():
            pose = self._poses[raw.stamp_ns]
            yield replace(raw, world_from_camera=pose, decode=partial(_decoded, raw, pose))

    def ledger(self) -> Mapping[str, int]:
        """Return the ledger of the source."""
        return self._source.ledger()

    def close(self) -> None:
        """Close the source."""
        self._source.close()


def _decoded(raw: RawFrame, pose: NDArray[np.float64]) -> Frame:
    return replace(raw.decode(), world_from_camera=pose)
