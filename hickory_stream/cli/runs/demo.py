"""`hickory-stream demo`: make a small recording, map it and draw the map."""

import argparse
import shutil
import sys
from pathlib import Path

from hickory_stream.cli.commands import Commands
from hickory_stream.errors import InputError
from hickory_stream.outputs import output

_NAME = "room"
# Files of `make_recording`, and of the steps after.
_PARTS = (f"{_NAME}.mcap", f"{_NAME}.truth", "map", "map.png", "map-superquadrics.png")
_EVERY = 12


def add(commands: Commands) -> None:
    demo = commands.add("demo", run)
    demo.add_argument("--out", type=Path, default=Path("hickory-demo"), metavar="DIR", help="(default: hickory-demo)")
    demo.add_argument("--seconds", type=float, default=8.0, metavar="S", help="length of the recording (default: 8)")
    demo.add_argument("--seed", type=int, default=7, help="seed of the room (default: 7)")
    demo.add_argument("--overwrite", action="store_true", help="replace the files of an earlier demo")


def run(options: argparse.Namespace) -> int:
    folder: Path = options.out
    _make_room(folder, is_overwritten=options.overwrite)
    log, saved = folder / f"{_NAME}.mcap", folder / "map"
    _record(options, folder)
    as_json = ["--json"] if options.json else []
    pictures = {"1,2": folder / "map.png", "3,4": folder / "map-superquadrics.png"}
    steps = [
        ["play", str(log), "--out", str(saved), "--viewer", "none", *as_json],
        *([] if options.json else [["inspect", str(saved)]]),
        *(["render", str(saved), "--layers", layers, "-o", str(path), *as_json] for layers, path in pictures.items()),
    ]
    for step in steps:
        chosen = options.parser.parse_args(step)
        chosen.suggests = False
        status: int = chosen.run(chosen)
        if status:
            return status
    if options.json:
        made = {"log": str(log), "map": str(saved), "pictures": [str(path) for path in pictures.values()]}
        print(output("demo", made))
    else:
        print(
            f"\nthe recording  {log}\nthe map        {saved}\nits pictures   {'  '.join(map(str, pictures.values()))}"
        )
    return 0


def _make_room(folder: Path, *, is_overwritten: bool) -> None:
    # Removes the parts of an earlier demo if permitted, and no other file.
    there = [folder / name for name in _PARTS if (folder / name).exists()]
    if there and not is_overwritten:
        raise InputError(f"{there[0]} exists; replace it with --overwrite, or choose another --out")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path in there:
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink()
    except OSError as error:
        raise InputError(f"cannot write into {folder}: {error.strerror}; choose another --out") from error


def _record(options: argparse.Namespace, folder: Path) -> None:
    from hickory_stream.worlds.recording import make_recording
    from hickory_stream.worlds.recording_config import RecordingConfig

    def progress(done: int, total: int) -> None:
        if options.json or not (done % _EVERY == 0 or done == total):
            return
        sys.stderr.write(f"recording a synthetic room: {done} of {total} images\n")

    config = RecordingConfig(seed=options.seed, seconds=options.seconds)
    try:
        make_recording(config, folder, _NAME, progress, caster=None)
    except OSError as error:
        raise InputError(f"cannot write into {folder}: {error.strerror}; choose another --out") from error
