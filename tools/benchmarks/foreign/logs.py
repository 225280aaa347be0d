"""The logs of the gate: rooms by others, rendered once by the program that comes with them, and worlds of ours."""
# The folder of worlds is no part of the project: --worlds or $HICKORY_WORLDS names it, else it is `../shared/worlds`
# beside the checkout. Logs are kept with the other recordings ($HICKORY_CACHE), 80 to 100 MB each.

import hashlib
import json
import os
import runpy
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hickory_stream.base import caches
from hickory_stream.base.json_text import dumps_exactly
from hickory_stream.errors import RecordingError
from hickory_stream.evaluation.truth import TRUTH_FILE, load_truth
from hickory_stream.geometry.camera import backproject
from hickory_stream.geometry.rigid import from_rotation_translation, interpolate, invert, yaw_rotation
from hickory_stream.pictures.open3d_import import import_open3d
from players import open_source
from tools.benchmarks.common.processes import ROOT, output_of
from tools.worlds.cache import cache_folder, cached_recording
from tools.worlds.drift import DriftConfig, drifted_poses
from tools.worlds.layouts import KimeraMultiLog, layout_files
from tools.worlds.outdoor.walk import outdoors
from tools.worlds.recording_config import RecordingConfig

PROGRAM = "make_world_log.py"
_RATE_HZ = 5.0
_HEIGHT_M = {"hand": 1.4, "robot": 0.45}
BACK = "-back"
_FOLDERS = {"office": "service-office"}
_OPTIONS = {"campus": ["--camera", "d455", "--speed", "0.8"]}
# The program imports Open3D, which needs a library that the project provides.
_RUN = (
    "import runpy, sys; from hickory_stream.pictures.open3d_import import import_open3d; import_open3d(); "
    "sys.argv = sys.argv[1:]; runpy.run_path(sys.argv[0], run_name='__main__')"
)


@dataclass(frozen=True, kw_only=True, slots=True)
class WorldLog:
    """A log with its truth folder, a hash of its sources, and what is played together with it."""

    log: Path
    truth: Path
    key: str
    beside: tuple[Path, ...] = ()


def worlds_folder(named: Path | None) -> Path:
    """Return the folder of worlds."""
    # Raises RecordingError: there is none.
    folder = named or Path(os.environ.get("HICKORY_WORLDS") or ROOT.parent / "shared" / "worlds")
    if not (folder / PROGRAM).is_file():
        raise RecordingError(f"{folder} holds no {PROGRAM}; name the folder of worlds with --worlds or HICKORY_WORLDS")
    return folder.resolve()


def foreign_log(
    worlds: Path, world: str, walk: str, camera: str, seconds: float = 60.0, *, rate_hz: float = _RATE_HZ
) -> WorldLog:
    """Return the log of a walk with exact poses, rendered if it is not cached; `camera` is `hand` or `robot`.

    A walk such as `A-back` visits the places of walk A in the other direction.
    """
    # Raises RecordingError: there is no such world, or it cannot be rendered.
    source = worlds / _FOLDERS.get(world, world)
    arguments = ["--trajectory", walk, "--seconds", f"{seconds:g}", "--hz", f"{rate_hz:g}"]
    arguments += ["--camera-height", f"{_HEIGHT_M[camera]:g}", *_OPTIONS.get(world, [])]
    try:
        made_from = (worlds / PROGRAM).read_bytes() + (source / "world.json").read_bytes()
    except OSError as error:
        raise RecordingError(f"{source} is no world: {error.strerror} ({error.filename})") from error
    key = hashlib.sha256(made_from + " ".join(arguments).encode()).hexdigest()[:10]
    folder = cache_folder() / f"foreign-{world}-{walk}-{camera}-{key}"
    found = WorldLog(log=folder / "log.mcap", truth=folder / "truth", key=key)
    if found.log.is_file() and (found.truth / TRUTH_FILE).is_file():
        caches.mark_used(folder)
        return found
    print(f"rendering {world}, walk {walk}, {camera}: minutes, once", flush=True)
    with _made_whole(folder) as made, _with_walk(source, walk) as world_folder:
        try:
            output_of("-c", _RUN, worlds / PROGRAM, world_folder, made, *arguments)
        except RuntimeError as error:
            raise RecordingError(f"{PROGRAM} could not render {source}: {error}") from error
    return found


