"""Maps of logs whose odometry drifts, as `play` makes them: the error of poses, and the loss of the map."""
# They are compared with the maps of the same walks with exact poses. Registration of keyframes and the pose graph are
# on, as by default. Each result is cached under `--state` by the code; a later call continues.

import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.config_text import read_config
from hickory_stream.config import MapperConfig
from hickory_stream.engine.keyframe_places import PlacedFrame, RegistrationFilter
from hickory_stream.evaluation.evaluate import evaluate
from hickory_stream.evaluation.trajectory_error import best_alignment, trajectory_error
from hickory_stream.evaluation.truth import load_truth, moved_truth
from hickory_stream.events import FrameObserved
from hickory_stream.geometry.rigid import compose, from_rotation_translation
from hickory_stream.journal.reader import Journal
from hickory_stream.map_folder.saved_map import SavedMap, open_map
from hickory_stream.poses.registration_config import RegistrationConfig
from tools.benchmarks.common.cached_runs import cached, play_into, state_folder
from tools.benchmarks.common.figures import Figure, Options, figure, mean
from tools.benchmarks.poses.drift_logs import FACTORS, DriftingWalk, Poses, drifting_walks
from tools.evaluation.masks.first_layer import keyframes_of
from tools.worlds.drift import drift_of, drifted_poses

CONFIG = ("journal.keep_images=false", "run.shape_cache=false")


@dataclass(frozen=True, kw_only=True, slots=True)
class Mapped:
    """The result of a run on a walk: errors of its poses, and of the map for each true object that counts."""

    # ATE of odometry and of the map. `found_50`, `f1_5pct` are by true object, `tracks` counts its objects; `_aligned`:
    # with the truth placed as the ATE places it.

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
    """Return how much of a drift is removed, and the loss of maps to the rest, the worst of all walks."""
    folder = state_folder(options.state, "drift")
    walks = drifting_walks(options)
    exact = {walk.name: _cached(folder, walk, 0.0) for walk in walks}
    runs = {(walk.name, factor): _cached(folder, walk, factor) for walk in walks for factor in FACTORS}
    for (name, factor), run in runs.items():
        found, of = sum(run.found_50), len(run.found_50)
        print(
            f"{name}, drift {factor:g}: ATE {1e3 * run.before_m:.1f} to {1e3 * run.after_m:.1f} mm, {run.num_loops} "
            f"loops; at 0.5 {found} of {of}, exact {sum(exact[name].found_50)}; F1 {np.mean(run.f1_5pct):.3f}, exact "
            f"{np.mean(exact[name].f1_5pct):.3f}; {run.wall_s:.0f} s",
            flush=True,
        )
    names = ", ".join(walk.name for walk in walks)
    figures = []
    for name, factor in (("poses_ate_ratio_1pct", 1.0), ("poses_ate_ratio_3pct", 3.0)):
        ratios = {walk.name: runs[walk.name, factor].after_m / runs[walk.name, factor].before_m for walk in walks}
        worst = max(ratios, key=lambda name: ratios[name])
        of = f"{runs[worst, factor].num_poses} keyframes of {worst}, the worst of {names}"
        figures.append(figure(name, ratios[worst], "", "lower", of, role="tuned on"))
    worst_m, worst = max((runs[walk.name, 1.0].after_m, walk.name) for walk in walks)
    of = f"{worst}, the worst of {names}"
    figures.insert(1, figure("poses_ate_m_1pct", worst_m, "m", "lower", of, role="tuned on"))
    for name, value_of in (
        ("drift_recall_50_loss", lambda run: run.found_50),
        ("drift_f1_loss", lambda run: run.f1_5pct),
        ("drift_recall_50_loss_aligned", lambda run: run.found_50_aligned),
        ("drift_f1_loss_aligned", lambda run: run.f1_5pct_aligned),
    ):
        figures.append(_loss(name, exact, runs, value_of))
    tracks = {key: [count for count in run.tracks if count] for key, run in runs.items()}
    key = max(tracks, key=lambda key: np.mean(tracks[key]))
    of = f"{len(tracks[key])} true objects with a track, {key[0]} at {key[1]:g}, the worst of {len(runs)}"
    return [*figures, mean("drift_tracks_per_object", tracks[key], "", "lower", of, role="tuned on")]


