"""`hickory-stream align`: find where two maps overlap, or say why none was found."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hickory_stream.cli.commands import NO_ALIGNMENT, Commands
from hickory_stream.cli.output_files import add_output, check_ending, disk_refusals, write_picture
from hickory_stream.outputs import output, picked

if TYPE_CHECKING:
    import argparse

    import numpy as np
    from numpy.typing import NDArray

    from hickory_stream.alignment.answer import Alignment, NoAlignment, Rival
    from hickory_stream.alignment.object_map import ObjectMap
    from hickory_stream.map_folder.saved_map import SavedMap

METHODS = ("sq", "sq-paper", "bbox", "roman-one", "roman-xl", "semantic")


def add(commands: Commands) -> None:
    align = commands.add("align", run)
    align.add_argument("a", type=Path, metavar="A", help="the map that defines the frame of the answer")
    align.add_argument("b", type=Path, metavar="B")
    align.add_argument("--method", choices=METHODS, default="sq", help="sq (default), or another method for comparison")
    add_output(align, "-o", "--out", type=Path, metavar="PNG|RRD", help="draw both maps joined by their pairs")


def run(options: argparse.Namespace) -> int:
    from hickory_stream.alignment.answer import Alignment
    from hickory_stream.alignment.methods import align_by

    check_ending(options.out, ".png", ".rrd")
    map_a, map_b = load_objects(options.a), load_objects(options.b)
    answer = align_by(options.method, map_a, map_b)
    if options.out is not None:
        _draw(options.out, map_a, map_b, answer)
    print(output("align", answer_json(answer), indent=1) if options.json else answer_text(answer))
    return 0 if isinstance(answer, Alignment) else NO_ALIGNMENT


def load_objects(folder: Path) -> ObjectMap:
    """Return the objects of a map folder; raises `MapFolderError`."""
    from hickory_stream.cli.option_values import open_map_at

    return objects_of(open_map_at(folder))


def objects_of(saved: SavedMap) -> ObjectMap:
    """Return the objects of an opened map, with the name of their feature extractor."""
    from hickory_stream.alignment.object_map import object_map

    return object_map(saved.snapshot, saved.manifest.extractor)


def answer_json(answer: Alignment | NoAlignment) -> dict[str, Any]:
    """Return an answer as JSON data."""
    import numpy as np

    from hickory_stream.alignment.answer import Alignment

    against = answer.contradictions
    report: dict[str, Any] = {
        "aligned": isinstance(answer, Alignment),
        "notes": list(answer.notes),
        "expected": against.num_expected,
        "missing": against.num_missing,
        "missing_in_b": list(against.ids_a),
        "missing_in_a": list(against.ids_b),
        "rivals": [
            picked(rival, "a_from_b", "covariance", "center_a", "num_pairs", "log10_chance", "margin")
            for rival in answer.rivals
        ],
    }
    if isinstance(answer, Alignment):
        return report | {
            **picked(answer, "a_from_b", "covariance", "center_a", "translation_sigma_m"),
            "rotation_sigma_deg": float(np.degrees(answer.rotation_sigma_rad)),
            **picked(answer, "log10_chance", "margin", "is_level", "is_refined", "is_weak"),
            "pairs": [
                {"a": pair.id_a, "b": pair.id_b, **picked(pair, "semantic", "geometric", "rank", "residual_m")}
                for pair in answer.pairs
            ],
        }
    return report | {
        "refusal": answer.refusal.value,
        "reason": answer.reason,
        "hypotheses": [
            {
                "a_from_b": hypothesis.a_from_b.tolist(),
                "num_pairs": len(hypothesis.pairs),
                "log10_chance": hypothesis.log10_chance if np.isfinite(hypothesis.log10_chance) else None,
            }
            for hypothesis in answer.hypotheses
        ],
    }


def answer_text(answer: Alignment | NoAlignment) -> str:
    """Return an answer as text."""
    import numpy as np

    from hickory_stream.alignment.answer import SURE_LOG10_CHANCE, Alignment, count_text

    notes = [f"note: {note}" for note in answer.notes]
    if not isinstance(answer, Alignment):
        tried = [
            f"  hypothesis: {len(h.pairs)} pairs, {count_text(h.log10_chance)} such sets expected by chance"
            for h in answer.hypotheses[:3]
            if np.isfinite(h.log10_chance)
        ]
        if answer.rivals:
            tried = ["  one of these may be right:", *map(_rival_text, answer.rivals)]
        return "\n".join([f"not aligned ({answer.refusal.value}): {answer.reason}", *tried, *notes])
    against = answer.contradictions
    lines = [
        f"aligned by {len(answer.pairs)} pairs: {_place_text(answer.a_from_b)}",
        f"  uncertainty {100 * answer.translation_sigma_m:.1f} cm, {np.degrees(answer.rotation_sigma_rad):.2f} deg"
        f"{', refined on surfaces' if answer.is_refined else ''}{'' if answer.is_level else ', maps tilted'}",
        f"  {count_text(answer.log10_chance)} such sets of pairs expected by chance; {_separation_text(answer)}",
        f"  of {against.num_expected} objects in observed places of the other map, {against.num_missing} are missing",
    ]
    if answer.is_weak:
        limit = count_text(SURE_LOG10_CHANCE)
        lines.append(
            f"  weak: other places that look alike may agree as well; `merge` accepts at most {limit} such sets"
        )
    return "\n".join([*lines, *notes])


def named_maps(reason: str, a: str, b: str) -> str:
    """Return a reason with names for `map a` and `map b`."""
    return re.sub(r"\bmap ([ab])\b", lambda found: {"a": a, "b": b}[found[1]], reason)


def pose_text(a_from_b: NDArray[np.float64]) -> tuple[str, str]:
    """Return the position and the turn about the vertical as text."""
    import numpy as np

    # Rounded first: 0.0 added to a rounded -0.0 has no sign.
    x, y, z = np.round(a_from_b[:3, 3], 3) + 0.0
    yaw_deg = np.round(np.degrees(np.arctan2(a_from_b[1, 0], a_from_b[0, 0])), 2) + 0.0
    return f"({x:.3f}, {y:.3f}, {z:.3f}) m", f"turned by {yaw_deg:.2f} deg"


def _place_text(a_from_b: NDArray[np.float64]) -> str:
    at, turned = pose_text(a_from_b)
    return f"b lies at {at} in a, {turned}"


def _rival_text(rival: Rival) -> str:
    from hickory_stream.alignment.answer import count_text

    by_chance = f"{count_text(rival.log10_chance)} such sets expected by chance"
    return f"    {_place_text(rival.a_from_b)}: {rival.num_pairs} pairs, {by_chance}"


def _separation_text(answer: Alignment) -> str:
    if not answer.rivals:
        return "no other transform is significant"
    return f"{len(answer.rivals)} others are ruled out, the closest by {answer.margin:.1f} decades"


def _draw(path: Path, map_a: ObjectMap, map_b: ObjectMap, answer: Alignment | NoAlignment) -> None:
    from hickory_stream.pictures.render_alignment import render_alignment
    from hickory_stream.sinks.rerun.alignment import write_alignment

    if path.suffix == ".rrd":
        with disk_refusals(path, "picture"):
            write_alignment(path, map_a, map_b, answer)
    else:
        write_picture(path, render_alignment(map_a, map_b, answer))
