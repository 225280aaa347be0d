"""A synthetic fleet: several robots in one world, each with a walk, a log, a frame and a clock of its own."""
# Truths share object ids: where two frames lie follows from any object that both have.

import shutil
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from hickory_stream.base.json_text import dumps_exactly, toml_string
from hickory_stream.errors import ConfigError
from hickory_stream.evaluation.truth import TRUTH_FILE, Truth, truth_record
from hickory_stream.pictures.ray_caster import CasterName
from hickory_stream.worlds.recording import make_recording
from hickory_stream.worlds.visibility import SeenSurface
from tools.worlds.recording_config import MAX_ROBOTS, RecordingConfig, walkable_world


def robot_name(name: str, robot: int) -> str:
    return f"{name}-{robot + 1}"


def make_fleet(
    config: RecordingConfig, folder: Path, name: str, num_robots: int,
    progress: Callable[[int, int], None] = lambda done, total: None, *, caster: CasterName | None = "open3d",
) -> Truth:  # fmt: skip
    """Write NAME-1, NAME-2, ... with truths, NAME.truth of all in the first frame, and NAME.toml; return that truth."""
    # Robot i goes on walk i; `progress` counts each robot's frames.
    # Raises ConfigError: too many robots or too few, or no world of the seed can be walked by all of them.
    # Raises InputError: the caster is not installed.
    if not 2 <= num_robots <= MAX_ROBOTS:
        raise ConfigError(f"found {num_robots} robots, expected 2 to {MAX_ROBOTS}")
    configs = [replace(config, walk_index=i, robots=num_robots) for i in range(num_robots)]
    world, _ = walkable_world(configs[0])
    seen = SeenSurface(
        world, config.depth.min_depth_m, config.depth.max_depth_m, np.random.default_rng([config.seed, 4])
    )
    truths = [
        make_recording(one, folder, robot_name(name, i), progress, caster=caster, seen=seen)
        for i, one in enumerate(configs)
    ]
    truth = _truth_of_all(truths[0], folder / f"{name}.truth", seen)
    (folder / f"{name}.toml").write_text(_fleet_file(name, num_robots, config), encoding="utf-8")
    return truth


def _truth_of_all(first: Truth, target: Path, seen: SeenSurface) -> Truth:
    truth = replace(
        first,
        folder=target,
        objects=tuple(replace(item, seen_fraction=round(seen.fraction(item.id), 4)) for item in first.objects),
    )
    with tempfile.TemporaryDirectory(prefix=f".{target.name}.", dir=target.parent) as unfinished:
        made = Path(unfinished) / target.name
        shutil.copytree(first.folder, made)
        (made / TRUTH_FILE).write_text(dumps_exactly(truth_record(truth), indent=1) + "\n", encoding="utf-8")
        if target.exists():
            shutil.rmtree(target)
        made.rename(target)
    return truth


def _fleet_file(name: str, num_robots: int, config: RecordingConfig) -> str:
    robots = [
        f"[[robot]]\nname = {toml_string(f'robot-{i + 1}')}\nlog = [{', '.join(map(toml_string, files))}]\n"
        for i in range(num_robots)
        for files in [config.log_files(robot_name(name, i))]
    ]
    return "\n".join(robots)
