"""Occupancy in three dimensions, for robots that change their height, and for the height to which they must lower.

It consists of layers of voxels, each exact over its own height: a voxel is occupied if a body of the height of the
layer, with its centre anywhere in the closed square of the cell, may collide.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.errors import InputError
from hickory_stream.navigation.occupancy import MOST_BYTES, GridFrame, Occupancy
from hickory_stream.navigation.robot import Part

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.geometry.superquadric import Superquadrics

_BYTES_PER_VOXEL = 13


class VoxelOccupancy:
    """Voxels over the cells of a frame, from `low_m` up in layers of `layer_m`; updated object by object.

    `radius_m` is the radius of the round body whose configuration space the voxels are.
    """

    def __init__(
        self,
        frame: GridFrame,
        *,
        low_m: float,
        layer_m: float,
        num_layers: int,
        radius_m: float = 0.0,
        most_bytes: int = MOST_BYTES,
    ) -> None:
        if num_layers < 1 or not layer_m > 0:
            raise InputError(f"found {num_layers} layers of {layer_m} m, expected at least one of a height above 0")
        wanted = frame.rows * frame.columns * num_layers * _BYTES_PER_VOXEL
        if wanted > most_bytes:
            raise InputError(
                f"{num_layers} layers of {frame.columns} x {frame.rows} cells take {wanted / 2**20:,.0f} MiB, allowed "
                f"are {most_bytes / 2**20:,.0f}; use larger cells or layers"
            )
        self.low_m, self.layer_m = low_m, layer_m
        heights = low_m + layer_m * np.arange(num_layers + 1)
        self._layers = [
            Occupancy(frame, [Part(low_m=float(low), high_m=float(high), disc_m=radius_m)])
            for low, high in pairwise(heights)
        ]

    def put(self, object_id: int, inflated: Superquadrics) -> None:
        """Add an object, or replace its former shape; raises ValueError if a primitive is not finite."""
        for layer in self._layers:
            layer.put(object_id, inflated)

    def put_hulls(self, object_id: int, hulls: NDArray[np.float64]) -> None:
        """Add an object that is the union of the convex hulls of (N, M, 3) points, or replace its former shape."""
        for layer in self._layers:
            layer.put_hulls(object_id, hulls)

    def remove(self, object_id: int) -> None:
        """Remove an object, if it is there."""
        for layer in self._layers:
            layer.remove(object_id)

    def is_occupied(self) -> NDArray[np.bool_]:
        """Return (layers, rows, columns) which voxels are occupied."""
        return np.stack([layer.is_occupied() for layer in self._layers])

    def traversable_height_m(self) -> NDArray[np.float64]:
        """Return (rows, columns) the largest height of a body that stands on the lowest layer.

        In whole layers, rounded down; infinite if nothing is above.
        """
        occupied = self.is_occupied()
        first = occupied.argmax(axis=0)
        return np.where(occupied.any(axis=0), first * self.layer_m, np.inf)
