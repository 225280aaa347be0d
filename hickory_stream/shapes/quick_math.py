"""Logarithm and exponential that the compiler can vectorise.

The functions of the system's library process one number per call, and their last bits depend on the library. These have
a relative error below 1e-12 and no branches, and give the same bits on every machine with IEEE doubles.
"""

from __future__ import annotations

import numpy as np

from hickory_stream.compiled import numba

_LOG_2 = 0.6931471805599453
# ln 2 in two parts; the first has trailing zeros, so that its product with n is exact.
_LOG_2_HIGH, _LOG_2_LOW = 0.6931471803691238, 1.9082149292705877e-10
_ROOT_HALF_BITS = 0x3FE6A09E667F3BCD


@numba.njit(cache=True, nogil=True, error_model="numpy")
def quick_log(x):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return ln x of a normal positive number, by the artanh series of the mantissa in 1/sqrt 2 .. sqrt 2."""
    bits = np.float64(x).view(np.int64)
    exponent = np.int64(bits - np.int64(_ROOT_HALF_BITS)) >> np.int64(52)
    mantissa = np.int64(bits - (exponent << np.int64(52))).view(np.float64)
    s = (mantissa - 1.0) / (mantissa + 1.0)
    z = s * s
    p = 1.0 / 13 + z * (1.0 / 15)
    p = 1.0 / 9 + z * (1.0 / 11 + z * p)
    p = 1.0 / 5 + z * (1.0 / 7 + z * p)
    p = 1.0 + z * (1.0 / 3 + z * p)
    return np.float64(exponent) * _LOG_2 + 2.0 * s * p


@numba.njit(cache=True, nogil=True, error_model="numpy")
def quick_exp(x):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return e^x, with x clipped to +-700, by the Taylor series about the nearest multiple of ln 2."""
    x = min(max(x, -700.0), 700.0)
    n = np.floor(x * (1.0 / _LOG_2) + 0.5)
    r = x - n * _LOG_2_HIGH - n * _LOG_2_LOW
    p = 1.0 / 362880 + r * (1.0 / 3628800)
    p = 1.0 / 5040 + r * (1.0 / 40320 + r * p)
    p = 1.0 / 120 + r * (1.0 / 720 + r * p)
    p = 1.0 / 6 + r * (1.0 / 24 + r * p)
    p = 1.0 + r * (1.0 + r * (0.5 + r * p))
    return p * np.int64((np.int64(n) + np.int64(1023)) << np.int64(52)).view(np.float64)
