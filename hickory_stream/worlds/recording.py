"""A synthetic recording from a seed: the log and, beside it, the truth.

Room, walk, camera and samples draw from separate generators: a longer log of a seed begins like a shorter one.
"""

import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.json_text import dumps_exactly
from hickory_stream.errors import ConfigError
from hickory_stream.evaluation.truth import (
    TRUTH_FILE,
    Truth,
    TruthChange,
    TruthFrame,
    TruthObject,
    moved_mesh,
    truth_record,
)
from hickory_stream.geometry.mesh import write_glb
from hickory_stream.geometry.rigid import invert
from hickory_stream.pictures.ray_caster import CasterName
from hickory_stream.worlds.object_models import model_mesh
from hickory_stream.worlds.recording_config import RecordingConfig
from hickory_stream.worlds.scene import World, WorldObject, placed_otherwise
from hickory_stream.worlds.shots import OCCLUDER_ID, Filming, Stage, shots_of
from hickory_stream.worlds.trajectory import STEP_S, Trajectory
from hickory_stream.worlds.visibility import SeenSurface
from hickory_stream.worlds.zed_log import encode_png

_START_NS = 1_752_400_000_000_000_000
_ODOMETRY_HZ = 30


def make_recording(
    config: RecordingConfig,
    folder: Path,
    name: str,
    progress: Callable[[int, int], None] = lambda done, total: None,
    *,
    caster: CasterName | None = "open3d",
    seen: SeenSurface | None = None,
) -> Truth:
    """Write the log's files and NAME.truth/ into a folder, replacing older ones when complete; return the truth.

    `seen` collects what several recordings of one world show. `caster` (None: the available one) changes how frames are
    rendered.

    Raises:
        ConfigError: NAME.truth exists and is no truth folder, or none of the seed's rooms can be walked through.
        InputError: the caster is not installed.
    """
    return film(config.stage(), config, folder, name, progress, caster=caster, seen=seen)


def film(
    stage: Stage,
    config: RecordingConfig,
    folder: Path,
    name: str,
    progress: Callable[[int, int], None] = lambda done, total: None,
    *,
    caster: CasterName | None = "open3d",
    seen: SeenSurface | None = None,
) -> Truth:
    """Write a recording of any world, as `make_recording` does of one from a seed; `config.scene` is not looked at.

    Raises:
        ConfigError: NAME.truth exists and is no truth folder.
        InputError: the caster is not installed.
    """
    truth_folder = folder / f"{name}.truth"
    if truth_folder.exists() and not (truth_folder / TRUTH_FILE).is_file():
        raise ConfigError(f"{truth_folder} is there and has no {TRUTH_FILE}; choose another --name or --out")
    folder.mkdir(parents=True, exist_ok=True)
    filming = Filming(sensors=config.sensors(), stage=stage, caster=caster)
    with tempfile.TemporaryDirectory(prefix=f".{name}.", dir=folder) as unfinished:
        truth = _make(config, filming, Path(unfinished), name, progress, seen)
        if truth_folder.exists():
            shutil.rmtree(truth_folder)
        truth.folder.rename(truth_folder)
        for file in config.log_files(name):
            if (folder / file).is_dir():
                shutil.rmtree(folder / file)
            (Path(unfinished) / file).replace(folder / file)
    return replace(truth, folder=truth_folder)


def _make(
    config: RecordingConfig,
    filming: Filming,
    folder: Path,
    name: str,
    progress: Callable[[int, int], None],
    seen_by_all: SeenSurface | None,
) -> Truth:
    stage = filming.stage
    world = stage.world if stage.change is None else stage.change.world
    elsewhere = () if stage.change is None else placed_otherwise(stage.world, world)
    truth_folder = folder / f"{name}.truth"
    for part in ("meshes", "instances"):
        (truth_folder / part).mkdir(parents=True)
    structure = _write_meshes(world, elsewhere, truth_folder, stage.robot_from_world)
    recorded = _record(config, filming, world, elsewhere, (folder, name, truth_folder), progress)
    if seen_by_all is not None:
        seen_by_all.include(recorded.seen)

    def true_objects(objects: Sequence[WorldObject], seen: SeenSurface) -> tuple[TruthObject, ...]:
        return tuple(
            TruthObject(
                id=item.id,
                kind=item.model.kind,
                mesh=f"meshes/{item.id}.glb",
                world_from_object=_in_frame(stage.robot_from_world, item.world_from_object),
                seen_fraction=round(seen.fraction(item.id), 4),
                frames=tuple(recorded.shown[item.id]),
            )
            for item in objects
        )

    change = None
    if stage.change is not None:
        change = TruthChange(stamp_ns=recorded.change_ns, before=true_objects(elsewhere, recorded.seen_before))
    truth = Truth(
        folder=truth_folder,
        camera=config.camera,
        objects=true_objects(world.objects, recorded.seen),
        structure=structure,
        frames=tuple(recorded.frames),
        change=change,
    )
    (truth_folder / TRUTH_FILE).write_text(dumps_exactly(truth_record(truth), indent=1) + "\n", encoding="utf-8")
    return truth


def _in_frame(robot_from_world: NDArray[np.float64] | None, world_from_a: NDArray[np.float64]) -> NDArray[np.float64]:
    # Without a frame of its own, a pose keeps its last bit.
    return world_from_a if robot_from_world is None else robot_from_world @ world_from_a


