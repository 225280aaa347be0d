"""Elementary functions and small linear algebra for kernels, with the same last bit on every processor.

These are sums, products, quotients and roots of IEEE doubles in a stated order, which round in one way only; Numba
neither reorders nor fuses them. They follow fdlibm (Sun Microsystems, 1993), good to about one unit in the last place.
"""

import numpy as np

from hickory_stream.base.compiled import kernel

_LOG_2 = 0.6931471805599453
# ln 2 and pi / 2 in parts, of which all but the last have zeros at their end: small multiples of them are exact.
_LOG_2_HIGH, _LOG_2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
_QUARTER_1, _QUARTER_2, _QUARTER_3 = 1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624871116645580e-21
_QUARTER_4 = 8.47842766036889956997e-32
_ROOT_HALF_BITS = 0x3FE6A09E667F3BCD
_LEAST_NORMAL = 2.2250738585072014e-308
_HALF_PI_HIGH, _HALF_PI_LOW = 1.57079632679489655800e00, 6.12323399573676603587e-17


@kernel(error_model="numpy")
def exp(x):
    """Return e^x: Taylor's series about the nearest multiple of ln 2."""
    x = np.float64(x)
    if not -745.2 < x < 709.79:
        return x if np.isnan(x) else (np.inf if x > 0 else 0.0)
    n = np.floor(x * (1.0 / _LOG_2) + 0.5)
    r = (x - n * _LOG_2_HIGH) - n * _LOG_2_LOW
    p = 1.0 / 479001600 + r * (1.0 / 6227020800)
    p = 1.0 / 3628800 + r * (1.0 / 39916800 + r * p)
    p = 1.0 / 40320 + r * (1.0 / 362880 + r * p)
    p = 1.0 / 720 + r * (1.0 / 5040 + r * p)
    p = 1.0 / 24 + r * (1.0 / 120 + r * p)
    p = 0.5 + r * (1.0 / 6 + r * p)
    p = 1.0 + (r + r * r * p)
    # In two factors, of which neither leaves the range where the result does not.
    first = np.int64(n) >> np.int64(1)
    return p * _power_of_two(first) * _power_of_two(np.int64(n) - first)


@kernel(error_model="numpy")
def log(x):
    """Return ln x: -inf of 0, NaN of what is less."""
    x = np.float64(x)
    if not 0.0 < x < np.inf:
        return -np.inf if x == 0.0 else (x if x > 0 or np.isnan(x) else np.nan)
    shift = 54.0 if x < _LEAST_NORMAL else 0.0
    bits = np.float64(x * 18014398509481984.0 if x < _LEAST_NORMAL else x).view(np.int64)
    exponent = np.int64(bits - np.int64(_ROOT_HALF_BITS)) >> np.int64(52)
    k = np.float64(exponent) - shift
    f = np.int64(bits - (exponent << np.int64(52))).view(np.float64) - 1.0
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    even = w * (3.999999999940941908e-01 + w * (2.222219843214978396e-01 + w * 1.531383769920937332e-01))
    odd = w * (1.818357216161805012e-01 + w * 1.479819860511658591e-01)
    odd = z * (6.666666666666735130e-01 + w * (2.857142874366239149e-01 + odd))
    half = 0.5 * f * f
    return k * _LOG_2_HIGH - ((half - (s * (half + (even + odd)) + k * _LOG_2_LOW)) - f)


@kernel(error_model="numpy")
def log1p(x):
    """Return ln(1 + x), accurate near 0: what rounding took off 1 + x is put back to first order (Kahan)."""
    whole = 1.0 + np.float64(x)
    if whole == np.inf or not whole > 0.0:
        return log(whole)
    return log(whole) + (x - (whole - 1.0)) / whole


@kernel(error_model="numpy")
def logaddexp(a, b):
    """Return ln(e^a + e^b)."""
    high = max(a, b)
    if a == b or not high < np.inf:
        return high + _LOG_2 if a == b else a + b
    return high + log1p(exp(min(a, b) - high))


@kernel(error_model="numpy")
def power(x, y):
    """Return x^y for x of at least 0, to |y ln x| units in the last place."""
    if y == 0.0 or x == 1.0:
        return 1.0
    return exp(y * log(x))


