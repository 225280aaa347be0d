"""Maps of logs whose odometry drifts, as `play` makes them: how far poses are off, and what the map loses by it.

They are held against the maps of the same walks with exact poses. What is on by default (registration of keyframes, the
pose graph) is on. Each map is kept under `--state` by the code that it was made with; a later call goes on.
"""

from __future__ import annotations

import asyncio
import tempfile
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.base.config_text import read_config
from hickory_stream.config import MapperConfig
from hickory_stream.engine.keyframe_places import PlacedFrame, RegistrationFilter
from hickory_stream.engine.mapper import Mapper
from hickory_stream.evaluation.evaluate import evaluate
from hickory_stream.evaluation.trajectory_error import best_alignment, trajectory_error
from hickory_stream.evaluation.truth import load_truth, moved_truth
from hickory_stream.events import FrameObserved
from hickory_stream.geometry.rigid import compose, from_rotation_translation
from hickory_stream.journal.reader import Journal
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.poses.registration_config import RegistrationConfig
from hickory_stream.worlds.drift import drifted
from hickory_stream.worlds.trajectory import Trajectory
from tools.benchmarks.drift_logs import FACTORS, Poses, drift_of, drifting_walks
from tools.benchmarks.figures import Figure
from tools.benchmarks.first_layer import keyframes_of
from tools.benchmarks.intervals import bootstrap
from tools.benchmarks.kept import kept, state_folder

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from hickory_stream.ports import Source
    from tools.benchmarks.drift_logs import DriftingWalk
    from tools.benchmarks.figures import Options

CONFIG = ("journal.keep_images=false", "run.shape_cache=false")


@dataclass(frozen=True, kw_only=True, slots=True)
class Mapped:
    """What a run made of a walk: its poses, and what the map has of the true objects that count, each in turn.

    `before_m` and `after_m` are the ATE of `num_poses` keyframes as odometry has them and as the map has them.
    `found_50` and `f1_5pct` are of the mesh of each true object, `tracks` how many objects lie mostly on it; the same
    `_aligned` with the truth placed where the ATE has it: a map whose first keyframes are off is turned as a whole.
    """

    before_m: float
    after_m: float
    num_poses: int
    num_loops: int
    num_objects: int
    found_50: list[bool]
    f1_5pct: list[float]
    found_50_aligned: list[bool]
    f1_5pct_aligned: list[float]
    tracks: list[int]
    wall_s: float


def drift_figures(options: Options) -> list[Figure]:
    """Return how much of a drift is taken out, and what maps lose by the rest, the worst of all walks."""
    folder = state_folder(options.state, "drift")
    walks = drifting_walks(options)
    exact = {walk.name: _kept(folder, walk, 0.0) for walk in walks}
    runs = {(walk.name, factor): _kept(folder, walk, factor) for walk in walks for factor in FACTORS}
    for (name, factor), run in runs.items():
        found, of = sum(run.found_50), len(run.found_50)
        print(
            f"{name}, drift {factor:g}: ATE {1e3 * run.before_m:.1f} to {1e3 * run.after_m:.1f} mm, {run.num_loops} "
            f"loops; at 0.5 {found} of {of}, exact {sum(exact[name].found_50)}; F1 {np.mean(run.f1_5pct):.3f}, exact "
            f"{np.mean(exact[name].f1_5pct):.3f}; {run.wall_s:.0f} s",
            flush=True,
        )
    told = ", ".join(walk.name for walk in walks)
    figures = []
    for name, factor in (("poses_ate_ratio_1pct", 1.0), ("poses_ate_ratio_3pct", 3.0)):
        own = {walk.name: runs[walk.name, factor] for walk in walks}
        worst = max(own, key=lambda name: own[name].after_m / own[name].before_m)
        value = own[worst].after_m / own[worst].before_m
        of = f"{own[worst].num_poses} keyframes of {worst}, the worst of {told}"
        figures.append(Figure(name=name, value=value, unit="", better="lower", of=of, role="tuned on"))
    worst_m, of = max((runs[walk.name, 1.0].after_m, walk.name) for walk in walks)
    figures.insert(
        1, Figure(name="poses_ate_m_1pct", value=worst_m, unit="m", better="lower", of=f"{of}, the worst of {told}",
                  role="tuned on"),
    )  # fmt: skip
    figures += [
        _loss("drift_recall_50_loss", exact, runs, lambda run: run.found_50),
        _loss("drift_f1_loss", exact, runs, lambda run: run.f1_5pct),
        _loss("drift_recall_50_loss_aligned", exact, runs, lambda run: run.found_50_aligned),
        _loss("drift_f1_loss_aligned", exact, runs, lambda run: run.f1_5pct_aligned),
    ]
    per_object = {key: np.mean([count for count in run.tracks if count]) for key, run in runs.items()}
    worst_key = max(per_object, key=lambda key: per_object[key])
    counts = np.array([count for count in runs[worst_key].tracks if count], dtype=np.float64)
    figures.append(
        Figure(
            name="drift_tracks_per_object", value=float(per_object[worst_key]), unit="", better="lower",
            of=f"{len(counts)} true objects with a track, {worst_key[0]} at {worst_key[1]:g}, the worst of {len(runs)}",
            interval=bootstrap([counts], lambda groups: float(groups[0].mean())), interval_by="bootstrap",
            role="tuned on",
        )
    )  # fmt: skip
    return figures


