"""A synthetic recording from a seed: the log and, beside it, the truth.

Room, walk, camera and samples draw from separate generators, so that a longer log of a seed begins like a shorter one,
and another camera sees the same room.
"""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.errors import ConfigError
from hickory_stream.evaluation.truth import TRUTH_FILE, Truth, TruthFrame, TruthObject, moved_mesh, truth_record
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.mesh import write_glb
from hickory_stream.geometry.rigid import from_rotation_translation, invert, yaw_rotation
from hickory_stream.json_text import dumps_exactly
from hickory_stream.worlds.building.building import BuildingSize, building
from hickory_stream.worlds.building.walk import building_walk
from hickory_stream.worlds.clutter.families import recipes_of
from hickory_stream.worlds.clutter.room import clutter_room
from hickory_stream.worlds.clutter.walk import wander
from hickory_stream.worlds.days import world_of_day
from hickory_stream.worlds.depth_camera import DepthCameraConfig
from hickory_stream.worlds.drift import DriftConfig, drifted
from hickory_stream.worlds.layouts import LAYOUTS, drawn_mounting, layout_camera, layout_files, open_layout
from hickory_stream.worlds.object_models import model_mesh
from hickory_stream.worlds.orbit import orbit
from hickory_stream.worlds.outdoor.street import street
from hickory_stream.worlds.outdoor.walk import stroll
from hickory_stream.worlds.person import PERSON_ID, Person
from hickory_stream.worlds.scenes import BUILDING, CLUTTER, OUTDOOR, SCENES, make_world
from hickory_stream.worlds.shots import Filming, Sensors, shots_of
from hickory_stream.worlds.tour import tour
from hickory_stream.worlds.trajectory import STEP_S, NoWalk, Trajectory, walk_round
from hickory_stream.worlds.visibility import SeenSurface
from hickory_stream.worlds.walk_config import WalkConfig
from hickory_stream.worlds.zed_log import encode_png

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from hickory_stream.evaluation.ray_caster import CasterName
    from hickory_stream.worlds.color_camera import ColorCameraConfig
    from hickory_stream.worlds.scene import World

