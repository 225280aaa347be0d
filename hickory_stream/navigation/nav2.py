"""The grid format of Nav2's map_server: a PGM picture, and a YAML file with its pose and grey values.

Row 0 of the picture is at the largest y. The grey values are those of map_saver. The file sets free_thresh to 0.196,
since with Nav2's default of 0.25 unknown cells would be free.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.errors import InputError
from hickory_stream.navigation.occupancy import Cell, GridFrame

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196
_GREY = {Cell.FREE: 254, Cell.UNKNOWN: 205, Cell.OCCUPIED: 0}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ServedMap:
    """The map that map_server would publish: (rows, columns) int8 states as `Cell`, and their pose."""

    states: NDArray[np.int8]
    frame: GridFrame


def pgm_of(states: NDArray[np.int8]) -> bytes:
    """Return (rows, columns) states as a binary PGM."""
    grey = np.full(states.shape, _GREY[Cell.UNKNOWN], np.uint8)
    for cell, value in _GREY.items():
        grey[states == cell] = value
    rows, columns = states.shape
    return b"P5\n%d %d\n255\n" % (columns, rows) + np.ascontiguousarray(grey[::-1]).tobytes()


def yaml_of(frame: GridFrame, image: str) -> str:
    """Return the YAML that belongs to the picture of that name."""
    x, y = (float(value) for value in frame.origin_m)
    return (
        f"image: {image}\nmode: trinary\nresolution: {frame.cell_m!r}\norigin: [{x!r}, {y!r}, 0.0]\nnegate: 0\n"
        f"occupied_thresh: {OCCUPIED_THRESH}\nfree_thresh: {FREE_THRESH}\n"
    )


def read_served_map(yaml_path: Path) -> ServedMap:
    """Return a map as map_server would serve it, in its mode `trinary`.

    Raises:
        InputError: a file is missing, or not in the format of map_server.
    """
    try:
        found = _parsed(yaml_path.read_text(encoding="utf-8"))
        image = (yaml_path.parent / str(found["image"])).read_bytes()
        grey = _picture(image)
        negate, mode = int(found["negate"]), str(found.get("mode", "trinary"))
        occupied, free = float(found["occupied_thresh"]), float(found["free_thresh"])
        x, y, _ = (float(part) for part in found["origin"].strip("[]").split(","))
        cell_m = float(found["resolution"])
    except (OSError, KeyError, ValueError) as error:
        raise InputError(f"{yaml_path} is no map of map_server: {error!r}") from error
    if mode != "trinary":
        raise InputError(f"{yaml_path} has the mode {mode}; only trinary is read")
    # The occupancy of a pixel: dark is occupied, unless negated.
    chance = grey / 255.0 if negate else (255.0 - grey) / 255.0
    states = np.full(grey.shape, Cell.UNKNOWN, np.int8)
    states[chance > occupied] = Cell.OCCUPIED
    states[chance < free] = Cell.FREE
    rows, columns = grey.shape
    frame = GridFrame(origin_m=np.array([x, y]), cell_m=cell_m, rows=rows, columns=columns)
    return ServedMap(states=states[::-1].copy(), frame=frame)


def _parsed(text: str) -> dict[str, str]:
    lines = (line.split("#", 1)[0] for line in text.splitlines())
    pairs = (line.split(":", 1) for line in lines if ":" in line)
    return {key.strip(): value.strip() for key, value in pairs}


def _picture(data: bytes) -> NDArray[np.uint8]:
    import cv2

    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise ValueError("the picture cannot be decoded")
    return np.asarray(image)
