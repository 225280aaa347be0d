"""`hickory-stream doctor`: examine a log, or a robot, before mapping it."""

import argparse
import sys
from pathlib import Path

from hickory_stream.base.atomic_files import write_output
from hickory_stream.base.terminal import clear_line
from hickory_stream.cli.commands import Commands
from hickory_stream.cli.option_values import seconds
from hickory_stream.cli.output_files import add_output, disk_refusals
from hickory_stream.cli.source_options import add_source_options, source_options
from hickory_stream.outputs import output

_LIVE_S = 10.0


def add(commands: Commands) -> None:
    doctor = commands.add("doctor", run)
    doctor.add_argument("source", nargs="+", metavar="LOG", help="arguments of play or live")
    doctor.add_argument("--seconds", type=float, default=_LIVE_S, metavar="S", help="duration for a live route (10)")
    add_output(doctor, "--html", type=Path, metavar="PAGE", help="write a page with plots")
    add_output(doctor, "--fix", type=Path, metavar="PROFILE", help="write a profile that mends what was found")
    add_source_options(doctor)


def run(options: argparse.Namespace) -> int:
    from players.doctor.diagnosis import examine
    from players.doctor.report import diagnosis_page, diagnosis_text
    from players.live.examine import examine_live
    from players.live.routes import is_live

    def progress(stage: str) -> None:
        if sys.stderr.isatty() and not options.json:
            clear_line()
            sys.stderr.write(f"{stage} ...")

    if len(options.source) == 1 and is_live(options.source[0]):
        most_s = seconds(options.seconds, "--seconds", least=1.0)
        found = examine_live(options.source[0], source_options(options), progress, seconds=most_s)
    else:
        found = examine(options.source, source_options(options), progress)
    if sys.stderr.isatty() and not options.json:
        clear_line()
    if options.html is not None:
        with disk_refusals(options.html, "page"):
            write_output(options.html, diagnosis_page(found).encode())
    if options.fix is not None:
        from players.profile import mended_profile

        name = options.profile or found.streams.get("profile", "").partition(" (guessed")[0]
        with disk_refusals(options.fix, "profile"):
            write_output(options.fix, mended_profile(name, found.fixes).encode())
    print(output("doctor", found.as_dict(), indent=1) if options.json else diagnosis_text(found))
    return found.status
