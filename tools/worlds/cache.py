"""Recordings that are made at first use, and kept."""

import dataclasses
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hickory_stream.base import caches
from hickory_stream.base.json_text import dumps
from hickory_stream.evaluation.truth import TRUTH_FILE, Truth, load_truth
from hickory_stream.worlds.recording import make_recording
from hickory_stream.worlds.trajectory import WalkConfig
from tools.worlds.layouts import layout_files
from tools.worlds.recording_config import CLUTTER, RecordingConfig

WORLDS_VERSION = 1
"""The version of the cache, to be raised with any change of rendered output, so that old recordings are made again."""
CLUTTER_VERSION = 2
"""The version for random rooms only."""


# Fields that were added to configs later: their defaults are left out of a name, so that older recordings stay valid.
_LATER = {
    "": (RecordingConfig(), ("layout", "family", "camera_offset", "robots", "day", "change_at_s")),
    "walk": (WalkConfig(), ("pitch_deg",)),
}


def cache_folder() -> Path:
    """Return where recordings are kept, below `$HICKORY_CACHE`; raises `ConfigError` where nothing can be kept."""
    return caches.cache_folder("recordings")


def cached_recording(
    config: RecordingConfig, folder: Path | None = None, progress: Callable[[int, int], None] = lambda done, total: None
) -> tuple[Path, Truth]:
    """Return the log and the truth of a config, from the cache or made now."""
    # Raises ConfigError: no world of the config can be walked through.
    # Raises OSError: the folder cannot be written.
    folder = cache_folder() if folder is None else folder
    name = recording_name(config)
    truth_folder, log = folder / f"{name}.truth", folder / layout_files(config.layout, name)[0]
    # The log is moved into the cache after the truth, so that a log there is complete.
    if log.exists() and (truth_folder / TRUTH_FILE).is_file():
        caches.mark_used(log, truth_folder)
        return log, load_truth(truth_folder)
    truth = make_recording(config, folder, name, progress)
    caches.prune()
    return log, truth


def recording_name(config: RecordingConfig) -> str:
    """Return the name of a config's recording: its scene in words, and a hash of the whole config."""
    values = dataclasses.asdict(config)
    _forget_defaults(values)
    version = [WORLDS_VERSION, CLUTTER_VERSION] if config.scene == CLUTTER else [WORLDS_VERSION]
    told = dumps([*version, values], sort_keys=True)
    digest = hashlib.sha256(told.encode()).hexdigest()[:10]
    return f"{config.scene}-{config.seed}-walk{config.walk_index}-{digest}"


def _forget_defaults(values: dict[str, Any]) -> None:
    for part, (defaults, fields) in _LATER.items():
        held = values if not part else values[part]
        for field in fields if held is not None else ():
            if held[field] == getattr(defaults, field):
                del held[field]
