"""`hickory-stream merge`: combine several maps into one."""

import argparse
import sys
from pathlib import Path

from hickory_stream.cli.commands import NO_ALIGNMENT, Commands
from hickory_stream.errors import InputError
from hickory_stream.outputs import output


def add(commands: Commands) -> None:
    merge = commands.add("merge", run)
    merge.add_argument("maps", type=Path, metavar="A B", nargs="+", help="maps; the first merged one defines the frame")
    merge.add_argument("-o", "--out", type=Path, required=True, metavar="MAP", help="map folder to write")
    merge.add_argument("--overwrite", action="store_true", help="replace an existing map")


def run(options: argparse.Namespace) -> int:
    from hickory_stream.cli.maps.align import named_maps
    from hickory_stream.cli.option_values import open_map_at
    from hickory_stream.engine.merged_map import outcome_text, write_merged_map
    from hickory_stream.map_folder.saved_map import check_unaltered
    from hickory_stream.merging.merge_maps import merge_maps

    paths: list[Path] = options.maps
    if len(paths) < 2:
        raise InputError(f"found {len(paths)} map, expected at least two: merge A B [C ...] -o MAP")
    resolved = [path.resolve() for path in paths]
    if twice := next((path for path, at in zip(paths, resolved, strict=True) if resolved.count(at) > 1), None):
        raise InputError(f"{twice} is given twice, expected different maps")
    if options.out.resolve() in resolved:
        raise InputError(f"-o {options.out} is one of the inputs; choose another folder")
    inputs = [open_map_at(path, warns=False) for path in paths]
    for saved in inputs:
        # Their certificates are copied into the merged map.
        check_unaltered(saved)
    quiet = options.json

    def tell(text: str) -> None:
        if not quiet:
            sys.stderr.write(f"{text}\n")

    merged = merge_maps(
        [saved.snapshot for saved in inputs],
        extractors=[saved.manifest.extractor for saved in inputs],
        progress=lambda a, b: tell(f"aligning {paths[a]} and {paths[b]}"),
    )
    outcomes = [
        {
            "a": str(paths[pair.a]),
            "b": str(paths[pair.b]),
            "believed": pair.is_believed,
            "outcome": named_maps(outcome_text(pair), str(paths[pair.a]), str(paths[pair.b])),
        }
        for pair in merged.pairs
    ]
    left_out = [str(paths[i]) for i in merged.left_out]
    is_any = len(left_out) < len(paths) - 1
    result = {"merged": is_any, "map": str(options.out), "pairs": outcomes, "left_out": left_out}
    if is_any:
        manifest = write_merged_map(
            options.out,
            merged,
            inputs,
            overwrite=options.overwrite,
            progress=lambda done, total: tell(f"shapes rebuilt: {done} of {total}"),
        )
        both = sum(len(group) > 1 for group in merged.provenance.values())
        result |= {"objects": len(merged.objects), "united": both, "digest": manifest.digest}
    if options.json:
        print(output("merge", result, indent=1))
    else:
        for outcome in outcomes:
            print(f"{outcome['a']} and {outcome['b']}: {outcome['outcome']}")
        for path in left_out if is_any else ():
            print(f"{path} was left out: it aligns with none of the merged maps")
        print(f"{options.out}: {result['objects']} objects, {result['united']} of them in several maps" if is_any else
              "nothing was merged")  # fmt: skip
    return 0 if is_any else NO_ALIGNMENT
