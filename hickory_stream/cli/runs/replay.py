"""`hickory-stream replay`: repeat a recorded run from its map folder."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hickory_stream.cli.output_files import add_output
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse

    from hickory_stream.cli.commands import Commands
    from hickory_stream.map_folder.saved_map import SavedMap


def add(commands: Commands) -> None:
    replay = commands.add("replay", run, configured=True)
    replay.add_argument("map", type=Path, metavar="MAP")
    add_output(replay, "--rrd", type=Path, metavar="FILE", help="write a Rerun recording")


def run(options: argparse.Namespace) -> int:
    from hickory_stream.cli.option_values import open_map_at, read_settings
    from hickory_stream.map_folder.digest import map_digest
    from hickory_stream.map_folder.history.replay import replay
    from hickory_stream.sinks.rerun.sink import RerunSink
    from hickory_stream.sinks.rerun.viewer import parse_viewer

    settings = read_settings(options)
    saved = open_map_at(options.map, warns=False, is_whole=True)
    sinks = []
    if options.rrd is not None:
        sinks.append(RerunSink(settings.rerun, options.map, options.rrd, parse_viewer("none")))
    snapshot = replay(options.map, sinks)
    digest = map_digest(snapshot)
    recorded = saved.manifest.digest
    is_same = digest == recorded and not saved.is_altered
    if options.json:
        said = {"event": "replayed", "digest": digest, "recorded_digest": recorded, "saved_digest": saved.digest}
        print(output("replay", {**said, "is_same": is_same, "objects": len(snapshot.objects)}))
    elif recorded is None:
        print(f"{options.map}: {len(snapshot.objects)} objects; its run did not end, so that no digest is recorded")
    else:
        text = f"another map: {recorded[:16]} was recorded" if digest != recorded else _told(saved)
        print(f"{options.map}: {len(snapshot.objects)} objects, digest {digest[:16]}, {text}")
    return 0 if is_same or (recorded is None and not saved.is_altered) else 1


def _told(saved: SavedMap) -> str:
    if not saved.is_altered:
        return "the same map"
    return f"the saved map; the folder was changed since, its digest is {saved.digest[:16]}"
