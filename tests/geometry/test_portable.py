import hashlib
import math
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from hickory_stream.geometry import portable
from hickory_stream.geometry import portable_kernels as kernels
from tests.strategies import rotations

FINITE = st.floats(-1e3, 1e3)
ANGLES = np.concatenate(
    [np.linspace(-1000, 1000, 4001), 10.0 ** np.arange(-300.0, 6.0), np.arange(-40, 41) * np.pi / 4]
)
POSITIVE = np.concatenate([10.0 ** np.linspace(-307, 308, 3001), np.linspace(0.5, 2, 3001), [5e-324, 1e-310]])


def units_off(found, wanted):
    """Return by how many units in the last place values are off at most; both must agree where they are not finite."""
    a, b = np.asarray(found), np.asarray(wanted)
    assert np.array_equal(np.isnan(a), np.isnan(b))
    unequal = (a != b) & ~np.isnan(b)
    return float((np.abs(a - b)[unequal] / np.spacing(np.abs(b[unequal]))).max(initial=0.0))


def test_elementary_functions_are_right_to_one_ulp():
    exponents = np.concatenate([np.linspace(-745, 709.7, 5001), 10.0 ** np.arange(-300.0, 2.0)])
    assert units_off(portable.exp(exponents), [math.exp(x) for x in exponents]) <= 1
    assert units_off(portable.log(POSITIVE), [math.log(x) for x in POSITIVE]) <= 1
    assert units_off(portable.log1p(POSITIVE), [math.log1p(x) for x in POSITIVE]) <= 1
    assert units_off(portable.sin(ANGLES), [math.sin(x) for x in ANGLES]) <= 1
    assert units_off(portable.cos(ANGLES), [math.cos(x) for x in ANGLES]) <= 1
    assert units_off(portable.cbrt(POSITIVE[:-2]) ** 3, list(POSITIVE[:-2])) <= 6
    cosines = np.linspace(-1, 1, 2001)
    assert units_off([kernels.arccos(x) for x in cosines], [math.acos(x) for x in cosines]) <= 2


def test_the_angle_of_a_vector_is_right_in_every_quadrant():
    sides = [0.0, -0.0, 1.0, -1.0, 1e-300, -1e300, 0.43, 0.7, -3.0]
    y, x = (side.ravel() for side in np.meshgrid(sides, sides))
    wanted = [math.atan2(b, a) for b, a in zip(y, x, strict=True)]
    found = portable.arctan2(y, x)
    assert units_off(found, wanted) <= 1
    assert np.array_equal(np.signbit(found), np.signbit(wanted))


def test_functions_have_the_limits_that_they_have_in_c():
    limits = np.array([np.nan, np.inf, -np.inf, 1e4, -1e4])
    assert np.array_equal(portable.exp(limits), [np.nan, np.inf, 0.0, np.inf, 0.0], equal_nan=True)
    logs = portable.log(np.array([0.0, -1.0, np.inf, np.nan]))
    assert np.array_equal(logs, [-np.inf, np.nan, np.inf, np.nan], equal_nan=True)
    assert portable.logaddexp(-np.inf, -np.inf) == -np.inf
    assert portable.logaddexp(1000.0, 1000.0) == pytest.approx(1000.0 + math.log(2), rel=1e-15)
    assert portable.power(0.0, 0.5) == 0.0


@given(st.floats(1e-5, 1e5), st.floats(-20, 20))
def test_powers_are_powers(x, y):
    assert float(portable.power(x, y)) == pytest.approx(x**y, rel=1e-13)


SHAPES = (
    ((5, 3), (3, 3)), ((3,), (3, 2)), ((5, 3), (3,)), ((4,), (4,)), ((4, 4), (7, 4, 4)), ((7, 4, 4), (4, 4)),
    ((2, 3, 3), (2, 3, 3)), ((6, 5, 3), (3, 2)), ((6, 5, 3), (3,)), ((0, 3), (3, 3)),
    ((6, 0), (0, 6)), ((0,), (0, 3)), ((0,), (0,)), ((2, 3, 0), (2, 0, 3)), ((0, 2, 3), (0, 3, 2)), ((0, 2, 3), (3, 2)),
)  # fmt: skip


