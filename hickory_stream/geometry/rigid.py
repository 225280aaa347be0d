"""Rigid transforms as (4, 4) float64 matrices, named `a_from_b`.

Plain matrices multiply, stack into `(..., 4, 4)` and need no conversion. On the way to a map `compose` replaces `@`,
whose last bit depends on the processor. Directions of small motions (K, 6): unit, a turn first, then a shift.
"""

from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry import portable
from hickory_stream.geometry.portable_kernels import arccos, arctan2, cos, sin


def apply(a_from_b: NDArray[Any], points_b: NDArray[Any]) -> NDArray[Any]:
    """Return `points_b` (..., 3) in frame a; the result has the dtype of the points when that is floating."""
    return portable.moved(points_b, a_from_b[:3, :3], a_from_b[:3, 3])


def compose(a_from_b: NDArray[Any], *others: NDArray[Any]) -> NDArray[np.float64]:
    """Return `a_from_c` of `a_from_b`, `b_from_c` (4, 4), and so on; the last may be a stack (..., 4, 4)."""
    product = a_from_b
    for other in others:
        product = portable.matmul(product, other)
    return product


def both_jumps(first: NDArray[np.float64] | None, second: NDArray[np.float64] | None) -> NDArray[np.float64] | None:
    """Return two jumps in a row, after_from_before (4, 4) or None for none, as one."""
    return second if first is None else first if second is None else compose(second, first)


def invert(a_from_b: NDArray[Any]) -> NDArray[np.float64]:
    """Return `b_from_a`."""
    rotation = np.asarray(a_from_b[:3, :3], dtype=np.float64)
    b_from_a = np.eye(4)
    b_from_a[:3, :3] = rotation.T
    b_from_a[:3, 3] = portable.matmul(-rotation.T, a_from_b[:3, 3])
    return b_from_a


def from_rotation_translation(rotation: NDArray[Any], translation: NDArray[Any]) -> NDArray[np.float64]:
    """Return the (4, 4) transform of a (3, 3) rotation and a (3,) translation."""
    a_from_b = np.eye(4)
    a_from_b[:3, :3] = rotation
    a_from_b[:3, 3] = translation
    return a_from_b


def rotation_from_quaternion(x: float, y: float, z: float, w: float) -> NDArray[np.float64]:
    """Return the (3, 3) rotation of a quaternion, normalised first; raises ValueError if it is not finite or 0."""
    q = np.array([x, y, z, w], dtype=np.float64)
    length = portable.norm(q)
    if not np.isfinite(length) or length < 1e-9:
        raise ValueError(f"quaternion ({x}, {y}, {z}, {w}) is no rotation")
    x, y, z, w = q / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_from_rotation(rotation: NDArray[Any]) -> NDArray[np.float64]:
    """Return the unit quaternion (x, y, z, w) of a (3, 3) rotation, with w >= 0."""
    m = np.asarray(rotation, dtype=np.float64)
    # The largest of the four squared components decides the branch: no division by a small number.
    trace = np.trace(m)
    squares = np.array([m[0, 0], m[1, 1], m[2, 2], trace])
    best = int(np.argmax(squares))
    if best == 3:
        q = np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], 1 + trace])
    else:
        i, j, k = best, (best + 1) % 3, (best + 2) % 3
        q = np.empty(4)
        q[i] = 1 + m[i, i] - m[j, j] - m[k, k]
        q[j] = m[j, i] + m[i, j]
        q[k] = m[k, i] + m[i, k]
        q[3] = m[k, j] - m[j, k]
    q /= portable.norm(q)
    return -q if q[3] < 0 else q


def interpolate(a_from_b0: NDArray[Any], a_from_b1: NDArray[Any], fraction: float) -> NDArray[np.float64]:
    """Return the pose at `fraction` in 0..1 between two: translation linearly, rotation by slerp."""
    q0 = quaternion_from_rotation(a_from_b0[:3, :3])
    q1 = quaternion_from_rotation(a_from_b1[:3, :3])
    cosine = portable.dot(q0, q1)
    if cosine < 0:
        q1, cosine = -q1, -cosine
    angle = float(arccos(min(cosine, 1.0)))
    if angle < 1e-8:
        q = (1 - fraction) * q0 + fraction * q1
    else:
        q = (sin((1 - fraction) * angle) * q0 + sin(fraction * angle) * q1) / sin(angle)
    translation = (1 - fraction) * a_from_b0[:3, 3] + fraction * a_from_b1[:3, 3]
    return from_rotation_translation(rotation_from_quaternion(*(float(c) for c in q)), translation)


def rotation_angle_rad(rotation: NDArray[Any]) -> float:
    """Return the angle of a (3, 3) rotation, in 0..pi."""
    # atan2 of the two halves stays accurate near 0 and near pi, where arccos of the trace does not.
    skew = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    return float(arctan2(portable.norm(skew), float(np.trace(rotation)) - 1.0))


def rotation_vector(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation vector (3,) of a (3, 3) rotation."""
    skew = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    sine = portable.norm(skew)
    angle = rotation_angle_rad(rotation)
    return 0.5 * skew if sine < 1e-9 else skew * (angle / sine)


def rotation_of_vector(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (3, 3) rotation of a rotation vector, by Rodrigues' formula."""
    angle = portable.norm(vector)
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + sin(angle) * cross + (1.0 - cos(angle)) * portable.matmul(cross, cross)


def yaw_rotation(yaw_rad: float) -> NDArray[np.float64]:
    """Return the (3, 3) rotation by `yaw_rad` about z."""
    c, s = cos(float(yaw_rad)), sin(float(yaw_rad))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def is_rigid(a_from_b: NDArray[Any], tolerance: float = 1e-3) -> bool:
    """Return whether a (4, 4) matrix is finite, with a proper rotation and the bottom row 0 0 0 1."""
    if a_from_b.shape != (4, 4):
        return False
    # A map is read with tens of thousands of poses: sixteen numbers are checked sooner one by one than as an array.
    # What is not finite fails every comparison.
    (xx, xy, xz, x), (yx, yy, yz, y), (zx, zy, zz, z), (a, b, c, d) = a_from_b.tolist()
    return (
        isfinite(x)
        and isfinite(y)
        and isfinite(z)
        and abs(xx * xx + xy * xy + xz * xz - 1.0) < tolerance
        and abs(yx * yx + yy * yy + yz * yz - 1.0) < tolerance
        and abs(zx * zx + zy * zy + zz * zz - 1.0) < tolerance
        and abs(xx * yx + xy * yy + xz * yz) < tolerance
        and abs(xx * zx + xy * zy + xz * zz) < tolerance
        and abs(yx * zx + yy * zy + yz * zz) < tolerance
        and xx * (yy * zz - yz * zy) - xy * (yx * zz - yz * zx) + xz * (yx * zy - yy * zx) > 0
        and abs(a) < tolerance
        and abs(b) < tolerance
        and abs(c) < tolerance
        and abs(d - 1.0) < tolerance
    )


def no_directions() -> NDArray[np.float64]:
    """Return an empty (0, 6)."""
    return np.empty((0, 6))


def turned_directions(a_from_b: NDArray[np.float64], directions_b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the same directions (K, 6) along the axes of another frame, by the rotation of a transform (4, 4)."""
    return portable.matmul(directions_b.reshape(-1, 2, 3), a_from_b[:3, :3].T).reshape(-1, 6)
