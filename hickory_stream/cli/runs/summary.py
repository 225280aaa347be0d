"""The summary of a run that has ended: its map, failed shapes and incomplete outputs."""

from __future__ import annotations

import shlex
import sys
from dataclasses import asdict
from typing import TYPE_CHECKING

from hickory_stream.cli.commands import INCOMPLETE, STOPPED
from hickory_stream.cli.option_values import resume_command
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse
    from pathlib import Path

    from hickory_stream.engine.play import Played
    from hickory_stream.engine.shape_jobs.job_folder import FailedShapes

_IDS_LISTED = 5


def finish(options: argparse.Namespace, out: Path, played: Played) -> int:
    """Print the summary of a run, and return the exit status."""
    from hickory_stream.engine.shape_jobs.job_folder import failed_shapes
    from hickory_stream.inspection.graph_summary import summary_of, summary_text
    from hickory_stream.map_folder.history.candidates import candidates_of, why_no_objects
    from hickory_stream.map_folder.history.registration_history import registration_summary
    from hickory_stream.map_folder.manifest import read_json, read_manifest
    from hickory_stream.mapping.floor_warnings import floor_warnings
    from players.doctor.report import damage_line, ledger_table

    objects = played.snapshot.objects if played.snapshot is not None else ()
    num_shaped = sum(tracked.shape is not None for tracked in objects)
    failures = failed_shapes(out, [tracked.id for tracked in objects if tracked.shape is None])
    ledger = read_json(out, "ledger.json")
    registration = registration_summary(out, ledger)
    candidates = candidates_of(out, {tracked.id for tracked in objects})
    goes_on = not played.finished_cleanly and read_manifest(out).run.get("mode") != "live"
    notes = floor_warnings(played.snapshot) if played.snapshot is not None else ()
    if registration is not None and registration.warning():
        notes = (*notes, registration.warning())
    if not objects:
        notes = (*notes, why_no_objects(ledger, candidates))
    if options.json:
        said = {
            "event": "finished",
            "map": str(out),
            "finished_cleanly": played.finished_cleanly,
            **({"resume": resume_command(out)} if goes_on else {}),
            "is_reproducible": played.is_reproducible,
            "processor": played.processor or None,
            "digest": played.digest,
            "objects": len(objects),
            "objects_with_shape": num_shaped,
            "failed_shapes": [
                {"reason": one.reason, "objects": list(one.object_ids), "inputs": list(map(str, one.folders))}
                for one in failures
            ],
            "lost_outputs": list(played.lost_outputs),
            "damage": damage_line(ledger),
            "notes": list(notes),
            "registration": None if registration is None else asdict(registration),
            "candidates": None if candidates is None else asdict(candidates),
            "ledger": ledger,
        }
        print(output("play", said))
    else:
        print(f"{out}: {len(objects)} objects, {num_shaped} with all four layers")
        if candidates is not None and objects:
            print(candidates.text())
        if played.is_reproducible and played.processor:
            print(f"reproducible on this kind of processor: {played.processor}")
        if ledger.get("messages"):
            print(ledger_table(ledger["messages"]))
        if not played.finished_cleanly:
            how = f"continue with: {resume_command(out)}" if goes_on else "a live run cannot be continued"
            print(f"stopped, and saved; {how}")
        if registration is not None and registration.text():
            print(registration.text())
        if played.snapshot is not None and played.snapshot.graph is not None:
            print(summary_text(summary_of(played.snapshot.graph)))
        lines = (*notes, damage_line(ledger), failures_line(failures, len(objects)), *played.lost_outputs)
        sys.stdout.flush()
        sys.stderr.writelines(f"{line}\n" for line in lines if line)
        if objects and getattr(options, "suggests", True):
            print("look at it with:", *_looks(out, getattr(options, "rrd", None)), sep="\n  ")
    if played.was_stopped:
        return STOPPED
    return INCOMPLETE if played.lost_outputs or (num_shaped == 0 and (failures or not objects)) else 0


def _looks(out: Path, rrd: Path | None) -> list[str]:
    # The next commands for a map: a table, a picture and the run on a timeline.
    name, picture, timeline = (
        shlex.quote(str(p)) for p in (out, out.with_suffix(".png"), rrd or out.with_suffix(".rrd"))
    )
    made = "" if rrd is not None else f"hickory-stream replay {name} --rrd {timeline} && "
    return [
        f"hickory-stream inspect {name}",
        f"hickory-stream render {name} -o {picture}",
        f"{made}rerun --bind 127.0.0.1 {timeline}",
    ]


def failures_line(failures: tuple[FailedShapes, ...], num_objects: int) -> str:
    """Return how many objects lack a shape because their jobs failed, and why; "" if none does."""
    if not failures:
        return ""
    number = sum(len(failure.object_ids) for failure in failures)
    reasons = "; ".join(f"{len(failure.object_ids)} x {failure.reason} ({_ids(failure)})" for failure in failures)
    first = failures[0].folders[0]
    return (
        f"the shape jobs of {number} of {num_objects} objects failed: {reasons}. Their input lies in {first.parent}; "
        f"repeat one with `hickory-stream reconstruct {first}`"
    )


def _ids(failure: FailedShapes) -> str:
    ids = ", ".join(str(object_id) for object_id in failure.object_ids[:_IDS_LISTED])
    more = len(failure.object_ids) - _IDS_LISTED
    noun = "object" if len(failure.object_ids) == 1 else "objects"
    return f"{noun} {ids}" + (f" and {more} more" if more > 0 else "")
