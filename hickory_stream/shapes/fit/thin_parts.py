"""Thin parts that the fit left out, such as a bin's rim or a chair's rods: little volume, yet seen.

The surface outside of all primitives is cut like thin bodies (`panels`). A part is a few cells thick, and its surface
goes once around its box: a bulge's lies on one side, a pipe's goes round twice.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry.superquadric import Superquadrics, joined
from hickory_stream.shapes.fit.panels import areas_of, loose_panels
from hickory_stream.shapes.fit.quadric_lm import rows_in
from hickory_stream.shapes.fit.surface_partition import owned_pieces

if TYPE_CHECKING:
    from numpy.typing import NDArray

# In cells: how far outside a surface is left out, how fine it is divided, and how thick a thin part is at most.
_OUTSIDE, _PIECE, _THIN = 1.5, 3.0, 3.0
# The surface of a part over that of its box.
_ROUND = (0.7, 1.4)


def with_thin_parts(
    primitives: Superquadrics,
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    *,
    step_m: float,
    most: int,
    least_area: float,
) -> Superquadrics:
    """Return the primitives, up to `most` in all with those for thin parts of (V, 3) vertices with (F, 3) faces.

    `step_m` is the side of the fit's cells; a part has at least the share `least_area` of the surface.
    """
    rows = rows_in(primitives, step_m, np.zeros(3))
    points, pieces, _, distances = owned_pieces(vertices / step_m, faces.astype(np.int64), rows, _OUTSIDE, _PIECE)
    pieces = pieces[distances > _OUTSIDE].astype(np.int32)
    if len(pieces) == 0 or len(primitives) >= most:
        return primitives
    total = float(areas_of(vertices[faces]).sum())
    found = []
    for panel, area_m2 in loose_panels(
        points * step_m, pieces, least_area=least_area * total, min_size_m=0.1 * step_m, thin_m=_THIN * step_m
    ):
        sides = 2 * panel.semi_axes_m[0]
        around = 2 * (sides[0] * sides[1] + sides[1] * sides[2] + sides[2] * sides[0])
        if sides.min() <= _THIN * step_m and _ROUND[0] <= area_m2 / around <= _ROUND[1]:
            found.append((area_m2, panel))
    found.sort(key=lambda one: -one[0])
    return joined([primitives, *(panel for _, panel in found[: most - len(primitives)])])
