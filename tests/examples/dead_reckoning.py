"""Example of an odometry: dead reckoning, which accumulates motion measured elsewhere, e.g. by wheel encoders."""

import numpy as np
from hickory_stream.geometry.rigid import compose
from hickory_stream.ports import NotRegistered, Registered


class DeadReckoning:
    """Accumulates `last_from_scan`; without it the sensor is taken not to have moved."""

    name = "dead-reckoning"

    def __init__(self):
        self._start_from_sensor = np.eye(4)

    def register(self, scan, last_from_scan=None):
        """Return the accumulated motion; all directions are degenerate, since no surface constrains them."""
        if not len(scan.points):
            return NotRegistered(reason="0 points; expected 1 and more")
        if last_from_scan is not None:
            self._start_from_sensor = compose(self._start_from_sensor, last_from_scan)
        return Registered(
            stamp_ns=scan.stamp_ns, start_from_sensor=self._start_from_sensor, information=np.zeros((6, 6)),
            degenerate=np.eye(6),
        )  # fmt: skip