@contextmanager
def _with_walk(source: Path, walk: str) -> Iterator[Path]:
    # The folder of a world, or one that has its meshes and the walk back.
    if not walk.endswith(BACK):
        yield source
        return
    world = json.loads((source / "world.json").read_text(encoding="utf-8"))
    forth = world["walks"][walk.removesuffix(BACK)]
    first, *others = forth["points"]
    world["walks"][walk] = {**forth, "points": [first, *reversed(others)]}
    with tempfile.TemporaryDirectory() as temporary:
        for entry in source.iterdir():
            if entry.name != "world.json":
                (Path(temporary) / entry.name).symlink_to(entry)
        (Path(temporary) / "world.json").write_text(dumps_exactly(world), encoding="utf-8")
        yield Path(temporary)


@contextmanager
def _made_whole(folder: Path) -> Iterator[Path]:
    # An empty folder to fill, which becomes `folder` at the end, or is removed if that is not reached.
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=".rendering-") as temporary:
        made = Path(temporary) / "made"
        made.mkdir()
        yield made
        shutil.rmtree(folder, ignore_errors=True)
        made.rename(folder)
    caches.prune()


def world_program(worlds: Path) -> dict[str, Any]:
    """Return the names that the program of the worlds defines."""
    import_open3d()  # as the program needs it
    return runpy.run_path(str(worlds / PROGRAM))


def jackal_log(worlds: Path, world: str) -> WorldLog:
    """Return walk A of the robot as a Jackal of Kimera-Multi records it: at 15 Hz, odometry drifts by a percent."""
    # Raises RecordingError as `foreign_log` does.
    plain = foreign_log(worlds, world, "A", "robot", rate_hz=15.0)
    folder = plain.log.parent.with_name(f"{plain.log.parent.name}-jackal")
    first, *beside = (folder / name for name in layout_files("kimera_multi", world))
    if not first.is_file():
        print(f"recording {world} as a Jackal: minutes, once", flush=True)
        with _made_whole(folder) as made:
            _record_as_jackal(plain, worlds, worlds / _FOLDERS.get(world, world), made)
    caches.mark_used(folder)
    return WorldLog(log=first, truth=plain.truth, key=folder.name.removeprefix("foreign-"), beside=tuple(beside))


def _record_as_jackal(plain: WorldLog, worlds: Path, source: Path, out: Path) -> None:
    # Colour is the plain log's. Depth is rendered, since its camera is beside and later. Odometry begins at the origin.
    program = world_program(worlds)
    scene, sensor, truth = program["Scene"](source), program["Camera"](640, 480, "d455"), load_truth(plain.truth)
    true = np.array([frame.world_from_camera for frame in truth.frames])
    heading = float(np.arctan2(true[0, 1, 2], true[0, 0, 2]))
    world_from_start = from_rotation_translation(yaw_rotation(heading), true[0, :3, 3])
    odometry = drifted_poses(invert(world_from_start) @ true, DriftConfig(), np.random.default_rng(1))
    with KimeraMultiLog(out, source.name, truth.camera, 92) as log:
        view = log.depth_view
        assert view is not None
        beside = view.camera
        sensor.f, sensor.K = beside.fx, beside.K
        sensor.dir = backproject(np.ones((beside.height, beside.width), np.float32), beside).reshape(-1, 3)
        sensor.len = np.linalg.norm(sensor.dir, axis=1)
        for i, raw in enumerate(open_source(str(plain.log)).frames()):
            now, then = truth.frames[i], truth.frames[min(i + 1, len(true) - 1)]
            later = view.lag_ns / max(view.lag_ns, then.stamp_ns - now.stamp_ns)
            pose = interpolate(now.world_from_camera, then.world_from_camera, later) @ view.color_from_depth
            _, depth, _, cosine = program["render"](scene, sensor, pose)
            depth_m, _, _ = program["sense_depth"](depth, cosine, sensor, np.random.default_rng([1, 5000 + i]))
            log.write_pose(now.stamp_ns, odometry[i], np.zeros(3))
            log.write_images(now.stamp_ns, raw.decode().rgb, depth_m)


def own_log(seed: int) -> WorldLog:
    """Return the log of an apartment of ours, recorded if it is not cached."""
    return recorded(
        RecordingConfig(scene="apartment", seed=seed, seconds=60.0, rate_hz=_RATE_HZ, width=640, height=480)
    )


def outdoor_log(seed: int) -> WorldLog:
    """Return the log of a street of ours, recorded if it is not cached."""
    config = RecordingConfig(scene="outdoor", seed=seed, seconds=60.0, rate_hz=_RATE_HZ, width=640, height=480)
    return recorded(outdoors(config))


def recorded(config: RecordingConfig) -> WorldLog:
    print(f"{config.scene} {config.seed}, walk {config.walk_index}", flush=True)
    log, truth = cached_recording(config)
    return WorldLog(log=log, truth=truth.folder, key=log.stem.rsplit("-", 1)[-1])
