"""The configuration of a map, to be read, repeated or continued."""

from dataclasses import replace
from pathlib import Path

from hickory_stream.base.config_text import from_dict
from hickory_stream.base.former_keys import with_current_names
from hickory_stream.config import MapperConfig, RunConfig, as_far_as_known
from hickory_stream.errors import ConfigError, MapFolderError
from hickory_stream.map_folder.manifest import read_manifest

# Which program is run and which address connected to is never taken from a map, which may come from anybody.
MACHINE_KEYS = ("worker_python", "cluster", "generator")


def recorded_config(path: Path) -> MapperConfig:
    """Return the configuration of a map. Raises `MapFolderError`: there is no map, or it is of another version."""
    manifest = read_manifest(path)
    try:
        return from_dict(MapperConfig, with_current_names(manifest.config))
    except ConfigError as error:
        raise MapFolderError(
            f"{path} was made by hickory-stream {manifest.software_version}: {error}; play the log again"
        ) from error


def resumed_config(path: Path, own: RunConfig, *, ignores_recorded: bool = False) -> MapperConfig:
    """Return the configuration to continue a map, with the programs and addresses of `own`.

    `ignores_recorded` accepts a map that was made with other workers.

    Raises `MapFolderError`: there is no map, or it is of another version; `ConfigError`: its interpreter or cluster is
    not in `own`.
    """
    recorded = recorded_config(path)
    for key in MACHINE_KEYS:
        was, now = getattr(recorded.run, key), getattr(own, key)
        if was and was != now and not ignores_recorded:
            raise ConfigError(
                f"{path} was made with run.{key} = {was!r}, here it is {now!r}; what a map names is never run or "
                f"connected to: give --set mapper.run.{key}=... if you know it, or --use-current-workers"
            )
    machine = {key: getattr(own, key) for key in (*MACHINE_KEYS, "cluster_gpus", "accept_licence")}
    return replace(recorded, run=replace(recorded.run, **machine))


def known_config(path: Path) -> MapperConfig:
    """Return the configuration of a map as far as this version knows it, for reports.

    Raises `MapFolderError`: there is no map.
    """
    return as_far_as_known(read_manifest(path).config)
