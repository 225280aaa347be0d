"""Recordings that are made when they are first asked for, and kept."""

from __future__ import annotations

import dataclasses
import hashlib
from typing import TYPE_CHECKING

from hickory_stream import caches
from hickory_stream.evaluation.truth import TRUTH_FILE, Truth, load_truth
from hickory_stream.evaluation.worlds.layouts import layout_files
from hickory_stream.evaluation.worlds.recording import RecordingConfig, make_recording
from hickory_stream.json_text import dumps

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

WORLDS_VERSION = 1
"""To be raised by whoever changes what a config gives: older recordings are then made anew."""


def cache_folder() -> Path:
    """Return where recordings are kept, below `$HICKORY_CACHE`; raises `ConfigError` where nothing can be kept."""
    return caches.cache_folder("recordings")


def cached_recording(
    config: RecordingConfig,
    folder: Path | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[Path, Truth]:
    """Return the log and the truth of a config; made if they are not there yet.

    Raises:
        ConfigError: the config gives no world that can be walked.
        OSError: the folder cannot be written.
    """
    folder = cache_folder() if folder is None else folder
    name = recording_name(config)
    truth_folder, log = folder / f"{name}.truth", folder / layout_files(config.layout, name)[0]
    # The log is moved to its place after the truth.
    if log.exists() and (truth_folder / TRUTH_FILE).is_file():
        caches.mark_used(log, truth_folder)
        return log, load_truth(truth_folder)
    truth = make_recording(config, folder, name, progress)
    caches.prune()
    return log, truth


def recording_name(config: RecordingConfig) -> str:
    """Return the name of a config's recording: what it shows, in words, and a hash of all of the config."""
    values = dataclasses.asdict(config)
    if config.layout == RecordingConfig().layout:
        del values["layout"]  # as before there were layouts: what is cached stays valid
    told = dumps([WORLDS_VERSION, values], sort_keys=True)
    digest = hashlib.sha256(told.encode()).hexdigest()[:10]
    return f"{config.scene}-{config.seed}-walk{config.walk_index}-{digest}"