_START_NS = 1_752_400_000_000_000_000
_ODOMETRY_HZ = 30
_WORLDS = 20
MAX_ROBOTS = 16
# Where robots of a fleet start by their own reckoning, and by how much their clocks differ.
_FRAME_REACH_M, _CLOCK_REACH_NS = 8.0, 3_600_000_000_000
_LEAST_CLUTTER = 6


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordingConfig:
    """The config of a recording; the same config gives the same bytes."""

    scene: str = "room"
    """One of `worlds.scenes.SCENES`."""
    family: str = "training"
    """The family of recipes of a random room (scene `clutter`): one of `worlds.clutter.families.FAMILIES`."""
    seed: int = 7
    walk_index: int = 0
    """Which of the walks through the scene; a room has one for each seed."""
    seconds: float | None = 20.0
    """None: as long as the walk through the scene takes, a minute or more."""
    rate_hz: float = 6.0
    width: int = 640
    height: int = 360
    horizontal_fov_deg: float = 80.0
    color_noise: float = 1.0
    """Standard deviation of the colour noise, in grey levels."""
    jpeg_quality: int = 80
    layout: str = "zed"
    """One of `worlds.layouts.LAYOUTS`: the container, the topics, the frames and the quirks of a data set."""
    robots: int = 0
    """Of how many robots of a fleet this is one, the one on walk `walk_index`; 0: it is alone.

    A robot of a fleet has a frame and a clock of its own, and its truth is in its frame (`worlds.fleet`).
    """
    camera_offset: bool = False
    """Whether the seed draws the camera's pose on the body of a NUS-CLB robot, 0.4 m and 10 degrees off."""
    drift: DriftConfig | None = None
    """The drift of odometry; None: exact poses."""
    building: BuildingSize | None = None
    """How large a building is; None: two floors and twelve rooms."""
    day: int = 0
    """How many days the things in the world have been moved, removed and added since it was made (`worlds.days`)."""
    person: bool = False
    """Whether a person walks through the scene."""
    color: ColorCameraConfig | None = None
    """The defects of the colour camera in addition to `color_noise`; None: no others."""
    walk: WalkConfig = field(default_factory=WalkConfig)
    depth: DepthCameraConfig = field(default_factory=DepthCameraConfig)

    def __post_init__(self) -> None:
        seconds = 60.0 if self.seconds is None else self.seconds
        if not (seconds > 0 and 0 < self.rate_hz <= 120 and seconds * self.rate_hz >= 1):
            raise ConfigError(
                f"{self.seconds} s at {self.rate_hz} Hz; expected a positive time and a rate of up to 120 Hz "
                "that give at least one frame"
            )
        if not (32 <= self.width <= 4096 and 32 <= self.height <= 4096):
            raise ConfigError(f"images of {self.width}x{self.height}; expected 32 to 4096 pixels a side")
        if self.seed < 0 or self.walk_index < 0:
            raise ConfigError(f"seed {self.seed}, walk {self.walk_index}; expected 0 or more")
        if self.day < 0 or (self.day and self.scene in (BUILDING, CLUTTER, OUTDOOR)):
            raise ConfigError(f"day {self.day} in the scene {self.scene}; expected 0 or more, above 0 in rooms only")
        if self.scene not in SCENES:
            raise ConfigError(f"scene {self.scene!r}; expected one of {', '.join(SCENES)}")
        if self.robots and (not self.walk_index < self.robots <= MAX_ROBOTS or self.scene == CLUTTER):
            raise ConfigError(
                f"robot {self.walk_index} of {self.robots} in the scene {self.scene}; expected up to {MAX_ROBOTS} "
                f"robots, of which it is one, in any scene but {CLUTTER}"
            )
        recipes_of(self.family)
        if self.layout not in LAYOUTS:
            raise ConfigError(f"layout {self.layout!r}; expected one of {', '.join(LAYOUTS)}")

    @property
    def is_by_frame(self) -> bool:
        """Whether each frame draws its noise for itself, so that frames can be made in any order."""
        return self.scene == BUILDING

    @property
    def camera(self) -> Camera:
        """The pinhole camera of both images."""
        focal_px = self.width / 2 / np.tan(np.radians(self.horizontal_fov_deg) / 2)
        camera = Camera(
            width=self.width,
            height=self.height,
            fx=float(focal_px),
            fy=float(focal_px),
            cx=(self.width - 1) / 2,
            cy=(self.height - 1) / 2,
        )
        return layout_camera(self.layout, camera)


def make_recording(
    config: RecordingConfig,
    folder: Path,
    name: str,
    progress: Callable[[int, int], None] = lambda done, total: None,
    *,
    caster: CasterName | None = "open3d",
    seen: SeenSurface | None = None,
    processes: int = 1,
) -> Truth:
    """Write NAME.mcap (or the layout's files) and NAME.truth/ into a folder, replacing older ones; return the truth.

    `seen` collects what several recordings of one world show. `processes` render frames at the same time, which needs a
    scene whose frames can be made in any order; they do not change a byte.

    Both are made in a hidden folder beside their destination and moved when complete, so that a failure leaves the old
    ones. The same `caster` gives the same bytes; None takes the available one (`ray_caster`).

    Raises:
        ConfigError: NAME.truth exists and is no truth folder, none of the seed's rooms can be walked through, or there
            are several processes for a scene whose frames draw their noise one after the other.
        InputError: the caster is not installed.
    """
    if processes < 1 or (processes > 1 and not config.is_by_frame):
        raise ConfigError(
            f"{processes} processes for the scene {config.scene}; expected 1: only the frames of a {BUILDING} "
            "can be made side by side"
        )
    world, trajectory = walkable_world(config)
    return film_world(world, trajectory, config, folder, name, progress, caster=caster, seen=seen, processes=processes)


