"""Output files: `--overwrite` permits replacing a file, and a command names each file that it wrote."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from hickory_stream.errors import InputError

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from hickory_stream.pictures.drawing import Drawing


def add_output(command: argparse.ArgumentParser, *names: str, **options: Any) -> None:
    """Add an option for an output file; the first one of a command adds `--overwrite` too."""
    dest = command.add_argument(*names, **options).dest
    known = command.get_default("outputs") or ()
    command.set_defaults(outputs=(*known, dest))
    if not any("--overwrite" in action.option_strings for action in command._actions):
        command.add_argument("--overwrite", action="store_true", help="replace existing files")


def outputs_of(options: argparse.Namespace) -> list[Path]:
    """Return the output files of the options."""
    named = (getattr(options, dest) for dest in getattr(options, "outputs", ()))
    return [path for path in named if path is not None]


def check_ending(path: Path | None, *endings: str) -> None:
    """Raise `InputError` for an output file with another ending."""
    if path is not None and path.suffix.lower() not in endings:
        raise InputError(f"found -o {path}, expected a name that ends in {' or '.join(endings)}")


def refuse_taken(paths: Iterable[Path], *, overwrite: bool) -> None:
    """Raise `InputError` if a file exists and may not be replaced; pipes and devices may."""
    for path in paths:
        if path.is_file() and not overwrite:
            raise InputError(f"{path} exists; replace it with --overwrite, or choose another name")


@contextmanager
def disk_refusals(path: Path, what: str) -> Iterator[None]:
    """Turn an `OSError` within the block into an `InputError` that names the file and the cause."""
    try:
        yield
    except OSError as error:
        raise InputError(f"cannot write the {what} {path}: {error.strerror}") from error


def write_picture(path: Path, picture: NDArray[np.uint8]) -> None:
    """Write an (H, W, 3) RGB picture as PNG; raises `InputError` on a disk error."""
    import cv2

    from hickory_stream.base.atomic_files import write_output

    with disk_refusals(path, "picture"):
        write_output(path, cv2.imencode(".png", picture[..., ::-1])[1].tobytes())


def write_drawing(path: Path, drawing: Drawing) -> None:
    """Write a drawing as SVG if the name ends in .svg, else as PNG; raises `InputError` on a disk error."""
    from hickory_stream.base.atomic_files import write_output

    if path.suffix.lower() != ".svg":
        write_picture(path, drawing.image())
        return
    with disk_refusals(path, "drawing"):
        write_output(path, drawing.svg().encode())


def written_text(path: Path) -> str:
    """Return the line about a file that was written."""
    size = path.stat().st_size
    large = f"{size / 1024:.1f} KiB" if size < 1024**2 else f"{size / 1024**2:.2f} MiB"
    return f"{path}: {size} bytes" if size < 1024 else f"{path}: {large}"
