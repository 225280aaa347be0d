"""`hickory-stream resume`: continue an interrupted playback."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from hickory_stream.cli.option_values import make_style, read_settings, resume_command
from hickory_stream.cli.runs.play import make_sinks
from hickory_stream.cli.runs.summary import finish
from hickory_stream.errors import MapFolderError
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse

    from hickory_stream.cli.commands import Commands
    from hickory_stream.map_folder.writer import MapFolder
    from hickory_stream.ports import Sink


def add(commands: Commands) -> None:
    resume = commands.add("resume", run, configured=True)
    resume.add_argument("map", type=Path, metavar="MAP")
    resume.add_argument("--source", nargs="+", metavar="LOG", help="new location of the log")
    resume.add_argument(
        "--use-current-workers",
        action="store_true",
        help="build shapes with the workers of this configuration instead of the recorded ones",
    )
    resume.add_argument("--viewer", default="none", help="none (default), auto, spawn, web or connect=URL")


def run(options: argparse.Namespace) -> int:
    from hickory_stream.engine.mapper import Mapper
    from hickory_stream.engine.play import play
    from hickory_stream.map_folder.history.recorded_config import resumed_config
    from hickory_stream.map_folder.history.resume import check_interrupted, save_live, was_sought
    from hickory_stream.progress import ProgressPrinter
    from hickory_stream.sinks.rerun.viewer import check_viewer, parse_viewer
    from players import open_from_note

    settings = read_settings(options)
    viewer = parse_viewer(options.viewer)
    check_viewer(viewer)
    manifest = check_interrupted(options.map)
    is_live = manifest.run.get("mode") == "live"
    if is_live or was_sought(options.map):
        digest = save_live(options.map)
        said = {"event": "saved", "map": str(options.map), "finished_cleanly": False, "digest": digest}
        why = "its frames are gone" if is_live else "a playback with jumps cannot be continued"
        print(output("resume-saved", said) if options.json else f"{options.map}: saved as of its last step; {why}")
        return 0
    recorded = manifest.run.get("source")
    note = dict(recorded) if isinstance(recorded, dict) else {}
    if options.source is not None:
        note["uris"] = options.source
    if "uris" not in note:
        raise MapFolderError(f"{options.map} has no record of its source; resume it from Python (Mapper.resuming)")
    # Refuse an invalid configuration before the log is opened.
    resumed_config(options.map, settings.mapper.run, ignores_recorded=options.use_current_workers)
    source = open_from_note(note)
    if not options.json:
        sys.stderr.write(f"resuming {options.map}: {source.info.uri}\n")

    def sinks(folder: MapFolder) -> list[tuple[Sink, bool]]:
        return make_sinks(folder, settings, viewer, None)

    printer = ProgressPrinter(make_style(options))
    options.resumed_by = resume_command(options.map)
    try:
        mapper = Mapper.resuming(
            options.map, machine=settings.mapper.run, ignores_recorded_workers=options.use_current_workers
        )
        played = play(mapper, source, sinks=sinks, progress=printer)
    finally:
        printer.close()
        source.close()
    return finish(options, options.map, played)
