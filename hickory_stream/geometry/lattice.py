"""The two voxel lattices of a map, of objects and of the observed space; perception and mapping share them."""

from __future__ import annotations

from dataclasses import dataclass

from hickory_stream.ranges import Ranged, number


@dataclass(frozen=True, kw_only=True, slots=True)
class Lattice(Ranged):
    """The sides of voxels, anchored at the world's origin.

    Attributes:
        points_m: of the points of objects: masks are lifted to means over these, and tracks keep one point in each; no
            box has lesser half extents.
        space_m: of the observed space, which rays pass through and structure fills.
    """

    points_m: float = number(0.01, 0.001, 1, "m")
    space_m: float = number(0.05, 0.005, 1, "m")
