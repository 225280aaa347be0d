"""A fleet that goes on after it was killed or stopped: what is there of each robot, sent as it was sent then.

A robot whose run was interrupted is played on (`robot_process`). One that has ended is not mapped again: what it sent
while its map grew comes from its journal. The rounds, and with them the joins, are those of a fleet that never stopped.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.errors import InputError
from hickory_stream.fleet.growth import GrowthSink
from hickory_stream.map_folder.history.replay import replay
from hickory_stream.map_folder.history.resume import save_live
from hickory_stream.map_folder.manifest import read_manifest

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from hickory_stream.fleet.growth import GrownMap
    from hickory_stream.fleet.robots import Robot
    from hickory_stream.ports import Sink


def check_same(folder: Path, robot: Robot) -> None:
    """Refuse to go on with a map of something else than the robot's log.

    Raises:
        InputError: it was made of another log, or with other options.
        MapFolderError: its manifest cannot be read.
    """
    made_of = read_manifest(folder).run.get("source")
    if made_of != robot.note:
        recorded = made_of if isinstance(made_of, dict) else {}
        what = recorded.get("live") or ", ".join(map(str, recorded.get("uris", ()))) or "something unknown"
        raise InputError(
            f"robot {robot.name}: {folder} was made of {what}, not of {', '.join(robot.uris)} with the options that it "
            "has now; name that one, or choose another -o"
        )


def has_ended(folder: Path) -> bool:
    """Return whether nothing is left to be mapped: the run has ended, or was that of a live robot.

    Raises:
        MapFolderError: its manifest cannot be read.
    """
    manifest = read_manifest(folder)
    return manifest.finished_cleanly or manifest.run.get("mode") == "live"


def send_recorded(
    folder: Path, every_keyframes: int, send: Callable[[GrownMap], None], beside: Sink
) -> tuple[str | None, str]:
    """Send what a run that has ended sent; return the map's digest, and why the map has no end, "" where it has one.

    `beside` is shown what the run's sinks were shown.

    Raises:
        MapFolderError: the map cannot be read, or what it lacks not be written.
    """
    manifest = read_manifest(folder)
    digest, reason = manifest.digest, ""
    if not manifest.finished_cleanly:
        digest = save_live(folder)
        reason = "its map is saved as of its last keyframe; the frames of a live robot are gone"
    replay(folder, [GrowthSink(every_keyframes, manifest.extractor, send), beside])
    return digest, reason