@pytest.mark.parametrize(("a", "b"), SHAPES)
def test_products_are_those_of_the_operator(a, b):
    rng = np.random.default_rng(1)
    left, right = rng.normal(size=a), rng.normal(size=b)
    left.flags.writeable = False
    product = portable.matmul(left, right)
    assert product.shape == (left @ right).shape
    assert np.allclose(product, left @ right, rtol=1e-13, atol=1e-13)
    single = portable.matmul(left.astype(np.float32), right.astype(np.float32))
    assert single.dtype == np.float32
    assert np.allclose(single, left @ right, atol=1e-5)


def test_matrices_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="cannot multiply"):
        portable.matmul(np.ones((2, 3)), np.ones((2, 3)))


@given(arrays(np.float64, (3, 3), elements=FINITE), rotations())
def test_eigenvectors_diagonalise_a_symmetric_matrix(root, turn):
    for matrix in (root @ root.T, turn @ np.diag([1.0, 1.0, 2.0]) @ turn.T):
        values, vectors = portable.eigh(matrix)
        scale = max(float(np.abs(matrix).max()), 1e-12)
        assert (np.diff(values) >= 0).all()
        assert np.allclose(vectors @ vectors.T, np.eye(3), atol=1e-12)
        assert np.allclose(vectors * values @ vectors.T, (matrix + matrix.T) / 2, atol=1e-12 * scale)


@given(arrays(np.float64, (3, 3), elements=FINITE))
def test_singular_values_fall_and_their_frames_are_orthogonal(matrix):
    for own in (matrix, np.outer(matrix[0], matrix[1]), np.zeros((3, 3))):
        u, s, vt = portable.svd3(own)
        assert (np.diff(s) <= 0).all()
        assert np.allclose(u @ u.T, np.eye(3), atol=1e-9)
        assert np.allclose(vt @ vt.T, np.eye(3), atol=1e-9)
        assert np.allclose(u * s @ vt, own, atol=1e-11 * max(float(np.abs(own).max()), 1e-12))


@given(arrays(np.float64, (3, 3), elements=FINITE))
def test_a_determinant_is_that_of_lapack(matrix):
    assert portable.det3(matrix) == pytest.approx(
        np.linalg.det(matrix), abs=1e-9 * max(np.abs(matrix).max() ** 3, 1e-12)
    )


def test_equations_are_solved_where_the_first_pivot_is_zero():
    matrix = np.array([[0.0, 2.0, 1.0], [1.0, 0.0, 3.0], [4.0, 1.0, 0.0]])
    wanted = np.array([1.0, -2.0, 0.5])
    right = matrix @ wanted
    kernels.solve_in_place(matrix.copy(), right)
    assert np.allclose(right, wanted, atol=1e-14)


def test_the_bits_are_these_on_every_processor():
    rng = np.random.default_rng(7)
    points, matrix = 4 * rng.random((200, 3)) - 2, 4 * rng.random((3, 3)) - 2
    digest = hashlib.sha256()
    for values in (
        portable.exp(points * 50), portable.log(np.abs(points)), portable.sin(points * 9), portable.cos(points * 9),
        portable.arctan2(points[:, 0], points[:, 1]), portable.power(np.abs(points), 0.37), portable.cbrt(points),
        portable.logaddexp(points[:, 0], points[:, 2]), portable.matmul(points, matrix),
        portable.matmul(points.T, points),
        portable.moved(points.astype(np.float32), matrix, matrix[0]), *portable.eigh(matrix + matrix.T),
        *portable.svd3(matrix), np.array([portable.dot(points[:, 0], points[:, 1]), portable.norm(points[:, 2])]),
    ):  # fmt: skip
        digest.update(np.ascontiguousarray(values).tobytes())
    assert digest.hexdigest()[:16] == "79737bb6c69bebf9"
