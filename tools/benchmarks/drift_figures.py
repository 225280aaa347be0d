"""Logs whose odometry drifts, mapped as `play` maps them: how far the poses are off, and what the map loses by it.

The same walks with exact poses are what they are held against. What is on by default (registration of keyframes, the
pose graph) is on; `mapped` takes other configurations, to measure each alone.
"""

from __future__ import annotations

import asyncio
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.config import MapperConfig, read_config
from hickory_stream.engine.journal import Journal
from hickory_stream.engine.keyframe_places import KeyframePlaces, PlacedFrame
from hickory_stream.engine.mapper import Mapper
from hickory_stream.engine.saved_map import open_map
from hickory_stream.errors import RecordingError
from hickory_stream.evaluation.match import score_map
from hickory_stream.evaluation.trajectory_error import trajectory_error
from hickory_stream.evaluation.truth import load_truth
from hickory_stream.events import FrameObserved
from hickory_stream.geometry.rigid import compose
from hickory_stream.poses.registration_config import RegistrationConfig
from hickory_stream.records import Phase
from hickory_stream.worlds.cache import cached_recording
from hickory_stream.worlds.drift import DriftConfig, drifted
from hickory_stream.worlds.recording import RecordingConfig
from hickory_stream.worlds.trajectory import Trajectory
from players import open_source
from tools.benchmarks.figures import Figure
from tools.benchmarks.first_layer import keyframes_of
from tools.benchmarks.foreign_logs import WorldLog, foreign_log, worlds_folder

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from tools.benchmarks.figures import Options

Poses = dict[int, "NDArray[np.float64]"]

_SECONDS = 100.0
"""Long enough to go round twice."""
_LAYER_ONE = ("mapping.requests.max_failures=0", "journal.keep_images=false")
_DEFAULT = DriftConfig()


@dataclass(frozen=True, kw_only=True, slots=True)
class Drifted:
    """A walk: its log with exact poses, and logs of the same with odometry that drifts, by how much it does."""

    name: str
    exact: WorldLog
    drifting: Mapping[float, WorldLog]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Mapped:
    """What a run made of a log: where its keyframes are, and layer 1 against the truth."""

    poses: Poses
    recall_50: float
    f1_25: float
    tracks_per_object: float


def drifting_walks(options: Options) -> list[Drifted]:
    """Return walks through own and foreign worlds, rendered where they are not kept yet; of the latter if there."""
    walks = []
    for seed in (24, 30):
        config = RecordingConfig(scene="apartment", seed=seed, seconds=_SECONDS, rate_hz=5.0, width=640, height=480)
        logs = {factor: _recorded(replace(config, drift=_drift(factor))) for factor in (1.0, 3.0)}
        walks.append(Drifted(name=f"own{seed}", exact=_recorded(config), drifting=logs))
    try:
        worlds = worlds_folder(options.worlds)
    except RecordingError:
        return walks
    for world in ("home", "bookstore"):
        exact = foreign_log(worlds, world, "A", "hand", _SECONDS)
        logs = {factor: foreign_log(worlds, world, "A", "hand", _SECONDS, drift=factor) for factor in (1.0, 3.0)}
        walks.append(Drifted(name=world, exact=exact, drifting=logs))
    return walks


def drift_figures(options: Options) -> list[Figure]:
    """Return how much of a drift is taken out, and what maps lose by the rest, the worst of all walks."""
    config = read_config(MapperConfig, None, _LAYER_ONE)
    ratios: dict[float, list[float]] = {1.0: [], 3.0: []}
    ates_m, recall_losses, f1_losses, tracks = [], [], [], []
    walks = drifting_walks(options)
    for walk in walks:
        exact = mapped(walk.exact, config)
        for factor, log in walk.drifting.items():
            own = mapped(log, config)
            before_m, after_m = ate_m(odometry_of(log, own.poses), log), ate_m(own.poses, log)
            told = f"recall {own.recall_50:.2f} of {exact.recall_50:.2f}"
            print(f"{walk.name}, drift {factor:g}: {before_m:.3f} to {after_m:.3f} m, {told}", flush=True)
            ratios[factor].append(after_m / before_m)
            if factor == 1.0:
                ates_m.append(after_m)
            recall_losses.append(exact.recall_50 - own.recall_50)
            f1_losses.append(exact.f1_25 - own.f1_25)
            tracks.append(own.tracks_per_object)
    of = f"the worst of {len(walks)} walks, each with its drift and three times it"
    return [
        Figure(name="poses_ate_ratio_1pct", value=max(ratios[1.0]), unit="", better="lower", of=of),
        Figure(name="poses_ate_m_1pct", value=max(ates_m), unit="m", better="lower", of=of),
        Figure(name="poses_ate_ratio_3pct", value=max(ratios[3.0]), unit="", better="lower", of=of),
        Figure(name="drift_recall_50_loss", value=max(recall_losses), unit="", better="lower", of=of),
        Figure(name="drift_f1_25_loss", value=max(f1_losses), unit="", better="lower", of=f"layer 1, {of}"),
        Figure(name="drift_tracks_per_object", value=max(tracks), unit="", better="lower", of=of),
    ]


