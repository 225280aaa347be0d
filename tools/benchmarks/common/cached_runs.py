"""Results that are computed once: maps of recordings, and JSON of parts, each in a folder named by the code."""

import asyncio
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.atomic_files import write_atomically
from hickory_stream.base.config_text import read_config
from hickory_stream.base.json_text import dumps
from hickory_stream.config import MapperConfig
from hickory_stream.engine.mapper import Mapper
from hickory_stream.errors import MapFolderError
from hickory_stream.evaluation.truth import Truth
from hickory_stream.map_folder.saved_map import SavedMap, open_map
from hickory_stream.ports import Source
from players import open_source
from tools.benchmarks.common.code_hashes import MAPS, code_hash
from tools.benchmarks.common.processes import NO_SHAPES, ROOT
from tools.evaluation.simulated_maps.moved_source import MovedSource
from tools.evaluation.simulated_maps.variants import random_frame
from tools.worlds.cache import cached_recording, recording_name
from tools.worlds.recording_config import RecordingConfig


def state_folder(state: Path, name: str, *code: str) -> Path:
    return state / f"{name}-{code_hash(*MAPS, *code)[:12]}"


def cached(file: Path, measured: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Return the content of a JSON file, measured if it is not there; a file is whole or absent."""
    try:
        return dict(json.loads(file.read_text(encoding="utf-8")))
    except (FileNotFoundError, ValueError):
        found = measured()
    file.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(file, (dumps(found) + "\n").encode())
    return found


def play_into(folder: Path, source: Source, config: MapperConfig, **ports: Any) -> None:
    """Map a source into a folder, replacing its content, and close the source; `ports` are those of `Mapper`."""

    async def run() -> None:
        async with Mapper(config, out=folder, overwrite=True, **ports) as mapper:
            async for _ in mapper.run(source):
                pass

    try:
        asyncio.run(run())
    finally:
        source.close()


def is_finished(folder: Path) -> bool:
    """Return whether a folder holds a map that was made to its end."""
    try:
        return open_map(folder).manifest.finished_cleanly
    except MapFolderError:
        return False


def cached_map(folder: Path, opened: Callable[[], Source], *overrides: str) -> SavedMap:
    if not is_finished(folder):
        print(f"playing into {folder.name}: minutes, once", flush=True)
        folder.parent.mkdir(parents=True, exist_ok=True)
        play_into(folder, opened(), read_config(MapperConfig, None, overrides))
    return open_map(folder)


def map_without_shapes(config: RecordingConfig, folder: Path) -> tuple[Truth, SavedMap]:
    log, truth = cached_recording(config)
    return truth, cached_map(folder, lambda: open_source(str(log)), NO_SHAPES)


def walk_recording(scene: str, seed: int, walk: int = 0, rate_hz: float = 15.0) -> RecordingConfig:
    return RecordingConfig(
        scene=scene, seed=seed, walk_index=walk, seconds=None, rate_hz=rate_hz, width=640, height=480
    )


def apartment_map(apartment: int, walk: int) -> Path:
    """Return the folder of the cached map of a walk, in the frame of `frame_of`."""
    config = walk_recording("apartment", apartment, walk)
    folder = state_folder(ROOT / "out" / "maps", recording_name(config))
    moved, log = frame_of(apartment, walk), cached_recording(config)[0]
    cached_map(folder, lambda: MovedSource(open_source(str(log)), lambda raw: moved @ raw.world_from_camera))
    return folder


def frame_of(apartment: int, walk: int) -> NDArray[np.float64]:
    """Return `map_from_world` (4, 4): the start of a walk by the robot's own odometry; the identity for the first."""
    return np.eye(4) if walk == 0 else random_frame(np.random.default_rng([apartment, walk, 3]))