def film_world(
    world: World,
    trajectory: Trajectory,
    config: RecordingConfig,
    folder: Path,
    name: str,
    progress: Callable[[int, int], None] = lambda done, total: None,
    *,
    caster: CasterName | None = "open3d",
    seen: SeenSurface | None = None,
    processes: int = 1,
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
    filming = Filming(
        sensors=sensors_of(config), world=world, trajectory=trajectory, caster=caster, person=_person(world, config)
    )
    with tempfile.TemporaryDirectory(prefix=f".{name}.", dir=folder) as unfinished:
        truth = _make(config, filming, Path(unfinished), name, progress, seen, processes)
        if truth_folder.exists():
            shutil.rmtree(truth_folder)
        truth.folder.rename(truth_folder)
        for file in layout_files(config.layout, name):
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
    processes: int,
) -> Truth:
    world = filming.world
    truth_folder = folder / f"{name}.truth"
    for part in ("meshes", "instances"):
        (truth_folder / part).mkdir(parents=True)
    robot_from_world = drawn_frame(config)
    structure = _write_meshes(world, truth_folder, robot_from_world)
    frames, seen, shown = _record(config, filming, (folder, name, truth_folder), progress, processes)
    if seen_by_all is not None:
        seen_by_all.include(seen)
    truth = Truth(
        folder=truth_folder,
        camera=config.camera,
        objects=tuple(
            TruthObject(
                id=item.id,
                kind=item.model.kind,
                mesh=f"meshes/{item.id}.glb",
                world_from_object=_in_frame(robot_from_world, item.world_from_object),
                seen_fraction=round(seen.fraction(item.id), 4),
                frames=tuple(shown[item.id]),
            )
            for item in world.objects
        ),
        structure=structure,
        frames=tuple(frames),
    )
    (truth_folder / TRUTH_FILE).write_text(dumps_exactly(truth_record(truth), indent=1) + "\n", encoding="utf-8")
    return truth


def walkable_world(config: RecordingConfig) -> tuple[World, Trajectory]:
    """Return the first of the seed's worlds that one can walk through, and the walk.

    Both of the first two walks, and those of all robots of a fleet, must be possible, so that they share one world.

    Raises:
        ConfigError: none of the seed's worlds can be walked.
    """
    if config.scene == CLUTTER:
        return _walkable_clutter(config)
    if config.scene == OUTDOOR:
        return _walkable_street(config)
    if config.scene == BUILDING:
        return _walkable_building(config)
    for attempt in range(_WORLDS):
        world = make_world(config.scene, config.seed, attempt)
        trajectory = _walk(world, config, config.walk_index)
        others = set(range(config.robots)) | ({0, 1} if config.scene == "apartment" else set())
        others -= {config.walk_index}
        if not isinstance(trajectory, NoWalk) and not any(isinstance(_walk(world, config, i), NoWalk) for i in others):
            return _on_its_day(world, trajectory, config)
    raise _not_walkable(config)


def _on_its_day(world: World, trajectory: Trajectory, config: RecordingConfig) -> tuple[World, Trajectory]:
    """Return the world and the walk through it on the day of a recording; on day 0 as they are."""
    if not config.day:
        return world, trajectory

    def walk(changed: World) -> Trajectory | NoWalk:
        return _walk(changed, config, config.walk_index)

    today = world_of_day(world, config.seed, config.day, lambda changed: not isinstance(walk(changed), NoWalk))
    found = walk(today)
    assert not isinstance(found, NoWalk)
    return today, found


def drawn_frame(config: RecordingConfig) -> NDArray[np.float64] | None:
    """Return robot_from_world (4, 4), level: where a robot of a fleet starts by its own reckoning; None: alone."""
    if not config.robots:
        return None
    rng = np.random.default_rng([config.seed, 8, config.walk_index])
    shift_m = rng.uniform(-_FRAME_REACH_M, _FRAME_REACH_M, 3) * (1.0, 1.0, 0.1)
    return from_rotation_translation(yaw_rotation(float(rng.uniform(0.0, 2 * np.pi))), shift_m)


