"""The grid format of Nav2's map_server: a PGM picture, and a YAML file with its pose and grey values.

Row 0 of the picture is at the largest y. The grey values are those of map_saver. The file sets free_thresh to 0.196,
since with Nav2's default of 0.25 unknown cells would be free.
"""

import numpy as np
from numpy.typing import NDArray

from hickory_stream.navigation.occupancy import Cell, GridFrame

OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196
_GREY = {Cell.FREE: 254, Cell.UNKNOWN: 205, Cell.OCCUPIED: 0}


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
