"""Example of an odometry: dead reckoning, which accumulates motion measured elsewhere, e.g. by wheel encoders."""

import numpy as np
from numpy.typing import NDArray
from hickory_stream.geometry.rigid import compose
from hickory_stream.ports import NotRegistered, Registered
from hickory_stream.records import Scan


class DeadReckoning:
    """Accumulates `last_from_scan`; without it the sensor is taken not to have moved."""

    name = "dead-reckoning"

    def __init__(self) -> None:
        self._start_from_sensor = np.eye(4)

    def register(self, scan: Scan, last_from_scan: NDArray[np.float64] | None = None) -> Registered | NotRegistered:
        """Return the accumulated motion; all directions are degenerate, since no surface constrains them."""
        if not len(scan.points):
            return NotRegistered(reason="0 points; expected 1 and more")
        if last_from_scan is not None:
            self._start_from_sensor = compose(self._start_from_sensor, last_from_scan)
        return Registered(
            stamp_ns=scan.stamp_ns,
            start_from_sensor=self._start_from_sensor,
            information=np.zeros((6, 6)),
            degenerate=np.eye(6),
        )