@kernel(error_model="numpy")
def cbrt(x):
    """Return the cube root, of either sign: by logarithms, then one step of Newton's."""
    x = np.float64(x)
    if x == 0.0 or not abs(x) < np.inf:
        return x
    root = exp(log(abs(x)) / 3.0)
    root -= (root - abs(x) / (root * root)) / 3.0
    return root if x > 0 else -root


@kernel(error_model="numpy")
def sin(x):
    """Return the sine of an angle of up to a million radians."""
    turns, r, rest = _quarter_turns(x)
    value = _sin_kernel(r, rest) if turns & 1 == 0 else _cos_kernel(r, rest)
    return value if turns & 2 == 0 else -value


@kernel(error_model="numpy")
def cos(x):
    """Return the cosine of an angle of up to a million radians."""
    turns, r, rest = _quarter_turns(x)
    value = _cos_kernel(r, rest) if turns & 1 == 0 else _sin_kernel(r, rest)
    return value if (turns + 1) & 2 == 0 else -value


@kernel(error_model="numpy")
def arctan2(y, x):
    """Return the angle of (x, y) in -pi..pi, 0 for (0, 0). Without branches: loops over it are vectorised."""
    y, x = np.float64(y), np.float64(x)
    up, along = abs(y), abs(x)
    is_steep = up > along
    ratio = (along if is_steep else up) / (up if is_steep else along)
    ratio = (1.0 if up > 0.0 else 0.0) if up == along else ratio  # where both are zero or infinite, too
    angle = _arctan(ratio)
    angle = _HALF_PI_HIGH - (angle - _HALF_PI_LOW) if is_steep else angle
    # The sign of zero counts, as in C.
    is_left = (x < 0.0) | ((y == 0.0) & (np.copysign(1.0, x) < 0.0))
    angle = np.pi - (angle - 2.0 * _HALF_PI_LOW) if is_left else angle
    return np.copysign(angle, y)


@kernel(error_model="numpy")
def arccos(x):
    """Return the angle in 0..pi whose cosine is x, NaN beyond -1..1."""
    return arctan2(np.sqrt((1.0 - x) * (1.0 + x)), np.float64(x))


@kernel(error_model="numpy")
def exp_each(values):
    """Return e^x of each of (N,) values."""
    out = np.empty(len(values))
    for i in range(len(values)):
        out[i] = exp(values[i])
    return out


@kernel(error_model="numpy")
def solve_in_place(matrix, right):
    """Put the solution of matrix x = right into `right` (n,), by elimination with row exchange; both are used up."""
    # Where the matrix is singular the solution is not finite.
    count = len(right)
    for column in range(count):
        best = column
        for row in range(column + 1, count):
            if abs(matrix[row, column]) > abs(matrix[best, column]):
                best = row
        if best != column:
            for k in range(count):
                matrix[column, k], matrix[best, k] = matrix[best, k], matrix[column, k]
            right[column], right[best] = right[best], right[column]
        for row in range(column + 1, count):
            share = matrix[row, column] / matrix[column, column]
            for k in range(column + 1, count):
                matrix[row, k] -= share * matrix[column, k]
            right[row] -= share * right[column]
    for row in range(count - 1, -1, -1):
        for k in range(row + 1, count):
            right[row] -= matrix[row, k] * right[k]
        right[row] /= matrix[row, row]


@kernel(error_model="numpy")
def diagonalise(matrix, vectors):
    """Turn a symmetric matrix (n, n) into its eigenvalues, ascending on the diagonal, and fill its eigenvectors."""
    # Jacobi's method, row by row: each step turns two axes: their product vanishes.
    count = len(matrix)
    for i in range(count):
        for j in range(count):
            vectors[i, j] = 1.0 if i == j else 0.0
    for _ in range(60):
        largest, off = 0.0, 0.0
        for i in range(count):
            largest = max(largest, abs(matrix[i, i]))
            for j in range(i + 1, count):
                off = max(off, abs(matrix[i, j]))
        if not off > 1e-17 * largest:
            break
        for p in range(count):
            for q in range(p + 1, count):
                _turn_axes(matrix, vectors, p, q)
    for i in range(count - 1):
        least = i
        for j in range(i + 1, count):
            if matrix[j, j] < matrix[least, least]:
                least = j
        if least != i:
            matrix[i, i], matrix[least, least] = matrix[least, least], matrix[i, i]
            for k in range(count):
                vectors[k, i], vectors[k, least] = vectors[k, least], vectors[k, i]


