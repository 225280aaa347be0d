"""The error of an alignment against the truth."""
# Two errors are given: that of the paper, which is the error of the transform itself (its translation is measured at
# the origin of map b), and the error where the maps overlap, which is the one that matters to a robot.

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.rigid import apply, rotation_angle_rad

SUCCESS_M = 0.5
SUCCESS_DEG = 5.0


@dataclass(frozen=True, kw_only=True, slots=True)
class AlignmentError:
    """The error of an alignment: at the centroid of the true common objects, at map b's origin, and of the rotation."""

    translation_m: float
    origin_m: float
    rotation_deg: float

    @property
    def is_success(self) -> bool:
        """Whether it is below 0.5 m and 5 degrees."""
        return self.translation_m < SUCCESS_M and self.rotation_deg < SUCCESS_DEG


def error_of(
    a_from_b: NDArray[np.float64], true_a_from_b: NDArray[np.float64], center_b: NDArray[np.float64]
) -> AlignmentError:
    """Return the error of a transform; `center_b` (3,) is the centre of the overlap."""
    return AlignmentError(
        translation_m=float(np.linalg.norm(apply(a_from_b, center_b) - apply(true_a_from_b, center_b))),
        origin_m=float(np.linalg.norm(a_from_b[:3, 3] - true_a_from_b[:3, 3])),
        rotation_deg=float(np.degrees(rotation_angle_rad(a_from_b[:3, :3].T @ true_a_from_b[:3, :3]))),
    )
