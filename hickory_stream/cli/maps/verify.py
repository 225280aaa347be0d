"""`hickory-stream verify`: check the seals and proofs of a map."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hickory_stream.base.terminal import clear_line
from hickory_stream.cli.commands import NOT_SOUND, Commands
from hickory_stream.outputs import output, picked

if TYPE_CHECKING:
    import argparse

    from hickory_stream.map_folder.verify import Verdict


def add(commands: Commands) -> None:
    verify = commands.add("verify", run)
    verify.add_argument("map", type=Path, metavar="MAP")
    verify.add_argument(
        "--repair",
        action="store_true",
        help="first restore objects.json from the journal, if the digest matches the manifest",
    )


def run(options: argparse.Namespace) -> int:
    from hickory_stream.map_folder.verify import verify

    is_told = not options.json and sys.stderr.isatty()
    is_mended = options.repair and _mend(options.map)
    verdict = verify(options.map, tell if is_told else lambda _: None)
    if is_told:
        tell("")
    if options.json:
        print(output("verify", _as_json(options.map, verdict, is_mended=is_mended), indent=1))
    else:
        mended = [f"{options.map}: objects.json was restored from the journal"] if is_mended else []
        print("\n".join([*mended, *_as_lines(options.map, verdict)]))
    return 0 if verdict.is_sound else NOT_SOUND


def _mend(path: Path) -> bool:
    from hickory_stream.errors import MapFolderError
    from hickory_stream.map_folder.saved_map import open_map
    from hickory_stream.map_folder.verify import mend

    try:
        if not open_map(path, warns=False).is_altered:
            return False
    except MapFolderError:
        pass  # `verify` reports it, unless it is mended
    mend(path)
    return True


def tell(what: str) -> None:
    """Replace the progress line on a terminal."""
    clear_line()
    sys.stderr.write(what)
    sys.stderr.flush()


def _as_json(path: Path, verdict: Verdict, *, is_mended: bool) -> dict[str, Any]:
    return {
        "event": "verified",
        "map": str(path),
        "is_sound": verdict.is_sound,
        "is_mended": is_mended,
        **picked(verdict, "digest", "recorded_digest", "num_objects", "num_proven"),
        "findings": [asdict(finding) for finding in verdict.findings],
    }


def _as_lines(path: Path, verdict: Verdict) -> list[str]:
    from hickory_stream.map_folder.verify import State

    lines = []
    for finding in verdict.findings:
        if finding.object_id is None:
            lines.append(f"{finding.check:<8} {finding.state:<8} {finding.text}")
        elif finding.state is not State.HOLDS:
            lines.append(f"{finding.check:<8} {finding.state:<8} object {finding.object_id}: {finding.text}")
    failed = sum(finding.state is State.FAILS for finding in verdict.findings)
    text = "sound" if verdict.is_sound else f"NOT SOUND, {failed} {'finding' if failed == 1 else 'findings'} against it"
    proven = f"layer 4 of {verdict.num_proven} of {verdict.num_objects} objects proven again"
    return [*lines, f"{path}: {text}; {proven}"]
