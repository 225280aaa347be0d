"""The logs of the data sets below a folder, whether real or written by us."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hickory_stream.errors import RecordingError
from hickory_stream.worlds.recording import film
from hickory_stream.worlds.shots import Stage
from hickory_stream.worlds.trajectory import NoWalk
from tools.paper_tables import replica_cad
from tools.paper_tables.data_sets import HOPE, KIMERA_MULTI, NUS_CLB, REPLICA_CAD
from tools.paper_tables.workshop import Log, Plan, Workshop
from tools.worlds.clutter.walk import wander_through
from tools.worlds.recording_config import RecordingConfig
from tools.worlds.routes import clearance_of_surfaces

_ATTEMPTS, _WALK_SECONDS = 20, 90.0
# Where the camera sits on the quadruped was not published: it is estimated from each log.
_QUADRUPED = ("--extrinsics", "estimate")


@dataclass(frozen=True, kw_only=True, slots=True)
class Pair:
    """Two logs of one place; `truths` say where each log's frame is in one that both share."""

    logs: tuple[Log, Log]
    truths: tuple[Path, Path]

    @property
    def data_set(self) -> str:
        return self.logs[0].data_set

    @property
    def scene(self) -> str:
        return self.logs[0].scene


def logs_of(name: str, data: Path, plan: Plan, shop: Workshop) -> list[tuple[Log, Path]]:
    """Return the logs of a data set with their truths."""
    if name == HOPE.name:
        return [(log, log.files[0]) for log in hope_logs(data, plan)]
    if name == REPLICA_CAD.name:
        pairs = apartment_pairs(data, plan, shop)
    else:
        pairs = kimera_pairs(data, plan) if name == KIMERA_MULTI.name else nus_pairs(data, plan)
    return [found for pair in pairs for found in zip(pair.logs, pair.truths, strict=True)]


def hope_logs(data: Path, plan: Plan) -> list[Log]:
    root = HOPE.folder(data)
    folders = [] if root is None else sorted(folder for folder in root.glob("hope_video/scene_*") if folder.is_dir())
    return [Log(HOPE.name, folder.name, "all", files=(folder,)) for folder in folders[: plan.hope_scenes]]


def apartment_pairs(data: Path, plan: Plan, shop: Workshop) -> list[Pair]:
    """Return two walks through each of the first apartments of ReplicaCAD, rendered by our own renderer, once."""
    # Raises RecordingError: a file of an apartment is missing or damaged, or nobody can walk through it.
    root = REPLICA_CAD.folder(data)
    names = [] if root is None else replica_cad.scene_names(root)[: plan.apartments]
    pairs = []
    for name in names:
        assert root is not None
        logs, truths = [], []
        for walk in (0, 1):
            label = f"{name}-walk{walk}"
            target = shop.folder / "data" / f"{label}.mcap"
            if not target.is_file():
                shop.told(f"rendering {label}")
                _render(root, name, walk, plan, target)
            logs.append(Log(REPLICA_CAD.name, name, f"walk{walk}", files=(target,)))
            truths.append(target.with_suffix(".truth"))
        pairs.append(Pair(logs=(logs[0], logs[1]), truths=(truths[0], truths[1])))
    return pairs


def kimera_pairs(data: Path, plan: Plan) -> list[Pair]:
    """Return pairs of robots with bag, odometry and ground truth in one folder: the first two of each."""
    root = KIMERA_MULTI.folder(data)
    folders = sorted({file.parent for file in root.rglob("*_gt_odom.csv")}) if root is not None else []
    pairs = []
    for folder in folders:
        robots = [file.name.removesuffix("_gt_odom.csv") for file in sorted(folder.glob("*_gt_odom.csv"))]
        logs = [(name, log) for name in robots if (log := _robot_log(folder, name)) is not None]
        if len(logs) >= 2:
            truths = [folder / f"{name}_gt_odom.csv" for name, _ in logs]
            pairs.append(Pair(logs=(logs[0][1], logs[1][1]), truths=(truths[0], truths[1])))
    return pairs[: plan.robot_pairs]


def nus_pairs(data: Path, plan: Plan) -> list[Pair]:
    """Return pairs of runs with true poses in one folder, the first two of each."""
    root = NUS_CLB.folder(data)
    folders = [] if root is None else sorted({file.parent for file in root.rglob("*.tum")})
    pairs = []
    for folder in folders:
        runs = [file for file in sorted(folder.glob("*.tum")) if file.with_suffix("").is_dir()]
        if len(runs) >= 2:
            logs = [
                Log(NUS_CLB.name, folder.name, run.stem, files=(run.with_suffix(""),), arguments=_QUADRUPED)
                for run in runs[:2]
            ]
            pairs.append(Pair(logs=(logs[0], logs[1]), truths=(runs[0], runs[1])))
    return pairs[: plan.nus_pairs]


def _robot_log(folder: Path, robot: str) -> Log | None:
    bags = [file for file in sorted(folder.glob(f"*{robot}.bag")) if file.stem in (robot, *_dated(file.stem, robot))]
    odometry = folder / f"{robot}_vio.bag"
    if not bags or not odometry.is_file():
        return None
    return Log(KIMERA_MULTI.name, folder.name, robot, files=(bags[0], odometry))


def _dated(stem: str, robot: str) -> tuple[str, ...]:
    date = stem.removesuffix(f"_{robot}").replace("_", "")
    return (stem,) if stem.endswith(f"_{robot}") and date.isdigit() else ()


def _render(root: Path, name: str, walk: int, plan: Plan, target: Path) -> None:
    world = replica_cad.read_apartment(root, name)
    clearance = clearance_of_surfaces(world)
    seconds = plan.apartment_seconds or _WALK_SECONDS
    config = RecordingConfig(seed=0, walk_index=walk, seconds=seconds, width=640, height=480)
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng([11, walk, attempt])
        trajectory = wander_through(world, clearance, seconds, config.walk, rng)
        if not isinstance(trajectory, NoWalk):
            film(Stage(world=world, trajectory=trajectory), config, target.parent, target.stem)
            return
    raise RecordingError(
        f"{root}: nobody can walk through {name}: expected free floor with {config.walk.clearance_m} m around"
    )
