"""`hickory-stream relocalise`: locate a running log in a stored map."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hickory_stream.cli.commands import NO_ALIGNMENT, Commands
from hickory_stream.cli.option_values import add_stationarity, movable_objects, parse_rate, read_settings
from hickory_stream.cli.source_options import add_source_options, source_options
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse

    from hickory_stream.engine.relocalise import Located


def add(commands: Commands) -> None:
    relocalise = commands.add("relocalise", run, configured=True)
    relocalise.add_argument("map", type=Path, metavar="MAP")
    relocalise.add_argument("source", metavar="LOG", help="log as for play")
    relocalise.add_argument("--rate", default="max", help="max (default), or a factor of real time, e.g. 1.0")
    relocalise.add_argument("--until-found", action="store_true", help="stop at the first confirmed position")
    add_stationarity(relocalise)
    add_source_options(relocalise)


def run(options: argparse.Namespace) -> int:
    from hickory_stream.cli.maps.align import objects_of
    from hickory_stream.cli.option_values import open_map_at
    from hickory_stream.engine.relocalise import relocalise, without
    from players import open_source

    settings = read_settings(options)
    rate = parse_rate(options.rate)
    saved = open_map_at(options.map)
    stored = without(objects_of(saved), movable_objects(options.stationarity, saved))
    source = open_source(options.source, source_options(options))
    start_ns = source.info.start_ns

    state: object = None

    def report(located: Located) -> None:
        nonlocal state
        if options.json:
            print(output("relocalise", _as_json(located)), flush=True)
            return
        before, state = state, (getattr(located.answer, "refusal", None), located.is_confirmed, located.has_jumped)
        if state != before:
            sys.stderr.write(f"{_as_text(located, start_ns)}\n")

    try:
        last = relocalise(
            stored, source, settings.mapper, rate=rate, stops_when_found=options.until_found, report=report
        )
    finally:
        source.close()
    is_found = last is not None and last.is_confirmed
    if not options.json:
        reason = "the log gave no keyframe" if last is None else _state_of(last)
        print(_as_text(last, start_ns) if last is not None and is_found else f"not found in the map: {reason}")
    return 0 if is_found else NO_ALIGNMENT


def _as_json(located: Located) -> dict[str, Any]:
    from hickory_stream.alignment.answer import Alignment

    report: dict[str, Any] = {
        "event": "located" if isinstance(located.answer, Alignment) else "searching",
        "stamp_ns": located.stamp_ns,
        "objects": located.num_objects,
        "confirmed": located.is_confirmed,
        "jumped": located.has_jumped,
    }
    if isinstance(located.answer, Alignment):
        return report | {
            "map_from_log": located.answer.a_from_b.tolist(),
            "pairs": len(located.answer.pairs),
            "translation_sigma_m": located.answer.translation_sigma_m,
            "log10_chance": located.answer.log10_chance,
        }
    return report | {"refusal": located.answer.refusal.value, "reason": located.answer.reason}


def _as_text(located: Located, start_ns: int | None) -> str:
    from hickory_stream.alignment.answer import Alignment, count_text
    from hickory_stream.cli.maps.align import pose_text

    answer, when = located.answer, f"{(located.stamp_ns - (start_ns or 0)) / 1e9:.1f} s, {located.num_objects} objects"
    if not isinstance(answer, Alignment):
        return f"{when}: searching, {_state_of(located)}"
    at, turned = pose_text(answer.a_from_b)
    return (
        f"{when}: the log starts at {at}, {turned}; {len(answer.pairs)} pairs, "
        f"{count_text(answer.log10_chance)} such sets expected by chance, {_state_of(located)}"
    )


def _state_of(located: Located) -> str:
    from hickory_stream.alignment.answer import NoAlignment
    from hickory_stream.cli.maps.align import named_maps

    if isinstance(located.answer, NoAlignment):
        return named_maps(located.answer.reason, "the map", "the log so far")
    if located.is_confirmed:
        return "confirmed"
    return "differs from the answer before" if located.has_jumped else "first answer, not confirmed"
