"""Walks with odometry that drifts: each is rendered once, with exact poses; the odometries replace these in playback.

The images do not depend on the odometry: they are those of `make_recording --drift`, or of the foreign program with
`--drift`, and so are the poses, which both derive from the true walk by a seed. A log of each would be three times the
rendering.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import RecordingError
from hickory_stream.evaluation.truth import load_truth
from hickory_stream.geometry.rigid import invert
from hickory_stream.ports import Source
from players import open_source
from tools.benchmarks.common.figures import Options
from tools.benchmarks.foreign.logs import WorldLog, foreign_log, recorded, world_program, worlds_folder
from tools.evaluation.simulated_maps.moved_source import MovedSource
from tools.worlds.drift import drift_of, drifted, drifted_poses
from tools.worlds.recording_config import RecordingConfig, walkable_world

Poses = dict[int, NDArray[np.float64]]
"""Poses of the camera by stamp."""

FACTORS = (1.0, 3.0)
"""The default drift, and three times it."""

# Seconds: long enough to go round twice, or nearly. More frames become no more keyframes, at the pace of these walks.
_SECONDS, _RATE_HZ = 100.0, 3.0
_OWN = RecordingConfig(scene="apartment", seed=24, seconds=_SECONDS, rate_hz=_RATE_HZ, width=640, height=480)
_FOREIGN, _FOREIGN_SEED = "home", 1


@dataclass(frozen=True, kw_only=True, slots=True)
class DriftingWalk:
    """A walk: its log, with exact poses, and odometries of it by how much they drift."""

    name: str
    log: WorldLog
    odometry: Mapping[float, Poses]

    def open(self, factor: float) -> Source:
        """Return the log as a source, with the odometry that drifts by this factor; 0: with exact poses."""
        source = open_source(str(self.log.log))
        return source if factor == 0.0 else moved_to(source, self.odometry[factor])


def drifting_walks(options: Options) -> list[DriftingWalk]:
    """Return a walk through an apartment of ours, and one through a home by others if its folder is there."""
    # Both were used for tuning; they are rendered where they are not cached.
    walks = [_own_walk()]
    try:
        worlds = worlds_folder(options.worlds)
    except RecordingError:
        return walks
    return [*walks, _foreign_walk(worlds)]


def drifting(true: Poses, factor: float, seed: Sequence[int]) -> Poses:
    """Return poses by odometry that drifts by so many times the default, from the first pose on."""
    moved = drifted_poses(np.array(list(true.values())), drift_of(factor), np.random.default_rng(seed))
    return dict(zip(true, moved, strict=True))


def moved_to(source: Source, poses: Poses) -> Source:
    """Return a log as a source with other poses."""
    return MovedSource(source, lambda raw: poses[raw.stamp_ns])


def _own_walk() -> DriftingWalk:
    log = recorded(_OWN)
    stamps_ns = [frame.stamp_ns for frame in load_truth(log.truth).frames]
    _, trajectory = walkable_world(_OWN)
    odometry = {}
    for factor in FACTORS:
        moved = drifted(trajectory, drift_of(factor), np.random.default_rng([_OWN.seed, 6, _OWN.walk_index]))
        odometry[factor] = {stamp_ns: moved.pose_at((stamp_ns - stamps_ns[0]) / 1e9) for stamp_ns in stamps_ns}
    return DriftingWalk(name=f"own{_OWN.seed}", log=log, odometry=odometry)


def _foreign_walk(worlds: Path) -> DriftingWalk:
    log = foreign_log(worlds, _FOREIGN, "A", "hand", _SECONDS, rate_hz=_RATE_HZ)
    frames = load_truth(log.truth).frames
    program = world_program(worlds)
    link_from_camera = program["link_from_optical"]()
    exact = np.array([frame.world_from_camera for frame in frames]) @ invert(link_from_camera)
    odometry = {}
    for factor in FACTORS:
        link = program["drifted"](exact, _RATE_HZ, _FOREIGN_SEED, factor)
        odometry[factor] = {f.stamp_ns: pose @ link_from_camera for f, pose in zip(frames, link, strict=True)}
    return DriftingWalk(name=_FOREIGN, log=log, odometry=odometry)
