"""The synthetic apartments as the whole pipeline maps them: played once for each state of the mapper's code."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.config import MapperConfig
from hickory_stream.map_folder.manifest import is_map_folder
from hickory_stream.map_folder.saved_map import open_map
from players import open_source
from tools.benchmarks.played import play_into
from tools.benchmarks.processes import ROOT
from tools.benchmarks.repetitions import hash_of_files
from tools.evaluation.simulated_maps.moved_source import MovedSource
from tools.evaluation.simulated_maps.variants import random_frame
from tools.worlds.cache import cached_recording, recording_name
from tools.worlds.recording_config import RecordingConfig

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

_MAPS = ROOT / "out" / "maps"


def apartment_recording(apartment: int, walk: int) -> RecordingConfig:
    """Return what the log of a walk through an apartment is made from."""
    return RecordingConfig(
        scene="apartment", seed=apartment, walk_index=walk, seconds=None, rate_hz=15.0, width=640, height=480
    )


def apartment_map(apartment: int, walk: int, *, plays: bool) -> Path | None:
    """Return the folder of a map, played if need be; None where it is not there and `plays` is False."""
    config = apartment_recording(apartment, walk)
    folder = _MAPS / f"{recording_name(config)}-{_code_digest()}"
    if is_map_folder(folder) and open_map(folder).manifest.finished_cleanly:
        return folder
    if not plays:
        return None
    log, _ = cached_recording(config)
    print(f"playing {log.name}", flush=True)
    folder.parent.mkdir(parents=True, exist_ok=True)
    play_into(folder, MovedSource(open_source(str(log)), frame_of(apartment, walk)), MapperConfig())
    return folder


def frame_of(apartment: int, walk: int) -> NDArray[np.float64]:
    """Return `map_from_world`: where the robot of a walk started, by its own reckoning; the first one at the truth."""
    return np.eye(4) if walk == 0 else random_frame(np.random.default_rng([apartment, walk, 3]))


def _code_digest() -> str:
    """Return what tells two states of the code that makes maps apart."""
    packages = ("geometry", "perception", "mapping", "shapes")
    return hash_of_files([f"hickory_stream/{package}" for package in packages], (".py",))[:8]
