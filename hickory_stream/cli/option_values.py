"""Options that several commands share, checks of option values, and the map that they name."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hickory_stream.errors import ConfigError, InputError, MapFolderError
from hickory_stream.textures import LEAST_TEXTURE_PX, MOST_TEXTURE_PX

if TYPE_CHECKING:
    import argparse

    from hickory_stream.map_folder.saved_map import SavedMap
    from hickory_stream.navigation.robot import Robot
    from hickory_stream.progress import Style
    from hickory_stream.records import MapSnapshot
    from hickory_stream.settings import Settings

# A height farther from all floors is a mistake.
_REACH_M = 1.0


def read_settings(options: argparse.Namespace) -> Settings:
    """Return the settings of `--config`, `--set` and `--workers`; raises `ConfigError`."""
    from dataclasses import replace

    from hickory_stream.base.config_text import read_config
    from hickory_stream.settings import Settings

    settings = read_config(Settings, options.config, tuple(options.set or ()))
    if getattr(options, "workers", None) is not None:
        mapper = settings.mapper
        settings = replace(settings, mapper=replace(mapper, run=replace(mapper.run, **parse_workers(options.workers))))
    return settings


def parse_workers(text: str) -> dict[str, Any]:
    """Return the worker settings of a text like 2 or dask=tcp://HOST:PORT; raises `ConfigError`."""
    if text.startswith("dask="):
        return {"cluster": text.removeprefix("dask=")}
    if not text.isdigit() or int(text) < 1:
        raise ConfigError(f"found --workers {text}, expected a number, at least 1, or dask=tcp://HOST:PORT")
    return {"workers": int(text), "cluster": ""}


def open_map_at(path: Path, at: str | None = None, *, warns: bool = True, is_whole: bool = False) -> SavedMap:
    """Return the map in a folder, at the time `at` if given; warns on standard error of a run that did not end.

    Raises `MapFolderError` without a map or its history, `InputError` for a time outside of the run.
    """
    from dataclasses import replace

    from hickory_stream.map_folder.saved_map import open_map

    saved = open_map(path, warns=warns, is_whole=is_whole)
    note = unfinished_note(saved)
    if note is not None:
        sys.stderr.write(f"note: {note}\n")
    if at is None:
        return saved
    # Imports the core, which takes a second.
    from hickory_stream.map_folder.history.time_travel import stamp_of

    return replace(saved, snapshot=saved.as_known_at(stamp_of(path, at)))


def resume_command(folder: Path) -> str:
    """Return the command line that resumes the run of a map."""
    return f"hickory-stream resume {shlex.quote(str(folder))}"


def unfinished_note(saved: SavedMap) -> str | None:
    """Return the notice of a map's run, None if it has ended or cannot be resumed."""
    mode = saved.manifest.run.get("mode")
    if saved.manifest.finished_cleanly or mode is None:
        return None
    from hickory_stream.journal.reader import Journal
    from hickory_stream.map_folder.layout import check_unlocked

    try:
        with Journal(saved.folder) as journal:
            steps = len(journal)
    except MapFolderError:
        return None
    objects = len(saved.snapshot.objects)
    # Saved snapshots have a revision of 1 or more.
    known = f"{objects} objects as of its last save" if saved.snapshot.revision else "nothing was saved yet"
    journal_text = f"its journal holds {steps} keyframe{'' if steps == 1 else 's'}"
    try:
        check_unlocked(saved.folder)
    except MapFolderError:
        return f"{saved.folder} is being written: {known}, {journal_text}"
    if mode == "live" and saved.manifest.digest is not None:
        return f"the run of {saved.folder} did not end: {known}, and nothing is left to save"
    action = "save it with" if mode == "live" else "continue with"
    look = " (`inspect --at` shows any time of it)" if steps else ""
    return f"the run of {saved.folder} did not end: {known}, {journal_text}{look}; {action}: " + resume_command(
        saved.folder
    )


def add_at(parser: argparse.ArgumentParser) -> None:
    """Add the option of a time in the run."""
    text = "the map at this time: seconds from the first keyframe, or a stamp like 17...ns"
    parser.add_argument("--at", metavar="T", help=text)


def add_allow_unverified(parser: argparse.ArgumentParser) -> None:
    """Add the option that accepts altered maps."""
    parser.add_argument(
        "--allow-unverified", action="store_true", help="accept a map that was altered after it was saved, with a note"
    )


def open_verified_map_at(options: argparse.Namespace) -> tuple[SavedMap, str]:
    """Return the map of `options.map` and `options.at`, and why its layer 4 is not proven, "" if it is.

    Raises like `open_map_at`, and `MapFolderError` for an altered map without `--allow-unverified`.
    """
    from hickory_stream.map_folder.saved_map import check_unaltered

    saved = open_map_at(options.map, options.at, warns=False)
    if not options.allow_unverified:
        check_unaltered(saved, ", --allow-unverified accepts it")
    doubt = saved.doubt
    if not doubt and options.at is not None:
        doubt = f"the map at {options.at} is from the journal, which only `hickory-stream verify` checks"
    return saved, doubt


def robot_of_option(name: str | None, option: str) -> Robot:
    """Return the robot that an option names; raises `ConfigError` without one: a default could be too small."""
    from hickory_stream.navigation.robot import load_robot, robot_names

    if name is None:
        known = ", ".join(robot_names())
        raise ConfigError(f"found no {option}, expected a robot: {known}, or a file FILE.toml")
    return load_robot(name)


