"""`--stationarity`: the objects of a map that tend to move."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import argparse

    from hickory_stream.map_folder.saved_map import SavedMap


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