def _in_frame(robot_from_world: NDArray[np.float64] | None, world_from_a: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a pose in a robot's frame; where it has none of its own, as it is, to the last bit."""
    return world_from_a if robot_from_world is None else robot_from_world @ world_from_a


def _not_walkable(config: RecordingConfig) -> ConfigError:
    return ConfigError(
        f"seed {config.seed}: none of {_WORLDS} worlds leaves {config.walk.clearance_m} m to walk; "
        "choose another --seed"
    )


def _walkable_clutter(config: RecordingConfig) -> tuple[World, Trajectory]:
    """Return the first of the seed's random rooms that has objects and a walk, and the walk."""
    for attempt in range(_WORLDS):
        room = clutter_room(config.seed, config.family, attempt)
        if len(room.world.objects) >= _LEAST_CLUTTER:
            rng = np.random.default_rng([config.seed, 2, config.walk_index])
            trajectory = wander(room, 60.0 if config.seconds is None else config.seconds, config.walk, rng)
            if not isinstance(trajectory, NoWalk):
                return room.world, trajectory
    raise _not_walkable(config)


def _walkable_street(config: RecordingConfig) -> tuple[World, Trajectory]:
    """Return the first of the seed's streets with a closed route for all robots of a fleet, and the walk."""
    for attempt in range(_WORLDS):
        found = street(config.seed, attempt)
        walks = {i: stroll(found, config.seconds, config.walk, i) for i in {*range(config.robots), config.walk_index}}
        trajectory = walks[config.walk_index]
        if not isinstance(trajectory, NoWalk) and not any(isinstance(walk, NoWalk) for walk in walks.values()):
            return found.world, trajectory
    raise _not_walkable(config)


def _walkable_building(config: RecordingConfig) -> tuple[World, Trajectory]:
    """Return the first of the seed's buildings that one can walk through, and the walk; all walks visit all rooms."""
    for attempt in range(_WORLDS):
        house = building(config.seed, config.building or BuildingSize(), attempt)
        rng = np.random.default_rng([config.seed, 2, config.walk_index])
        trajectory = building_walk(house, config.seconds, config.walk, config.walk_index, rng)
        if not isinstance(trajectory, NoWalk):
            return house.world, trajectory
    raise _not_walkable(config)


def _walk(world: World, config: RecordingConfig, walk_index: int) -> Trajectory | NoWalk:
    rng = np.random.default_rng([config.seed, 2, walk_index] if walk_index else [config.seed, 2])
    if config.scene == "apartment":
        return tour(world, config.seconds, config.walk, walk_index)
    if config.scene == "tabletop":
        return orbit(world, config.seconds, walk_index, rng)
    return walk_round(world, 60.0 if config.seconds is None else config.seconds, config.walk, rng)


def _person(world: World, config: RecordingConfig) -> Person | None:
    """Return the person of a config: on another walk through the same world, faster than the camera.

    Random rooms, streets and buildings have no person.
    """
    if not config.person or config.scene in (CLUTTER, OUTDOOR, BUILDING):
        return None
    faster = replace(config.walk, speed_mps=2 * config.walk.speed_mps)
    if config.scene == "tabletop":
        track: Trajectory | NoWalk = orbit(world, config.seconds, config.walk_index + 1, np.random.default_rng(0))
    elif config.scene == "apartment":
        track = tour(world, config.seconds, faster, config.walk_index + 1)
    else:
        seconds = 60.0 if config.seconds is None else config.seconds
        track = walk_round(world, seconds, faster, np.random.default_rng([config.seed, 5]))
    return None if isinstance(track, NoWalk) else Person(track=track, ahead_s=3.0)


def _write_meshes(world: World, truth_folder: Path, robot_from_world: NDArray[np.float64] | None) -> tuple[str, ...]:
    """Write every mesh and return the paths of the structure's, which are in the frame of the poses."""
    for item in world.objects:
        write_glb(model_mesh(item.model), truth_folder / f"meshes/{item.id}.glb")
    paths = [f"meshes/structure_{i}_{model.kind}.glb" for i, model in enumerate(world.structure)]
    for path, model in zip(paths, world.structure, strict=True):
        mesh = model_mesh(model)
        write_glb(mesh if robot_from_world is None else moved_mesh(mesh, robot_from_world), truth_folder / path)
    return tuple(paths)


def sensors_of(config: RecordingConfig) -> Sensors:
    """Return the cameras of a recording."""
    return Sensors(
        camera=config.camera,
        color_noise=config.color_noise,
        color=config.color,
        depth=config.depth,
        seeds=(config.seed, 3, config.walk_index) if config.walk_index or config.is_by_frame else (config.seed, 3),
        is_by_frame=config.is_by_frame,
    )


def _record(
    config: RecordingConfig,
    filming: Filming,
    targets: tuple[Path, str, Path],
    progress: Callable[[int, int], None],
    processes: int,
) -> tuple[list[TruthFrame], SeenSurface, dict[int, list[int]]]:
    """Render and write frame by frame; return the true frames, what was seen, and where each object shows."""
    folder, name, truth_folder = targets
    world, trajectory = filming.world, filming.trajectory
    camera = config.camera
    seen = SeenSurface(
        world, config.depth.min_depth_m, config.depth.max_depth_m, np.random.default_rng([config.seed, 4])
    )
    shown: dict[int, list[int]] = {item.id: [] for item in world.objects}
    frames: list[TruthFrame] = []
    stamps_ns, every = _stamps_ns(config, float(trajectory.times_s[-1]))
    odometry = trajectory
    if config.drift is not None:
        odometry = drifted(trajectory, config.drift, np.random.default_rng([config.seed, 6, config.walk_index]))
    times_s = [(stamp_ns - stamps_ns[0]) / 1e9 for stamp_ns in stamps_ns]
    robot_from_world = drawn_frame(config)
    mounting = drawn_mounting(config.seed) if config.camera_offset else None
    with open_layout(config.layout, folder, name, camera, config.jpeg_quality, stamps_ns[-1], mounting) as log:
        log.write_static(stamps_ns[0])
        shots = shots_of(replace(filming, view=log.depth_view), times_s[::every], processes)
        for i, (stamp_ns, time_s) in enumerate(zip(stamps_ns, times_s, strict=True)):
            estimated = _in_frame(robot_from_world, odometry.pose_at(time_s))
            log.write_pose(stamp_ns, estimated, _velocity(odometry, time_s))
            if i % every:
                continue
            index = i // every
            shot, world_from_camera = next(shots), trajectory.pose_at(time_s)
            seen.add(shot.exact_depth_m, shot.instances, camera, world_from_camera)
            for item_id in np.setdiff1d(shot.instances, (0, PERSON_ID)):
                shown[int(item_id)].append(index)
            log.write_images(stamp_ns, shot.rgb, shot.depth_m)
            frame = TruthFrame(
                index=index,
                stamp_ns=stamp_ns,
                world_from_camera=_in_frame(robot_from_world, world_from_camera),
                instances=f"instances/{index:06d}.png",
            )
            (truth_folder / frame.instances).write_bytes(encode_png(shot.instances))
            frames.append(frame)
            progress(index + 1, len(times_s[::every]))
    return frames, seen, shown


def _stamps_ns(config: RecordingConfig, walk_s: float) -> tuple[list[int], int]:
    """Return the stamps of all grabs, and the number of grabs per image."""
    seconds = walk_s - 2 * STEP_S if config.seconds is None else config.seconds
    every = max(1, int(np.ceil(_ODOMETRY_HZ / config.rate_hz)))
    num_frames = int(np.floor(seconds * config.rate_hz + 1e-9))
    num_grabs = (num_frames - 1) * every + 1
    start_ns = _START_NS + 1_000_003 * config.seed
    if config.robots:
        rng = np.random.default_rng([config.seed, 9, config.walk_index])
        start_ns += int(rng.integers(-_CLOCK_REACH_NS, _CLOCK_REACH_NS))
    return [start_ns + round(i * 1e9 / (config.rate_hz * every)) for i in range(num_grabs)], every


def _velocity(trajectory: Trajectory, time_s: float) -> NDArray[np.float64]:
    """Return the (6,) linear and angular velocity of the camera at a time, in the body's frame (x forward, z up)."""
    step_s = 0.01
    world_from_now, world_from_next = trajectory.pose_at(time_s), trajectory.pose_at(time_s + step_s)
    now_from_next = invert(world_from_now) @ world_from_next
    skew = (now_from_next[:3, :3] - now_from_next[:3, :3].T) / (2 * step_s)
    linear, angular = now_from_next[:3, 3] / step_s, np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
    return np.concatenate([[v[2], -v[0], -v[1]] for v in (linear, angular)])