def make_style(options: argparse.Namespace) -> Style:
    """Return the style of progress output."""
    return "json" if options.json else "bar" if sys.stderr.isatty() else "lines"


def parse_rate(text: str) -> float | None:
    """Return a factor of real time, None for `max`; raises `InputError`."""
    if text == "max":
        return None
    try:
        rate = float(text)
    except ValueError:
        rate = 0.0
    if not 0 < rate < float("inf"):
        raise InputError(f"found --rate {text}, expected max or a number above 0, e.g. 1.0 for real time")
    return rate


def positive(number: int, option: str) -> int:
    """Return the number if it is 1 or more; raises `InputError`."""
    if number < 1:
        raise InputError(f"found {option} {number}, expected at least 1")
    return number


def seconds(value: float, option: str, *, least: float) -> float:
    """Return the value if it is finite and at least `least`; raises `InputError`."""
    if not least <= value < float("inf"):
        raise InputError(f"found {option} {value:g}, expected seconds, {least:g} or more")
    return value


def parse_nanoseconds(tolerance_ms: float | None) -> int | None:
    """Return milliseconds as nanoseconds; raises `InputError` below 0."""
    if tolerance_ms is None:
        return None
    if not 0 <= tolerance_ms < float("inf"):
        raise InputError(f"found --sync-tolerance {tolerance_ms:g}, expected milliseconds, 0 or more")
    return round(tolerance_ms * 1e6)


def parse_place(text: str, option: str) -> tuple[float, float]:
    """Return the x and y of a text like 1.5,-2, metres; raises `InputError`."""
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(f"found {option} {text}, expected X,Y in metres, e.g. {option} 1.5,-2") from error
    if not (abs(x) < float("inf") and abs(y) < float("inf")):
        raise InputError(f"found {option} {text}, expected two finite numbers")
    return x, y


def parse_layers(text: str) -> set[int]:
    """Return the layers of a text like 1,2; raises `InputError`."""
    parts = {part.strip() for part in text.split(",")}
    if not parts <= {"1", "2", "3", "4"}:
        raise InputError(f"found --layers {text}, expected some of 1,2,3,4")
    return {int(part) for part in parts}


def add_texture_argument(parser: argparse.ArgumentParser, what: str, default: int) -> None:
    """Add --texture: the largest side in pixels, 0 for none."""
    import argparse

    least, most = LEAST_TEXTURE_PX, MOST_TEXTURE_PX

    def side(text: str) -> int:
        if not text.isdigit() or not (int(text) == 0 or least <= int(text) <= most):
            raise argparse.ArgumentTypeError(
                f"found --texture {text}, expected {least} to {most} pixels, or 0 for vertex colours"
            )
        return int(text)

    message = f"{what} at most, {least} to {most} pixels; 0: vertex colours; default {default}"
    parser.add_argument("--texture", type=side, default=default, metavar="PX", help=message)


def parse_size(text: str) -> tuple[int, int]:
    """Return width and height of a text like 1600x800, pixels; raises `InputError`."""
    width, _, height = text.partition("x")
    if not (width.isdigit() and height.isdigit() and 480 <= int(width) <= 8192 and 240 <= int(height) <= 8192):
        raise InputError(f"found --size {text}, expected WIDTHxHEIGHT of 480x240 to 8192x8192 pixels, e.g. 1600x800")
    return int(width), int(height)


def add_floor_argument(parser: argparse.ArgumentParser, what: str) -> None:
    """Add --floor: a height near one of the map's floors."""
    parser.add_argument("--floor", type=float, metavar="Z", help=f"{what}: height of its floor in metres")


def floor_of_option(snapshot: MapSnapshot, floor_m: float | None) -> float:
    """Return the floor that `--floor` selects; without it, the map's only floor.

    Raises `InputError` if the map has several floors and none was given, or none at this height.
    """
    from hickory_stream.storeys import floor_of, floors_of

    floors_m = floors_of(snapshot)
    text = " and ".join([", ".join(f"{z_m:.2f}" for z_m in floors_m[:-1]), *(f"{z_m:.2f}" for z_m in floors_m[-1:])])
    if floor_m is None:
        if len(floors_m) > 1:
            raise InputError(f"the map has {len(floors_m)} floors, at z = {text} m; choose one with --floor")
        return floor_of(snapshot)
    if not abs(floor_m) < float("inf"):
        raise InputError(f"found --floor {floor_m}, expected a height in metres")
    if not floors_m:
        return floor_m
    nearest = min(floors_m, key=lambda z_m: abs(z_m - floor_m))
    if abs(nearest - floor_m) > _REACH_M:
        there = f"its floors are at z = {text} m" if len(floors_m) > 1 else f"its floor is at z = {floors_m[0]:.2f} m"
        raise InputError(f"found --floor {floor_m:g}, but the map has no floor within {_REACH_M:g} m of it: {there}")
    return nearest


def add_stationarity(parser: argparse.ArgumentParser) -> None:
    """Add the option."""
    parser.add_argument(
        "--stationarity",
        type=Path,
        metavar="FILE",
        help="file of `diff --stationarity` for this map: objects that tend to move",
    )


def movable_objects(file: Path | None, saved: SavedMap) -> list[int]:
    """Return the ids of the objects that tend to move, none without a file; raises `InputError` for another map's."""
    from hickory_stream.changes.stationarity import read_stationarity

    return [] if file is None else read_stationarity(file, saved.manifest.digest).movable()
