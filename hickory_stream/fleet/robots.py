"""Robots of a fleet with names and logs, from FLEET.toml or from NAME=LOG on the command line."""

import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from hickory_stream.base.config_text import from_dict
from hickory_stream.base.ranges import Ranged, number
from hickory_stream.errors import ConfigError
from hickory_stream.merging.joining import JoiningConfig
from players import SourceOptions, make_source_note
from players.live.routes import is_live

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")
FLEET = "fleet"
"""What the files of the whole fleet are called: no robot has this name."""
MAX_ROBOTS = 64


@dataclass(frozen=True, kw_only=True, slots=True)
class Robot:
    """A robot: its name, its logs or one live URI, and options for them."""

    name: str
    uris: tuple[str, ...]
    options: SourceOptions

    @property
    def is_live(self) -> bool:
        """Whether it is mapped while it moves."""
        return len(self.uris) == 1 and is_live(self.uris[0])

    @property
    def note(self) -> dict[str, Any]:
        """The manifest entry from which its source is opened again."""
        return {"live": self.uris[0]} if self.is_live else make_source_note(self.uris, self.options)


@dataclass(frozen=True, kw_only=True, slots=True)
class FleetConfig(Ranged):
    """How a fleet is run.

    Attributes:
        every_keyframes: the maps are aligned whenever each robot has so many keyframes more. Whenever one has, where a
            robot is live.
        processes: robots that are mapped at the same time; 0: as many as there are processors.
        for_s: live robots are mapped for so long; 0: until they end or the run is stopped.
        patience_s: a live robot is given up when nothing of it can be mapped for so long.
        joining: how two maps are aligned, and how surely they are joined.
    """

    every_keyframes: int = number(10, 1, 1_000_000, "keyframes")
    processes: int = number(0, 0, 1024, "processes")
    for_s: float = number(0.0, 0, 1e9, "s")
    patience_s: float = number(60.0, 0, 1e9, "s")
    joining: JoiningConfig = field(default_factory=JoiningConfig)


def read_fleet(path: Path) -> tuple[tuple[Robot, ...], FleetConfig]:
    """Return the robots of a FLEET.toml in order, and the configuration; paths are relative to the file.

    Raises `ConfigError` for an invalid file, an unknown key, a robot without name or log, or a repeated name.
    """
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"cannot read the fleet {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path} is not TOML: {error}") from error
    entries = data.pop("robot", [])
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise ConfigError(f"{path}: found robot = {entries!r:.40}, expected a table [[robot]] for each robot")
    try:
        if unknown := sorted(set(data) - {one.name for one in fields(FleetConfig)}):
            known = ", ".join(sorted(one.name for one in fields(FleetConfig)))
            raise ConfigError(f"unknown key {unknown[0]}; known keys: {known}, and a table [[robot]] for each robot")
        config = from_dict(FleetConfig, data)
        robots = tuple(_robot_of(entry, i, path.parent) for i, entry in enumerate(entries, start=1))
        return checked(robots), config
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def robots_of(texts: Sequence[str]) -> tuple[Robot, ...]:
    """Return the robots of texts like NAME=LOG; raises `ConfigError` for another form, or a bad or repeated name."""
    robots = []
    for text in texts:
        name, equals, uri = text.partition("=")
        if not (name and equals and uri):
            raise ConfigError(f"found --robot {text}, expected NAME=LOG, e.g. --robot alice=alice.mcap")
        robots.append(Robot(name=name, uris=(uri,), options=SourceOptions()))
    return checked(tuple(robots))


def checked(robots: tuple[Robot, ...]) -> tuple[Robot, ...]:
    """Return the robots if they are two or more with distinct names for folders; raises `ConfigError`."""
    if not 2 <= len(robots) <= MAX_ROBOTS:
        raise ConfigError(f"expected 2 to {MAX_ROBOTS} robots, found {len(robots)}; `play` and `live` map a single one")
    first: dict[str, Robot] = {}
    for robot in robots:
        if not _NAME.fullmatch(robot.name) or robot.name.casefold() == FLEET:
            raise ConfigError(
                f"found the robot name {robot.name!r}, expected letters, digits, _ . and -, beginning with a letter or "
                f"digit, and not {FLEET!r}: its map is the folder NAME.map"
            )
        # Where capital letters do not count in names of files, theirs would be one folder.
        other = first.setdefault(robot.name.casefold(), robot)
        if other is not robot:
            raise ConfigError(
                f"two robots are called {robot.name} ({other.uris[0]} and {robot.uris[0]}); give each a name of its own"
            )
    return robots


def _robot_of(entry: dict[str, Any], place: int, folder: Path) -> Robot:
    entry = dict(entry)
    name, log = entry.pop("name", None), entry.pop("log", None)
    if not isinstance(name, str):
        raise ConfigError(f'robot {place} has no name; expected name = "..."')
    uris = [log] if isinstance(log, str) else log
    if not (isinstance(uris, list) and uris and all(isinstance(uri, str) and uri for uri in uris)):
        raise ConfigError(f'robot {name}: found log = {log!r}, expected log = "FILE", a list of files, or a live URI')
    pose_file = entry.pop("pose_file", None)
    if pose_file is not None and not isinstance(pose_file, str):
        raise ConfigError(f"robot {name}: found pose_file = {pose_file!r}, expected the name of a file")
    if isinstance(entry.get("profile"), str) and (folder / entry["profile"]).is_file():
        entry["profile"] = str(folder / entry["profile"])
    if pose_file is not None:
        entry["pose_file"] = folder / pose_file
    options = from_dict(SourceOptions, entry, f"robot {name}.")
    return Robot(name=name, uris=tuple(uri if is_live(uri) else str(folder / uri) for uri in uris), options=options)
