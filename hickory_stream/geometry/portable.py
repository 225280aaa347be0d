"""Products, norms, eigenvectors and elementary functions of arrays with the same last bit on every processor.

BLAS, LAPACK, NumPy's vectorised functions and the C library choose their code by the processor and round differently,
and a decision turns a last bit into another map. Between pixels and a map's digest these are used instead
(`tests/test_portable_arithmetic.py` lists what else may be). Sums go from the first term to the last.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry import portable_kernels as kernels


def matmul(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    """Return what `a @ b` does, for vectors, matrices and stacks of matrices; float32 only if both are."""
    dtype = np.float32 if a.dtype == b.dtype == np.float32 else np.float64
    left, right = (a[None] if a.ndim == 1 else a), (b[:, None] if b.ndim == 1 else b)
    if left.shape[-1] != right.shape[-2]:
        raise ValueError(f"cannot multiply {a.shape} and {b.shape}")
    if right.ndim == 2:
        # Rows are rows, of one matrix or of a stack; there may be none, or nothing in them.
        rows = _writable(left.reshape(math.prod(left.shape[:-1]), left.shape[-1]), dtype)
        product = _product(rows, right, dtype).reshape(*left.shape[:-1], right.shape[-1])
    else:
        stack = np.broadcast_shapes(left.shape[:-2], right.shape[:-2])
        product = np.zeros((*stack, left.shape[-2], right.shape[-1]), dtype=dtype)
        out = product.reshape(math.prod(stack), *product.shape[-2:])
        _multiply_stacks(_stacked(left, stack, dtype), _stacked(right, stack, dtype), out)
    if a.ndim == 1:
        product = product[..., 0, :]
    return product[..., 0] if b.ndim == 1 else product


def dot(a: NDArray[Any], b: NDArray[Any]) -> float:
    """Return the inner product of two vectors (n,), in double precision."""
    return float(_dot(_writable(a, np.float64), _writable(b, np.float64)))


def norm(vector: ArrayLike) -> float:
    """Return the length of a vector (n,), in double precision."""
    values = _writable(np.asarray(vector), np.float64).reshape(-1)
    return float(np.sqrt(_dot(values, values)))


def moved(points: NDArray[Any], rotation: NDArray[Any], translation: NDArray[Any]) -> NDArray[Any]:
    """Return points (..., 3) turned by (3, 3), then shifted by (3,), in their own precision."""
    dtype = points.dtype if points.dtype == np.float32 else np.dtype(np.float64)
    flat = _writable(points.reshape(-1, 3), dtype)
    out = np.empty(flat.shape, dtype=dtype)
    _move(flat, _writable(rotation, dtype), _writable(translation, dtype), out)
    return out.reshape(points.shape)


def eigh(matrix: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the (n,) eigenvalues of a symmetric matrix (n, n), ascending, and (n, n) its eigenvectors as columns."""
    work = np.array(matrix, dtype=np.float64, order="C")
    vectors = np.empty_like(work)
    kernels.diagonalise(work, vectors)
    return work.diagonal().copy(), vectors


def det3(matrix: NDArray[Any]) -> float:
    """Return the determinant of a (3, 3) matrix."""
    (a, b, c), (d, e, f), (g, h, i) = np.asarray(matrix, dtype=np.float64).tolist()
    return float(a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g))