def registration_figures(log: Path) -> list[Figure]:
    """Return the processor time of a keyframe's registration, and the share of a drift that it leaves in a log."""
    # The poses of the log are exact; the drift is put on them, by the default and by three times it.
    frames = list(keyframes_of(log, MapperConfig()))
    true = np.array([frame.world_from_camera for frame in frames])
    stamps_ns = [frame.stamp_ns for frame in frames]
    found, ms = [], []
    for factor in FACTORS:
        places, poses = RegistrationFilter(RegistrationConfig()), []
        drifting = list(drifted_poses(true, drift_of(factor), np.random.default_rng([1, 6])))
        for frame, pose in zip(frames, drifting, strict=True):
            started_s = time.process_time()
            placed = places.place(replace(frame, world_from_camera=pose))
            ms.append(1e3 * (time.process_time() - started_s))
            poses.append(placed.frame.world_from_camera if isinstance(placed, PlacedFrame) else places.where(pose))
        before, after = (trajectory_error(stamps_ns, np.array(p), stamps_ns, true) for p in (drifting, poses))
        found.append(after.ate_m / before.ate_m)
    of = f"{len(frames)} keyframes, {log.stem}"
    return [
        figure("register_ms", np.mean(ms[3:]), "ms", "lower", f"processor time, {of}"),
        figure("registration_ate_ratio_1pct", found[0], "", "lower", of),
        figure("registration_ate_ratio_3pct", found[1], "", "lower", of),
    ]


def _cached(folder: Path, walk: DriftingWalk, factor: float) -> Mapped:
    def measured() -> dict[str, Any]:
        print(f"{walk.name}, drift {factor:g}: minutes", flush=True)
        return asdict(_mapped(walk, factor))

    return Mapped(**cached(folder / f"{walk.name}-{walk.log.key}-{factor:g}.json", measured))


def _mapped(walk: DriftingWalk, factor: float) -> Mapped:
    started_s = time.monotonic()
    truth = load_truth(walk.log.truth)
    true = {frame.stamp_ns: frame.world_from_camera for frame in truth.frames}
    with tempfile.TemporaryDirectory() as temporary:
        out = Path(temporary) / "map"
        play_into(out, walk.open(factor), read_config(MapperConfig, None, CONFIG))
        saved, poses = keyframe_poses(out)
        graph = saved.snapshot.graph
        found = evaluate(saved, truth)
        aligned = evaluate(saved, moved_truth(truth, map_from_world(poses, true)))
    odometry = {stamp_ns: (walk.odometry[factor] if factor else true)[stamp_ns] for stamp_ns in poses}
    return Mapped(
        before_m=_ate_m(odometry, true), after_m=_ate_m(poses, true), num_poses=len(poses),
        num_loops=0 if graph is None else sum(loop.status == "accepted" for loop in graph.loops),
        num_objects=found.num_objects, found_50=[row.strict_map_id is not None for row in found.objects],
        f1_5pct=[row.f1_5pct for row in found.objects],
        found_50_aligned=[row.strict_map_id is not None for row in aligned.objects],
        f1_5pct_aligned=[row.f1_5pct for row in aligned.objects], tracks=[len(row.track_ids) for row in found.objects],
        wall_s=time.monotonic() - started_s,
    )  # fmt: skip


def _loss(
    name: str,
    exact: Mapping[str, Mapped],
    runs: Mapping[tuple[str, float], Mapped],
    value_of: Callable[[Mapped], Sequence[float]],
) -> Figure:
    losses = {
        key: np.array(value_of(exact[key[0]]), dtype=np.float64) - np.array(value_of(run), dtype=np.float64)
        for key, run in runs.items()
    }
    worst = max(losses, key=lambda key: losses[key].mean())
    of = f"{len(losses[worst])} true objects, {worst[0]} at {worst[1]:g}, the worst of {len(runs)}"
    return mean(name, losses[worst], "", "lower", of, interval_by="bootstrap over objects", role="tuned on")


def _ate_m(poses: Poses, true: Poses) -> float:
    estimated, truth = (np.array([each[stamp_ns] for stamp_ns in sorted(each)]) for each in (poses, true))
    return trajectory_error(sorted(poses), estimated, sorted(true), truth).ate_m


def map_from_world(poses: Poses, true: Poses) -> NDArray[np.float64]:
    found, there = (np.array([each[stamp_ns][:3, 3] for stamp_ns in sorted(poses)]) for each in (poses, true))
    return from_rotation_translation(*best_alignment(there, found))


def keyframe_poses(path: Path) -> tuple[SavedMap, Poses]:
    saved = open_map(path)
    places = {submap.id: submap.world_from_submap for submap in saved.snapshot.submaps}
    poses: Poses = {}
    with Journal(path) as journal:
        for entry in journal.entries():
            submap_id = entry.told.submap_id if entry.told is not None else 0
            for event in entry.events:
                if isinstance(event, FrameObserved):
                    poses[event.stamp_ns] = compose(places.get(submap_id, np.eye(4)), event.world_from_camera)
    return saved, poses
