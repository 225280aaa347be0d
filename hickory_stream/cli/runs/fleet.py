"""`hickory-stream fleet`: map several robots in one run, and merge their maps."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hickory_stream.cli.commands import INCOMPLETE, STOPPED, Commands
from hickory_stream.cli.option_values import make_style, read_settings
from hickory_stream.cli.output_files import disk_refusals
from hickory_stream.cli.source_options import add_anyway
from hickory_stream.errors import InputError
from hickory_stream.outputs import output, picked

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from hickory_stream.engine.modes import Progress
    from hickory_stream.fleet.result import FleetResult, RobotResult
    from hickory_stream.progress import ProgressPrinter


DEFAULTS: dict[str, Any] = {"fleet": None, "resume": False, "every": None, "processes": None, "most_s": None}
"""Defaults of `fleet` options that `play` lacks."""

_SUMMED = ("frames", "keyframes", "objects", "open_shapes")


def add(commands: Commands) -> None:
    fleet = commands.add("fleet", run, configured=True)
    fleet.add_argument(
        "fleet", type=Path, nargs="?", metavar="FLEET.toml", help="file with a table [[robot]] for each robot"
    )
    fleet.add_argument(
        "--robot", action="append", metavar="NAME=LOG", help="a robot and its log or live URI, instead of a file"
    )
    fleet.add_argument(
        "-o", "--out", type=Path, required=True, metavar="OUT", help="folder for NAME.map, fleet.map and fleet.rrd"
    )
    there = fleet.add_mutually_exclusive_group()
    there.add_argument("--overwrite", action="store_true", help="replace existing maps")
    there.add_argument("--resume", action="store_true", help="continue a fleet that was killed or stopped")
    fleet.add_argument("--every", type=int, metavar="N", help="align the maps every N keyframes (10)")
    fleet.add_argument("--processes", type=int, metavar="N", help="robots at a time (as many as processors)")
    fleet.add_argument("--for", type=float, dest="most_s", metavar="S", help="map live robots for this many seconds")
    fleet.add_argument("--viewer", default="auto", help="auto (default), none, spawn, web or connect=URL")
    add_anyway(fleet)
    fleet.add_argument("--workers", metavar="N", help="child processes of each robot that build shapes")


def run(options: argparse.Namespace) -> int:
    from dataclasses import replace

    from hickory_stream.base.atomic_files import write_output
    from hickory_stream.fleet.robots import FleetConfig, read_fleet, robots_of
    from hickory_stream.fleet.run import FleetPlan, run_fleet
    from hickory_stream.progress import ProgressPrinter
    from hickory_stream.sinks.rerun.viewer import parse_viewer

    if (options.fleet is None) == (options.robot is None):
        raise InputError("expected either FLEET.toml, or --robot NAME=LOG for each robot")
    if options.fleet is not None:
        robots, config = read_fleet(options.fleet)
    else:
        robots, config = robots_of(options.robot), FleetConfig()
    said = {"every_keyframes": options.every, "processes": options.processes, "for_s": options.most_s}
    config = replace(config, **{name: value for name, value in said.items() if value is not None})
    settings = read_settings(options)
    plan = FleetPlan(
        robots=robots,
        config=config,
        out=options.out,
        overwrite=options.overwrite,
        resumes=options.resume,
        mapper=settings.mapper,
        disk=settings.disk,
        rerun=settings.rerun,
        viewer=parse_viewer(options.viewer),
        debug=options.debug,
        anyway=options.anyway,
    )
    printer = ProgressPrinter(make_style(options), part=f"{len(robots)} robots")
    try:
        result = run_fleet(plan, _Watcher(printer, [robot.name for robot in robots], as_json=options.json))
    finally:
        printer.close()
    report = result_json(result, options.out)
    with disk_refusals(options.out / "fleet.json", "result"):
        write_output(options.out / "fleet.json", output("fleet", report, indent=1).encode())
    if options.json:
        print(output("fleet", report, indent=1))
    else:
        print(result_text(result))
        for merged in result.merged:
            print(f"{merged.path}: {merged.num_objects} objects, {merged.num_united} of them in several robots' maps")
        print(f"{plan.rrd}: the robots on a timeline")
        sys.stderr.writelines(f"{line}\n" for line in _notes(result))
    if result.was_stopped:
        return STOPPED
    return 0 if result.is_whole else INCOMPLETE


class _Watcher:
    def __init__(self, printer: ProgressPrinter, names: Sequence[str], *, as_json: bool) -> None:
        self._printer = printer
        self._as_json = as_json
        self._at: dict[str, Progress] = {}
        self._names = names

    def opened(self, name: str, lines: Sequence[str]) -> None:
        if not self._as_json:
            sys.stderr.writelines(f"{name}: {line}\n" for line in lines)

    def moved(self, name: str, progress: Progress) -> None:
        from dataclasses import replace

        self._at[name] = progress
        known = [self._at[name] for name in self._names if name in self._at]
        totals = [one.total for one in known]
        is_known = len(known) == len(self._names) and None not in totals
        phases = {one.phase for one in known}
        self._printer(
            replace(
                progress,
                phase=progress.phase if len(phases) == 1 or progress.phase == "compiling" else "playing",
                total=sum(total for total in totals if total is not None) if is_known else None,
                **{name: sum(getattr(one, name) for one in known) for name in _SUMMED},
            )
        )

    def said(self, text: str) -> None:
        report = output("fleet-said", {"event": "said", "text": text}) if self._as_json else text
        sys.stderr.write(f"{report}\n")


def result_text(result: FleetResult) -> str:
    """Return a table of the robots."""
    import numpy as np

    rows = [("robot", "keyframes", "objects", "joined with", "pairs", "sigma", "since keyframe")]
    for robot in result.robots:
        first = (robot.name, str(robot.num_keyframes), str(robot.num_objects))
        if not robot.joined:
            rows.append((*first, "-", "", "", ""))
        for i, one in enumerate(robot.joined):
            sigma = f"{100 * one.sigma_m:.1f} cm, {np.degrees(one.sigma_rad):.2f} deg"
            since = "the end" if one.since_keyframe is None else str(one.since_keyframe)
            rows.append((*(first if i == 0 else ("", "", "")), one.name, str(one.num_pairs), sigma, since))
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    lines += [f"{robot.name} is in no other robot's frame: {robot.reason}" for robot in result.robots if robot.reason]
    return "\n".join(lines)


def _notes(result: FleetResult) -> list[str]:
    lines = [f"{robot.name}: {note}" for robot in result.robots for note in robot.notes]
    unfinished = [robot.name for robot in result.robots if not robot.is_finished and robot.map is not None]
    if unfinished:
        lines.append(f"{', '.join(unfinished)}: continue with the same command and --resume")
    return [*lines, *(f"note: {note}" for note in result.notes)]


def result_json(result: FleetResult, out: Path) -> dict[str, Any]:
    """Return the result as JSON data."""
    return {
        "event": "finished",
        "out": str(out),
        "joined": result.is_whole,
        "robots": [_robot_json(robot) for robot in result.robots],
        "merged": [merged.as_json("robots") for merged in result.merged],
        "joins": [
            {**picked(event, "keyframe", "kind", "a", "b", "a_from_b", "sigma_m"), "pairs": event.num_pairs}
            for event in result.events
        ],
        "notes": list(result.notes),
    }


def _robot_json(robot: RobotResult) -> dict[str, Any]:
    import numpy as np

    return {
        "name": robot.name,
        "map": None if robot.map is None else str(robot.map),
        "digest": robot.digest,
        "keyframes": robot.num_keyframes,
        "objects": robot.num_objects,
        "finished": robot.is_finished,
        "frame": robot.frame,
        "frame_from_robot": None if robot.frame_from_robot is None else robot.frame_from_robot.tolist(),
        "joined_with": [
            {
                "name": one.name,
                "pairs": one.num_pairs,
                "sigma_m": one.sigma_m,
                "sigma_deg": float(np.degrees(one.sigma_rad)),
                "since_keyframe": one.since_keyframe,
            }
            for one in robot.joined
        ],
        "reason": robot.reason,
        "notes": list(robot.notes),
    }