def registration_figures(log: Path) -> list[Figure]:
    """Return the processor time of a keyframe's registration, and how much of a drift it alone takes out of a log.

    The poses of the log are exact; the drift is put on them, by the default and by three times it.
    """
    frames = list(keyframes_of(log, MapperConfig()))
    true = np.array([frame.world_from_camera for frame in frames])
    found, ms = [], []
    for factor in FACTORS:
        places = RegistrationFilter(RegistrationConfig())
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


def _kept(folder: Path, walk: DriftingWalk, factor: float) -> Mapped:
    """Return what a run makes of a walk with an odometry, measured only if it is not kept yet."""

    def measured() -> dict[str, Any]:
        print(f"{walk.name}, drift {factor:g}: minutes", flush=True)
        return asdict(mapped(walk, factor, read_config(MapperConfig, None, CONFIG)))

    return Mapped(**kept(folder / f"{walk.name}-{walk.log.key}-{factor:g}.json", measured))


def mapped(walk: DriftingWalk, factor: float, config: MapperConfig) -> Mapped:
    """Return what `play` with a configuration makes of a walk with an odometry."""
    started_s = time.monotonic()
    truth = load_truth(walk.log.truth)
    true = {frame.stamp_ns: frame.world_from_camera for frame in truth.frames}
    with tempfile.TemporaryDirectory() as temporary:
        out = Path(temporary) / "map"
        asyncio.run(map_source(walk.open(factor), config, out))
        saved = open_map(out)
        graph = saved.snapshot.graph
        poses = keyframe_poses(out, {s.id: s.world_from_submap for s in saved.snapshot.submaps})
        found = evaluate(saved, truth)
        aligned = evaluate(saved, moved_truth(truth, _map_from_world(poses, true)))
    odometry = {stamp_ns: (walk.odometry[factor] if factor else true)[stamp_ns] for stamp_ns in poses}
    return Mapped(
        before_m=_ate_m(odometry, true),
        after_m=_ate_m(poses, true),
        num_poses=len(poses),
        num_loops=0 if graph is None else sum(loop.status == "accepted" for loop in graph.loops),
        num_objects=found.num_objects,
        found_50=[row.strict_map_id is not None for row in found.objects],
        f1_5pct=[row.f1_5pct for row in found.objects],
        found_50_aligned=[row.strict_map_id is not None for row in aligned.objects],
        f1_5pct_aligned=[row.f1_5pct for row in aligned.objects],
        tracks=[len(row.track_ids) for row in found.objects],
        wall_s=time.monotonic() - started_s,
    )


def _loss(
    name: str,
    exact: Mapping[str, Mapped],
    runs: Mapping[tuple[str, float], Mapped],
    value_of: Callable[[Mapped], Sequence[float]],
) -> Figure:
    """Return by how much a mean over true objects is below that with exact poses, the worst of all runs."""
    losses = {
        (walk, factor): np.array(value_of(exact[walk]), dtype=np.float64) - np.array(value_of(run), dtype=np.float64)
        for (walk, factor), run in runs.items()
    }
    worst = max(losses, key=lambda key: losses[key].mean())
    return Figure(
        name=name,
        value=float(losses[worst].mean()),
        unit="",
        better="lower",
        of=f"{len(losses[worst])} true objects, {worst[0]} at {worst[1]:g}, the worst of {len(runs)}",
        interval=bootstrap([losses[worst]], lambda groups: float(groups[0].mean())),
        interval_by="bootstrap over objects",
        role="tuned on",
    )


def _ate_m(poses: Poses, true: Poses) -> float:
    """Return the error of poses against true ones, both by stamp, after alignment."""
    estimated = np.array([poses[stamp_ns] for stamp_ns in sorted(poses)])
    truth = np.array([true[stamp_ns] for stamp_ns in sorted(true)])
    return trajectory_error(sorted(poses), estimated, sorted(true), truth).ate_m


def _map_from_world(poses: Poses, true: Poses) -> NDArray[np.float64]:
    """Return the rigid transform (4, 4) of true positions onto those of a map, as the ATE has it."""
    found, there = (np.array([each[stamp_ns][:3, 3] for stamp_ns in sorted(poses)]) for each in (poses, true))
    return from_rotation_translation(*best_alignment(there, found))


async def map_source(source: Source, config: MapperConfig, out: Path) -> None:
    """Map a source into a folder, and close it."""
    try:
        async with Mapper(config, out=out) as mapper:
            async for _ in mapper.run(source):
                pass
    finally:
        source.close()


def keyframe_poses(path: Path, places: Mapping[int, NDArray[np.float64]]) -> Poses:
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
    return list(drifted(trajectory, drift_of(factor), np.random.default_rng([1, 6])).world_from_camera)