def registration_figures(log: Path) -> list[Figure]:
    """Return the processor time of a keyframe's registration, and how much of a drift it alone takes out of a log.

    The poses of the log are exact; the drift is put on them, by the default and by three times it.
    """
    frames = list(keyframes_of(log, MapperConfig()))
    true = np.array([frame.world_from_camera for frame in frames])
    found, ms = [], []
    for factor in (1.0, 3.0):
        places = KeyframePlaces(RegistrationConfig())
        poses = []
        drifting = _with_drift(true, factor)
        for frame, pose in zip(frames, drifting, strict=True):
            started_s = time.process_time()
            placed = places.place(replace(frame, world_from_camera=pose))
            ms.append(1e3 * (time.process_time() - started_s))
            poses.append(placed.frame.world_from_camera if isinstance(placed, PlacedFrame) else places.where(pose))
        stamps_ns = [frame.stamp_ns for frame in frames]
        before, after = (trajectory_error(stamps_ns, np.array(p), stamps_ns, true) for p in (drifting, poses))
        found.append(after.ate_m / before.ate_m)
    of = f"{len(frames)} keyframes, {log.stem}"
    return [
        Figure(name="register_ms", value=float(np.mean(ms[3:])), unit="ms", better="lower", of=f"processor time, {of}"),
        Figure(name="registration_ate_ratio_1pct", value=found[0], unit="", better="lower", of=of),
        Figure(name="registration_ate_ratio_3pct", value=found[1], unit="", better="lower", of=of),
    ]


def mapped(log: WorldLog, config: MapperConfig) -> Mapped:
    """Return what `play` with a configuration makes of a log, without shapes."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "map"
        asyncio.run(_map(log.log, config, out))
        saved = open_map(out)
        poses = _poses_of(out, {s.id: s.world_from_submap for s in saved.snapshot.submaps})
    objects = tuple(item for item in saved.snapshot.objects if item.phase is not Phase.TENTATIVE)
    score = score_map(replace(saved.snapshot, objects=objects), {}, load_truth(log.truth))
    counted = [row for row in score.truth if row.counts]
    recall = sum(row.map_id is not None for row in counted) / len(counted)
    return Mapped(
        poses=poses,
        recall_50=sum(row.strict_map_id is not None for row in counted) / len(counted),
        f1_25=2 * recall * score.precision_25 / max(recall + score.precision_25, 1e-9),
        tracks_per_object=score.tracks_per_object,
    )


def ate_m(poses: Poses, log: WorldLog) -> float:
    """Return the error of poses by stamp against the truth of a log, after alignment."""
    truth = load_truth(log.truth).frames
    stamps_ns = sorted(poses)
    return trajectory_error(
        stamps_ns,
        np.array([poses[stamp_ns] for stamp_ns in stamps_ns]),
        [frame.stamp_ns for frame in truth],
        np.array([frame.world_from_camera for frame in truth]),
    ).ate_m


def odometry_of(log: WorldLog, wanted: Poses) -> Poses:
    """Return the poses of a log's odometry at the stamps of others."""
    source = open_source(str(log.log))
    try:
        return {raw.stamp_ns: raw.world_from_camera for raw in source.frames() if raw.stamp_ns in wanted}
    finally:
        source.close()


async def _map(log: Path, config: MapperConfig, out: Path) -> None:
    source = open_source(str(log))
    try:
        async with Mapper(config, out=out) as mapper:
            async for _ in mapper.run(source):
                pass
    finally:
        source.close()


def _poses_of(path: Path, places: Mapping[int, NDArray[np.float64]]) -> Poses:
    """Return where the keyframes of a map lie in the end, by their stamps."""
    poses: Poses = {}
    with Journal(path) as journal:
        for entry in journal.entries():
            for event in entry.events:
                if isinstance(event, FrameObserved):
                    submap_id = entry.told.submap_id if entry.told is not None else 0
                    poses[event.stamp_ns] = compose(places.get(submap_id, np.eye(4)), event.world_from_camera)
    return poses


def _with_drift(true: NDArray[np.float64], factor: float) -> Sequence[NDArray[np.float64]]:
    trajectory = Trajectory(times_s=np.arange(len(true), dtype=float), world_from_camera=true)
    drift = _drift(factor)
    return list(drifted(trajectory, drift, np.random.default_rng([1, 6])).world_from_camera)


def _drift(factor: float) -> DriftConfig:
    return replace(_DEFAULT, scale=factor * _DEFAULT.scale, yaw_deg_per_m=factor * _DEFAULT.yaw_deg_per_m)


def _recorded(config: RecordingConfig) -> WorldLog:
    log, truth = cached_recording(config)
    return WorldLog(log=log, truth=truth.folder, key=log.stem.rsplit("-", 1)[-1])
