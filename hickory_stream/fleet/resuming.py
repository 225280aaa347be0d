"""Resumption of a fleet that was killed or stopped.

`robot_process` continues an interrupted robot. A finished one is not mapped again: its journal gives the maps that it
sent. Rounds and joins are equal to a fleet's that never stopped.
"""

from collections.abc import Callable
from pathlib import Path

from hickory_stream.errors import InputError
from hickory_stream.fleet.growth import GrownMap, GrowthSink
from hickory_stream.fleet.robots import Robot
from hickory_stream.map_folder.history.replay import replay
from hickory_stream.map_folder.history.resume import save_live
from hickory_stream.map_folder.manifest import read_manifest
from hickory_stream.ports import Sink


def check_same(folder: Path, robot: Robot) -> None:
    """Raise `InputError` for a map of another log or other options, `MapFolderError` for an unreadable manifest."""
    made_of = read_manifest(folder).run.get("source")
    if made_of != robot.note:
        recorded = made_of if isinstance(made_of, dict) else {}
        what = recorded.get("live") or ", ".join(map(str, recorded.get("uris", ()))) or "something unknown"
        raise InputError(
            f"robot {robot.name}: {folder} was made of {what}, not of {', '.join(robot.uris)} with the options that it "
            "has now; name that one, or choose another -o"
        )


def has_ended(folder: Path) -> bool:
    """Return whether the run has ended, or was of a live robot; raises `MapFolderError`."""
    manifest = read_manifest(folder)
    return manifest.finished_cleanly or manifest.run.get("mode") == "live"


def send_recorded(
    folder: Path, every_keyframes: int, send: Callable[[GrownMap], None], beside: Sink
) -> tuple[str | None, str]:
    """Send the maps of a finished run again; return the digest, and why the map has no end, "" if it has one.

    `beside` gets the reports of the run. Raises `MapFolderError`.
    """
    manifest = read_manifest(folder)
    digest, reason = manifest.digest, ""
    if not manifest.finished_cleanly:
        digest = save_live(folder)
        reason = "its map is saved as of its last keyframe; the frames of a live robot are gone"
    replay(folder, [GrowthSink(every_keyframes, manifest.extractor, send), beside])
    return digest, reason