@kernel(error_model="numpy")
def _turn_axes(matrix, vectors, p, q):
    # So that entry (p, q) vanishes.
    entry = matrix[p, q]
    if entry == 0.0:
        return
    ratio = (matrix[q, q] - matrix[p, p]) / (2.0 * entry)
    if not abs(ratio) < 1e150:
        matrix[p, q] = matrix[q, p] = 0.0
        return
    t = (1.0 if ratio >= 0.0 else -1.0) / (abs(ratio) + np.sqrt(ratio * ratio + 1.0))
    c = 1.0 / np.sqrt(t * t + 1.0)
    s = t * c
    matrix[p, p] -= t * entry
    matrix[q, q] += t * entry
    matrix[p, q] = matrix[q, p] = 0.0
    for k in range(len(matrix)):
        if k not in (p, q):
            a, b = matrix[k, p], matrix[k, q]
            matrix[k, p] = matrix[p, k] = c * a - s * b
            matrix[k, q] = matrix[q, k] = s * a + c * b
        a, b = vectors[k, p], vectors[k, q]
        vectors[k, p], vectors[k, q] = c * a - s * b, s * a + c * b


@kernel(error_model="numpy")
def _power_of_two(n):
    return np.int64((n + np.int64(1023)) << np.int64(52)).view(np.float64)


@kernel(error_model="numpy")
def _quarter_turns(x):
    # The nearest number of quarter turns, the rest, and the rounding error of the rest.
    x = np.float64(x)
    if not abs(x) < 1e9:
        return np.int64(0), np.nan, 0.0
    n = np.floor(x * (2.0 / np.pi) + 0.5)
    first = x - n * _QUARTER_1
    second = first - n * _QUARTER_2
    lost = (first - second) - n * _QUARTER_2
    low = n * _QUARTER_3 - lost
    r = second - low
    return np.int64(n), r, ((second - r) - low) - n * _QUARTER_4


@kernel(error_model="numpy")
def _sin_kernel(x, rest):
    # sin(x + rest) for |x| up to an eighth of a turn.
    z = x * x
    v = z * x
    r = 2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)
    r = 8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04 + z * r)
    return x - ((z * (0.5 * rest - v * r) - rest) - v * -1.66666666666666324348e-01)


@kernel(error_model="numpy")
def _cos_kernel(x, rest):
    # cos(x + rest) for |x| up to an eighth of a turn.
    z = x * x
    r = -2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11)
    r = -1.38888888888741095749e-03 + z * (2.48015872894767294178e-05 + z * r)
    r = z * (4.16666666666666019037e-02 + z * r)
    half = 0.5 * z
    w = 1.0 - half
    return w + (((1.0 - w) - half) + (z * r - x * rest))


@kernel(error_model="numpy")
def _arctan(x):
    # x in 0..1: as the difference to the arctangent of 0, 1/2 or 1.
    of_one, of_half = x >= 0.6875, x >= 0.4375
    high = 7.85398163397448278999e-01 if of_one else (4.63647609000806093515e-01 if of_half else 0.0)
    low = 3.06161699786838301793e-17 if of_one else (2.26987774529616870924e-17 if of_half else 0.0)
    above = x - 1.0 if of_one else (2.0 * x - 1.0 if of_half else x)
    below = x + 1.0 if of_one else (2.0 + x if of_half else 1.0)
    x = above / below
    z = x * x
    w = z * z
    odd = 4.97687799461593236017e-02 + w * 1.62858201153657823623e-02
    odd = 9.09088713343650656196e-02 + w * (6.66107313738753120669e-02 + w * odd)
    odd = z * (3.33333333333329318027e-01 + w * (1.42857142725034663711e-01 + w * odd))
    even = -5.83357013379057348645e-02 + w * -3.65315727442169155270e-02
    even = -1.11111104054623557880e-01 + w * (-7.69187620504482999495e-02 + w * even)
    even = w * (-1.99999999998764832476e-01 + w * even)
    return high - ((x * (odd + even) - low) - x)