def _write_meshes(
    world: World, elsewhere: Sequence[WorldObject], truth_folder: Path, robot_from_world: NDArray[np.float64] | None
) -> tuple[str, ...]:
    for item in (*elsewhere, *world.objects):
        write_glb(model_mesh(item.model), truth_folder / f"meshes/{item.id}.glb")
    paths = [f"meshes/structure_{i}_{model.kind}.glb" for i, model in enumerate(world.structure)]
    for path, model in zip(paths, world.structure, strict=True):
        mesh = model_mesh(model)
        write_glb(mesh if robot_from_world is None else moved_mesh(mesh, robot_from_world), truth_folder / path)
    return tuple(paths)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Recorded:
    # `shown`: frames in which each object shows; `seen_before`: of what stood elsewhere before the change, or is gone.
    frames: list[TruthFrame]
    seen: SeenSurface
    seen_before: SeenSurface
    shown: dict[int, list[int]]
    change_ns: int


def _record(
    config: RecordingConfig,
    filming: Filming,
    world: World,
    elsewhere: Sequence[WorldObject],
    targets: tuple[Path, str, Path],
    progress: Callable[[int, int], None],
) -> _Recorded:
    # `world` is the one at the end; `elsewhere` are the objects that stood elsewhere before, or are gone.
    folder, name, truth_folder = targets
    stage, trajectory = filming.stage, filming.stage.trajectory
    camera = config.camera
    reach_m = (config.depth.min_depth_m, config.depth.max_depth_m)
    seen = SeenSurface(world, *reach_m, np.random.default_rng([config.seed, 4]))
    past = replace(world, objects=tuple(elsewhere))
    seen_before = SeenSurface(past, *reach_m, np.random.default_rng([config.seed, 4, 1]))
    shown: dict[int, list[int]] = {item.id: [] for item in (*elsewhere, *world.objects)}
    frames: list[TruthFrame] = []
    stamps_ns, every = _stamps_ns(config, float(trajectory.times_s[-1]), stage.clock_offset_ns)
    odometry = stage.odometry or trajectory
    times_s = [(stamp_ns - stamps_ns[0]) / 1e9 for stamp_ns in stamps_ns]
    changes_at_s = np.inf if stage.change is None else stage.change.at_s
    change_ns = next((stamp for stamp, time_s in zip(stamps_ns, times_s, strict=True) if time_s >= changes_at_s), 0)
    with config.open_log(folder, name, stamps_ns[-1]) as log:
        log.write_static(stamps_ns[0])
        shots = shots_of(replace(filming, view=log.depth_view), times_s[::every])
        for i, (stamp_ns, time_s) in enumerate(zip(stamps_ns, times_s, strict=True)):
            estimated = _in_frame(stage.robot_from_world, odometry.pose_at(time_s))
            log.write_pose(stamp_ns, estimated, _velocity(odometry, time_s))
            if i % every:
                continue
            index = i // every
            shot, world_from_camera = next(shots), trajectory.pose_at(time_s)
            seen.add(shot.exact_depth_m, shot.instances, camera, world_from_camera)
            if time_s < changes_at_s:
                seen_before.add(shot.exact_depth_m, shot.instances, camera, world_from_camera)
            for item_id in np.setdiff1d(shot.instances, (0, OCCLUDER_ID)):
                shown[int(item_id)].append(index)
            log.write_images(stamp_ns, shot.rgb, shot.depth_m)
            frame = TruthFrame(
                index=index,
                stamp_ns=stamp_ns,
                world_from_camera=_in_frame(stage.robot_from_world, world_from_camera),
                instances=f"instances/{index:06d}.png",
            )
            (truth_folder / frame.instances).write_bytes(encode_png(shot.instances))
            frames.append(frame)
            progress(index + 1, len(times_s[::every]))
    return _Recorded(frames=frames, seen=seen, seen_before=seen_before, shown=shown, change_ns=change_ns)


def _stamps_ns(config: RecordingConfig, walk_s: float, clock_offset_ns: int) -> tuple[list[int], int]:
    seconds = walk_s - 2 * STEP_S if config.seconds is None else config.seconds
    every = max(1, int(np.ceil(_ODOMETRY_HZ / config.rate_hz)))
    num_frames = int(np.floor(seconds * config.rate_hz + 1e-9))
    num_grabs = (num_frames - 1) * every + 1
    start_ns = _START_NS + 1_000_003 * config.seed + clock_offset_ns
    return [start_ns + round(i * 1e9 / (config.rate_hz * every)) for i in range(num_grabs)], every


def _velocity(trajectory: Trajectory, time_s: float) -> NDArray[np.float64]:
    # (6,) linear and angular velocity of the camera, in the body's frame (x forward, z up).
    step_s = 0.01
    world_from_now, world_from_next = trajectory.pose_at(time_s), trajectory.pose_at(time_s + step_s)
    now_from_next = invert(world_from_now) @ world_from_next
    skew = (now_from_next[:3, :3] - now_from_next[:3, :3].T) / (2 * step_s)
    linear, angular = now_from_next[:3, 3] / step_s, np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
    return np.concatenate([[v[2], -v[0], -v[1]] for v in (linear, angular)])