def svd3(matrix: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return u, s, vt of a (3, 3) matrix = u diag(s) vt: u and vt orthogonal, s (3,) falling."""
    own = np.array(matrix, dtype=np.float64, order="C")
    u, s, v = np.zeros((3, 3)), np.zeros(3), np.empty((3, 3))
    _decompose(own, u, s, v)
    return u, s, v.T.copy()


def nearest_orthogonal(matrices: NDArray[Any]) -> NDArray[np.float64]:
    """Return (N, 3, 3) the orthogonal matrices nearest to those of a stack (N, 3, 3): u vt of each."""
    work = np.array(matrices, dtype=np.float64, order="C")
    _orthogonalise_each(work)
    return work


def exp(values: ArrayLike) -> NDArray[np.float64]:
    """Return e^x of each value."""
    return _of_each(_exp, values)


def log(values: ArrayLike) -> NDArray[np.float64]:
    """Return ln x of each value."""
    return _of_each(_log, values)


def log1p(values: ArrayLike) -> NDArray[np.float64]:
    """Return ln(1 + x) of each value."""
    return _of_each(_log1p, values)


def sin(values: ArrayLike) -> NDArray[np.float64]:
    """Return the sine of each angle, of up to a million radians."""
    return _of_each(_sin, values)


def cos(values: ArrayLike) -> NDArray[np.float64]:
    """Return the cosine of each angle, of up to a million radians."""
    return _of_each(_cos, values)


def cbrt(values: ArrayLike) -> NDArray[np.float64]:
    """Return the cube root of each value."""
    return _of_each(_cbrt, values)


def arctan2(y: ArrayLike, x: ArrayLike) -> NDArray[np.float64]:
    """Return the angle of each (x, y)."""
    return _of_pairs(_arctan2, y, x)


def power(x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
    """Return x^y of each two values, x at least 0."""
    return _of_pairs(_power, x, y)


def logaddexp(a: ArrayLike, b: ArrayLike) -> NDArray[np.float64]:
    """Return ln(e^a + e^b) of each two values."""
    return _of_pairs(_logaddexp, a, b)


def hypot(x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
    """Return the length of each (x, y)."""
    x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    return np.asarray(np.sqrt(x * x + y * y))


def gaussian_weights(sigma: float, radius: int) -> NDArray[np.float64]:
    """Return the 2 r + 1 weights of a Gaussian that is cut off at a radius; their sum is 1."""
    steps = np.arange(-radius, radius + 1) / sigma
    weights = exp(-0.5 * steps * steps)
    return np.asarray(weights / weights.sum())


def _writable(array: NDArray[Any], dtype: Any) -> NDArray[Any]:
    # A copy if read-only: a kernel is compiled for one kind of array.
    out = np.ascontiguousarray(array, dtype=dtype)
    return out if out.flags.writeable else out.copy()


def _product(rows: NDArray[Any], right: NDArray[Any], dtype: Any) -> NDArray[Any]:
    out = np.zeros((len(rows), right.shape[1]), dtype=dtype)
    if right.shape == (3, 3):
        _multiply_threes(rows, _writable(right, dtype), out)
    else:
        _multiply(rows, _writable(right, dtype), out)
    return out


def _stacked(matrices: NDArray[Any], stack: tuple[int, ...], dtype: Any) -> NDArray[Any]:
    # (N, n, m) of a whole stack, or (1, n, m) for all of them.
    if matrices.ndim > 2:
        matrices = np.broadcast_to(matrices, (*stack, *matrices.shape[-2:]))
    return _writable(matrices.reshape(math.prod(matrices.shape[:-2]), *matrices.shape[-2:]), dtype)


def _of_each(kernel: Callable[[NDArray[np.float64]], None], values: ArrayLike) -> NDArray[np.float64]:
    out = np.array(values, dtype=np.float64, order="C")
    kernel(out.reshape(-1))
    return out


def _of_pairs(
    kernel: Callable[[NDArray[np.float64], NDArray[np.float64]], None], a: ArrayLike, b: ArrayLike
) -> NDArray[np.float64]:
    first, second = np.broadcast_arrays(np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64))
    out, other = np.array(first, order="C"), np.array(second, order="C")
    kernel(out.reshape(-1), other.reshape(-1))
    return out


@kernel
def _multiply(a, b, out):
    # Adds to `out`, of zeros; for a row the terms come one after the other, whatever is vectorised.
    for i in range(a.shape[0]):
        if b.shape[1] == 1:
            total = out[i, 0]
            for k in range(a.shape[1]):
                total += a[i, k] * b[k, 0]
            out[i, 0] = total
        else:
            for k in range(a.shape[1]):
                share = a[i, k]
                for j in range(b.shape[1]):
                    out[i, j] += share * b[k, j]


@kernel
def _multiply_threes(a, b, out):
    b00, b01, b02 = b[0, 0], b[0, 1], b[0, 2]
    b10, b11, b12 = b[1, 0], b[1, 1], b[1, 2]
    b20, b21, b22 = b[2, 0], b[2, 1], b[2, 2]
    for i in range(len(a)):
        x, y, z = a[i, 0], a[i, 1], a[i, 2]
        out[i, 0] = x * b00 + y * b10 + z * b20
        out[i, 1] = x * b01 + y * b11 + z * b21
        out[i, 2] = x * b02 + y * b12 + z * b22


@kernel
def _multiply_stacks(a, b, out):
    for n in range(len(out)):
        m, o = n if len(a) > 1 else 0, n if len(b) > 1 else 0
        for i in range(a.shape[1]):
            for k in range(a.shape[2]):
                for j in range(b.shape[2]):
                    out[n, i, j] += a[m, i, k] * b[o, k, j]


@kernel
def _move(points, rotation, translation, out):
    r00, r01, r02, t0 = rotation[0, 0], rotation[0, 1], rotation[0, 2], translation[0]
    r10, r11, r12, t1 = rotation[1, 0], rotation[1, 1], rotation[1, 2], translation[1]
    r20, r21, r22, t2 = rotation[2, 0], rotation[2, 1], rotation[2, 2], translation[2]
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        out[i, 0] = x * r00 + y * r01 + z * r02 + t0
        out[i, 1] = x * r10 + y * r11 + z * r12 + t1
        out[i, 2] = x * r20 + y * r21 + z * r22 + t2


@kernel
def _dot(a, b):
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@kernel(error_model="numpy")
def _decompose(own, u, s, v):
    # Hestenes: turns the columns of `own` (3, 3) until they are at right angles, the longest first; u s = own v.
    for i in range(3):
        for j in range(3):
            v[i, j] = 1.0 if i == j else 0.0
    for _ in range(60):
        is_done = True
        for p in range(2):
            for q in range(p + 1, 3):
                is_done &= _turn_columns(own, v, p, q)
        if is_done:
            break
    for i in range(3):
        best = i
        for j in range(i, 3):
            s[j] = np.sqrt(own[0, j] * own[0, j] + own[1, j] * own[1, j] + own[2, j] * own[2, j])
            if s[j] > s[best]:
                best = j
        s[i], s[best] = s[best], s[i]
        if best != i:
            for k in range(3):
                own[k, i], own[k, best] = own[k, best], own[k, i]
                v[k, i], v[k, best] = v[k, best], v[k, i]
    for i in range(3):
        if s[i] > 1e-14 * s[0]:
            for k in range(3):
                u[k, i] = own[k, i] / s[i]
        else:
            _complete(u, i)


@kernel(error_model="numpy")
def _orthogonalise_each(matrices):
    u, s, v = np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    for n in range(len(matrices)):
        u[:] = 0.0
        s[:] = 0.0
        _decompose(matrices[n], u, s, v)
        for i in range(3):
            for j in range(3):
                matrices[n, i, j] = u[i, 0] * v[j, 0] + u[i, 1] * v[j, 1] + u[i, 2] * v[j, 2]


@kernel(error_model="numpy")
def _turn_columns(own, v, p, q):
    a, b, c = 0.0, 0.0, 0.0
    for k in range(3):
        a += own[k, p] * own[k, p]
        b += own[k, q] * own[k, q]
        c += own[k, p] * own[k, q]
    if not abs(c) > 1e-16 * np.sqrt(a * b):
        return True
    ratio = (b - a) / (2.0 * c)
    t = (1.0 if ratio >= 0.0 else -1.0) / (abs(ratio) + np.sqrt(1.0 + ratio * ratio))
    cosine = 1.0 / np.sqrt(1.0 + t * t)
    sine = cosine * t
    for k in range(3):
        x, y = own[k, p], own[k, q]
        own[k, p], own[k, q] = cosine * x - sine * y, sine * x + cosine * y
        x, y = v[k, p], v[k, q]
        v[k, p], v[k, q] = cosine * x - sine * y, sine * x + cosine * y
    return False


@kernel(error_model="numpy")
def _complete(u, i):
    # At right angles to the columns before it: most of the axis that is least beside them.
    best = -1.0
    trial = np.empty(3)
    for axis in range(3):
        for k in range(3):
            trial[k] = 1.0 if k == axis else 0.0
        for j in range(i):
            share = u[axis, j]
            for k in range(3):
                trial[k] -= share * u[k, j]
        length = np.sqrt(trial[0] * trial[0] + trial[1] * trial[1] + trial[2] * trial[2])
        if length > best + 1e-9:
            best = length
            for k in range(3):
                u[k, i] = trial[k] / length


@kernel
def _exp(values):
    for i in range(len(values)):
        values[i] = kernels.exp(values[i])


@kernel
def _log(values):
    for i in range(len(values)):
        values[i] = kernels.log(values[i])


@kernel
def _log1p(values):
    for i in range(len(values)):
        values[i] = kernels.log1p(values[i])


@kernel
def _sin(values):
    for i in range(len(values)):
        values[i] = kernels.sin(values[i])


@kernel
def _cos(values):
    for i in range(len(values)):
        values[i] = kernels.cos(values[i])


@kernel
def _cbrt(values):
    for i in range(len(values)):
        values[i] = kernels.cbrt(values[i])


@kernel
def _arctan2(y, x):
    for i in range(len(y)):
        y[i] = kernels.arctan2(y[i], x[i])


@kernel
def _power(x, y):
    for i in range(len(x)):
        x[i] = kernels.power(x[i], y[i])


@kernel
def _logaddexp(a, b):
    for i in range(len(a)):
        a[i] = kernels.logaddexp(a[i], b[i])
