"""Rotations against 50-digit arithmetic, SciPy, and the laws of the rotation group."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import (
    conjugate,
    exp_matrix,
    exp_quaternion,
    geodesic_angle,
    hat,
    log_matrix,
    log_quaternion,
    matrix_to_quaternion,
    normalised,
    project_to_so3,
    quaternion_product,
    quaternion_rate,
    quaternion_to_matrix,
    right_factor,
    rotate,
    rotation_rate,
    vee,
)

EPS = float(np.finfo(np.float64).eps)
PI = math.pi
MP = mpmath.MPContext()
MP.dps = 50

law = settings(derandomize=True, deadline=None, max_examples=200, database=None)

components = st.floats(-1.0, 1.0, allow_subnormal=False)
vectors = (
    st.tuples(components, components, components).map(np.array).filter(lambda v: np.max(np.abs(v)) > 1e-3)
)
quaternions = (
    st.tuples(components, components, components, components)
    .map(np.array)
    .filter(lambda q: np.max(np.abs(q)) > 1e-3)
    .map(lambda q: q / np.linalg.norm(q))
)
axes = vectors.map(lambda v: v / np.linalg.norm(v))
log_uniform_angles = st.floats(math.log(1e-200), math.log(PI)).map(math.exp)
"""Down to 1e-200, so that no switch at 1e-4, 1e-8 or sqrt(eps) lies between two examples."""

FIXED_ANGLES = (
    1e-300,
    1e-200,
    1e-162,
    1e-100,
    1e-17,
    1e-9,
    1.49e-8,
    1.5e-8,
    1e-5,
    1e-4,
    0.1,
    PI / 2,
    3.0,
    PI,
)


def seeded(seed: int) -> np.random.Generator:
    """Return a separate generator for each test."""
    return np.random.default_rng(seed)


def unit_quaternions(count: int, seed: int) -> Array:
    """Return uniformly distributed unit quaternions (count, 4)."""
    return normalised(seeded(seed).normal(size=(count, 4)))


# ------------------------------------------------------------------------ the same in fifty digits


def mp_vector(v: Sequence[float] | Array) -> Any:
    """Return v with fifty digits as a column."""
    return MP.matrix([MP.mpf(float(x)) for x in v])


def mp_norm(v: Any) -> Any:
    """|v| in fifty digits."""
    return MP.sqrt(sum((x * x for x in v), MP.mpf(0)))


def mp_hat(v: Any) -> Any:
    """[v]x in fifty digits."""
    return MP.matrix([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def mp_exp_matrix(v: Any) -> Any:
    """exp([v]x) in fifty digits; 1 - cos = 2 sin^2 of the half angle."""
    angle, k = mp_norm(v), mp_hat(v)
    if angle == 0:
        return MP.eye(3)
    return MP.eye(3) + MP.sin(angle) / angle * k + 2 * (MP.sin(angle / 2) / angle) ** 2 * (k * k)


def mp_exp_quaternion(v: Any) -> list[Any]:
    """exp(v / 2) in fifty digits."""
    angle = mp_norm(v)
    factor = MP.sin(angle / 2) / angle if angle else MP.mpf("0.5")
    return [MP.cos(angle / 2), *(factor * x for x in v)]


def mp_angle(p: Array, q: Array) -> Any:
    """Return the angle of p^-1 q for exactly these doubles, in fifty digits or more."""
    with mpmath.workdps(50):
        pw, px, py, pz = mp_vector(p)
        qw, qx, qy, qz = mp_vector(q)
        scalar = pw * qw + px * qx + py * qy + pz * qz
        vector = [
            pw * qx - px * qw - py * qz + pz * qy,
            pw * qy - py * qw - pz * qx + px * qz,
            pw * qz - pz * qw - px * qy + py * qx,
        ]
        return 2 * MP.atan2(mp_norm(vector), abs(scalar))


def largest(values: Any) -> float:
    """Return the largest magnitude of fifty-digit numbers."""
    return max(abs(float(x)) for x in values)


# -------------------------------------------------------------------------------------- hat and vee


@law
@given(vectors, vectors)
def test_hat_is_the_cross_product(v: Array, u: Array) -> None:
    """[v]x u = v x u, and [v]x is skew."""
    assert np.allclose(hat(v) @ u, np.cross(v, u), rtol=0.0, atol=4 * EPS)
    assert np.array_equal(hat(v), -hat(v).T)


@law
@given(vectors)
def test_vee_undoes_hat(v: Array) -> None:
    """vee(hat(v)) is v bit for bit, and vee ignores the symmetric part of a matrix."""
    assert np.array_equal(vee(hat(v)), v)
    assert np.allclose(vee(hat(v) + np.outer(v, v)), v, rtol=0.0, atol=2 * EPS)


# ------------------------------------------------------------------------------------- exp and log


def check_exp(v: Array) -> None:
    """Both exponentials are accurate to a few eps, with small components relative to the angle."""
    exact_matrix, exact_quaternion = mp_exp_matrix(mp_vector(v)), mp_exp_quaternion(mp_vector(v))
    angle = float(mp_norm(mp_vector(v)))
    slack = EPS * (4.0 + angle)  # the angle itself is known to eps |a|
    off = MP.matrix(exp_matrix(v).tolist()) - exact_matrix
    assert largest(off) <= slack
    # entries that vanish with the angle keep their relative accuracy
    skew = vee(exp_matrix(v))
    exact_skew = [(exact_matrix[i, j] - exact_matrix[j, i]) / 2 for i, j in ((2, 1), (0, 2), (1, 0))]
    assert largest(x - y for x, y in zip(skew, exact_skew, strict=True)) <= slack * min(angle, 1.0)
    q = exp_quaternion(v)
    assert abs(float(q[0] - exact_quaternion[0])) <= slack
    assert largest(x - y for x, y in zip(q[1:], exact_quaternion[1:], strict=True)) <= slack * min(angle, 1.0)


@law
@given(axes, log_uniform_angles)
def test_exponentials_match_fifty_digits(axis: Array, angle: float) -> None:
    """exp of an angle of any size is accurate to round-off, with small components relative to the angle."""
    check_exp(angle * axis)


@pytest.mark.parametrize("angle", [*FIXED_ANGLES, 3.2, 2 * PI, 7.0, 100.0])
def test_exponentials_match_fifty_digits_at_special_angles(angle: float) -> None:
    """Both exponentials are accurate at the usual switches, at pi and beyond."""
    for axis in (*np.eye(3), *normalised(seeded(1).normal(size=(5, 3)))):
        check_exp(angle * axis)


def test_exponentials_and_logarithms_at_dense_angles() -> None:
    """Both exponentials are accurate at closely spaced angles where series and closed forms usually meet."""
    rng = seeded(16)
    for angle, axis in zip(np.geomspace(1e-12, PI, 250), normalised(rng.normal(size=(250, 3))), strict=True):
        check_exp(angle * axis)
        v = angle * axis
        assert np.max(np.abs(log_quaternion(exp_quaternion(v)) - v)) <= 8 * EPS * angle or angle == PI
        assert np.max(np.abs(log_matrix(exp_matrix(v)) - v)) <= 16 * EPS * angle or angle == PI


@law
@given(axes, log_uniform_angles)
def test_log_undoes_exp(axis: Array, angle: float) -> None:
    """log(exp(v)) = v relative to |v|, from 1e-200 up to pi, by quaternion and by matrix."""
    v = angle * axis
    if angle > PI - 1e-9:
        return  # either sign of the axis is valid: see the next tests
    assert np.max(np.abs(log_quaternion(exp_quaternion(v)) - v)) <= 8 * EPS * angle
    assert np.max(np.abs(log_matrix(exp_matrix(v)) - v)) <= 16 * EPS * angle


@pytest.mark.parametrize("angle", FIXED_ANGLES)
def test_log_undoes_exp_at_special_angles(angle: float) -> None:
    """log(exp(v)) = v at the usual switches and at pi, where either sign of the axis is valid."""
    for axis in (*np.eye(3), *normalised(seeded(2).normal(size=(5, 3)))):
        v = angle * axis
        for back, slack in (
            (log_quaternion(exp_quaternion(v)), 8 * EPS),
            (log_matrix(exp_matrix(v)), 16 * EPS),
        ):
            sign = np.sign(back @ axis) if angle > PI - 1e-9 else 1.0
            assert np.max(np.abs(sign * back - v)) <= slack * angle


@law
@given(axes, st.floats(1e-300, 100.0))
def test_exp_undoes_log(axis: Array, angle: float) -> None:
    """exp(log(R)) = R for every R, including those of angles beyond pi."""
    rotation = exp_matrix(angle * axis)
    vector = log_matrix(rotation)
    assert np.linalg.norm(vector) <= PI * (1 + 2 * EPS)
    assert np.max(np.abs(exp_matrix(vector) - rotation)) <= EPS * (16.0 + 4 * angle)


@law
@given(axes, log_uniform_angles, st.floats(-150.0, 150.0))
def test_log_takes_either_sign_and_any_norm(axis: Array, angle: float, exponent: float) -> None:
    """log of q, of -q and of c q is the same vector."""
    q = exp_quaternion(min(angle, 3.0) * axis)
    expected = log_quaternion(q)
    assert np.array_equal(log_quaternion(-q), expected)
    scaled = log_quaternion(2.0 ** round(exponent) * np.where(np.abs(q) < 1e-150, 0.0, q))
    kept = log_quaternion(np.where(np.abs(q) < 1e-150, 0.0, q))
    assert np.max(np.abs(scaled - kept)) <= 4 * EPS * np.max(np.abs(kept))


@law
@given(axes, st.floats(PI, 2 * PI - 1e-6))
def test_log_beyond_pi_takes_the_short_way(axis: Array, angle: float) -> None:
    """log(exp(a u)) = (a - 2 pi) u for a between pi and 2 pi."""
    back = log_quaternion(exp_quaternion(angle * axis))
    off = [float(x - (MP.mpf(angle) - 2 * MP.pi) * MP.mpf(float(u))) for x, u in zip(back, axis, strict=True)]
    # the axis has unit length to eps only; near pi it may have either sign
    assert largest(off) <= 16 * EPS or (angle - PI < 1e-9 and np.max(np.abs(back - PI * axis)) < 3e-9)


def test_zero_angle_is_the_identity_both_ways() -> None:
    """exp(0) is exactly the identity, and log of the identity is exactly 0."""
    assert np.array_equal(exp_matrix(np.zeros(3)), np.eye(3))
    assert np.array_equal(exp_quaternion(np.zeros(3)), [1.0, 0.0, 0.0, 0.0])
    assert np.array_equal(log_quaternion(np.array([-1.0, 0.0, 0.0, 0.0])), np.zeros(3))
    assert np.array_equal(log_matrix(np.eye(3)), np.zeros(3))


# ------------------------------------------------------------------------- the group of quaternions


@law
@given(quaternions, quaternions, quaternions)
def test_product_is_associative(p: Array, q: Array, r: Array) -> None:
    """(p q) r = p (q r)."""
    left = quaternion_product(quaternion_product(p, q), r)
    assert np.max(np.abs(left - quaternion_product(p, quaternion_product(q, r)))) <= 8 * EPS


@law
@given(quaternions, quaternions)
def test_right_factor_is_the_product(p: Array, q: Array) -> None:
    """M(q) p = p q, and M(1) leaves every digit of p unchanged."""
    assert np.max(np.abs(right_factor(q) @ p - quaternion_product(p, q))) <= 4 * EPS
    assert np.array_equal(right_factor(np.array([1.0, 0.0, 0.0, 0.0])) @ p, p)


@law
@given(quaternions, quaternions)
def test_product_becomes_the_product_of_matrices(p: Array, q: Array) -> None:
    """R(p q) = R(p) R(q), and |p q| = |p| |q|."""
    product = quaternion_product(p, q)
    assert abs(np.linalg.norm(product) - 1.0) <= 4 * EPS
    gap = quaternion_to_matrix(product) - quaternion_to_matrix(p) @ quaternion_to_matrix(q)
    assert np.max(np.abs(gap)) <= 16 * EPS


def test_hamilton_units() -> None:
    """i j = k, j k = i, k i = j, i i = -1: the product is Hamilton's."""
    one, i, j, k = np.eye(4)
    for a, b, c in ((i, j, k), (j, k, i), (k, i, j)):
        assert np.array_equal(quaternion_product(a, b), c)
        assert np.array_equal(quaternion_product(b, a), -c)
        assert np.array_equal(quaternion_product(a, a), -one)
        assert np.array_equal(quaternion_product(one, a), a)


@law
@given(quaternions)
def test_conjugate_is_the_inverse(q: Array) -> None:
    """q q* = 1 and R(q*) = R(q)^T."""
    assert np.max(np.abs(quaternion_product(q, conjugate(q)) - [1.0, 0.0, 0.0, 0.0])) <= 4 * EPS
    assert np.max(np.abs(quaternion_to_matrix(conjugate(q)) - quaternion_to_matrix(q).T)) <= 4 * EPS


@law
@given(quaternions, vectors, st.floats(-300.0, 300.0))
def test_rotate_is_the_sandwich(q: Array, v: Array, exponent: float) -> None:
    """R(q) v = q v q* takes body axes to world axes, for q of any norm."""
    pure = np.concatenate([[0.0], v])
    sandwich = quaternion_product(quaternion_product(q, pure), conjugate(q))
    assert abs(sandwich[0]) <= 8 * EPS
    assert np.max(np.abs(rotate(10.0**exponent * q, v) - sandwich[1:])) <= 16 * EPS


def test_positive_angle_about_z_takes_x_to_y() -> None:
    """A quarter turn about z takes the body's x axis to the world's y axis."""
    quarter = np.array([0.0, 0.0, PI / 2])
    assert np.max(np.abs(rotate(exp_quaternion(quarter), np.eye(3)[0]) - np.eye(3)[1])) <= 2 * EPS
    assert np.max(np.abs(exp_matrix(quarter) @ np.eye(3)[0] - np.eye(3)[1])) <= 2 * EPS


# ---------------------------------------------------------------------- matrices and quaternions


@pytest.mark.parametrize("branch", range(4))
def test_matrix_to_quaternion_is_right_in_each_branch(branch: int) -> None:
    """The largest component is positive and all four are accurate to round-off, whichever is the largest."""
    q = unit_quaternions(500, seed=branch)
    q[:, branch] += np.copysign(1.5, q[:, branch])
    q = normalised(q)
    q *= np.sign(q[:, branch : branch + 1])
    back = matrix_to_quaternion(quaternion_to_matrix(q))
    assert np.all(back[:, branch] > 0.0)
    assert np.max(np.abs(back - q)) <= 8 * EPS


@law
@given(quaternions)
def test_matrix_and_quaternion_are_inverse(q: Array) -> None:
    """q -> R -> q returns q or -q, and R is a rotation."""
    rotation = quaternion_to_matrix(q)
    # |q|^2 is 1 within 4 eps after a division, and |R^T R - I| <= 4 ||q|^2 - 1| and 4 roundings
    assert np.max(np.abs(rotation.T @ rotation - np.eye(3))) <= 20 * EPS
    assert abs(np.linalg.det(rotation) - 1.0) <= 20 * EPS
    back = matrix_to_quaternion(rotation)
    assert np.max(np.abs(back - np.sign(back @ q) * q)) <= 8 * EPS


@pytest.mark.parametrize("gap", [0.0, 1e-16, 1e-12, 1e-8, 1e-4])
def test_matrix_to_quaternion_is_right_at_half_rotations(gap: float) -> None:
    """At and near the angle pi, where w vanishes, the axis and the small w are accurate to round-off."""
    for axis in (*np.eye(3), *normalised(seeded(3).normal(size=(20, 3)))):
        q = np.concatenate([[math.sin(gap / 2)], math.cos(gap / 2) * axis])
        back = matrix_to_quaternion(quaternion_to_matrix(q))
        assert np.max(np.abs(back - np.sign(back @ q) * q)) <= 8 * EPS


@law
@given(quaternions, st.integers(-1000, 1000))
def test_matrix_of_a_quaternion_of_any_norm(q: Array, exponent: int) -> None:
    """R(c q) = R(q) down to norms whose squares underflow and up to those whose squares overflow."""
    scaled = np.ldexp(np.where(np.abs(q) < 1e-6, 0.0, q), exponent)
    expected = quaternion_to_matrix(np.where(np.abs(q) < 1e-6, 0.0, q))
    assert np.max(np.abs(quaternion_to_matrix(scaled) - expected)) <= 4 * EPS


def test_zero_vector_is_normalised_to_nan() -> None:
    """A zero vector has no direction, so the result is NaN, without a warning."""
    assert np.all(np.isnan(normalised(np.zeros(4))))
    assert np.array_equal(normalised(np.array([0.0, -5e-324, 0.0])), [0.0, -1.0, 0.0])


# ------------------------------------------------------------------------------------------- rates


@pytest.mark.slow
@law
@given(quaternions, vectors)
def test_rates_are_the_derivatives_of_exp(q: Array, omega: Array) -> None:
    """q' and R' are the derivatives at t = 0 of exp(omega t / 2) q and exp([omega]x t) R."""
    h = MP.mpf(10) ** -15
    rotation = quaternion_to_matrix(q)
    forward, backward = (mp_exp_matrix(s * h * mp_vector(omega)) for s in (1, -1))
    derivative = (forward - backward) * MP.matrix(rotation.tolist()) / (2 * h)
    assert largest(derivative - MP.matrix(rotation_rate(rotation, omega).tolist())) <= 8 * EPS
    ahead, behind = (mp_exp_quaternion(s * h * mp_vector(omega)) for s in (1, -1))
    rate = [(a - b) / (2 * h) for a, b in zip(ahead, behind, strict=True)]
    product = quaternion_product(np.array([float(x) for x in rate]), q)
    assert np.max(np.abs(product - quaternion_rate(q, omega))) <= 8 * EPS


@law
@given(quaternions, vectors)
def test_rates_agree_with_each_other(q: Array, omega: Array) -> None:
    """The derivative of R(q) along q' is R' = [omega]x R."""
    h, rate = 1e-6, quaternion_rate(q, omega)
    slope = (quaternion_to_matrix(q + h * rate) - quaternion_to_matrix(q - h * rate)) / (2 * h)
    # truncation h^2 |omega|^3 / 6 < 1e-12, round-off eps / h = 2e-10
    assert np.max(np.abs(slope - rotation_rate(quaternion_to_matrix(q), omega))) <= 2e-9


# ------------------------------------------------------------------------------------ the distance


def turned(p: Array, angle: float, rng: np.random.Generator) -> Array:
    """Return p rotated by this angle about a random axis, with its rounding."""
    axis = normalised(rng.normal(size=3))
    return quaternion_product(p, exp_quaternion(angle * axis))


ANGLES = (0.0, 1e-18, 1e-17, 1e-16, 1e-15, 1e-12, 1e-8, 1e-3, 1.0, 3.0, PI - 1e-3, PI - 1e-8, PI - 1e-15, PI)


@pytest.mark.parametrize("angle", ANGLES)
def test_geodesic_angle_is_accurate(angle: float) -> None:
    """The angle between quaternions has a small relative error, down to 1e-18."""
    rng = seeded(4)
    for p in unit_quaternions(100, seed=5):
        q = turned(p, angle, rng)
        exact = float(mp_angle(p, q))
        # q - p is exact if they are close; four products and three sums of the remainder
        assert abs(geodesic_angle(p, q) - exact) <= 8 * EPS * exact
        assert abs(geodesic_angle(3.0 * p, 0.7 * q) - exact) <= 8 * EPS


def test_geodesic_angle_between_multiples_is_zero() -> None:
    """q and c q are the same orientation, for c within an ulp or two of 1 and for any other c."""
    p = np.array([0.5, 0.5, 0.5, 0.5])
    for factor in (1 + EPS, 1 + 2 * EPS, 1 - EPS, 3.0, 0.1):
        assert geodesic_angle(p, factor * p) == 0.0


@law
@given(quaternions, quaternions)
def test_geodesic_angle_is_symmetric(p: Array, q: Array) -> None:
    """The angle is symmetric, and the same for -q."""
    angle = geodesic_angle(p, q)
    assert 0.0 <= angle <= PI
    assert geodesic_angle(p, -q) == angle == geodesic_angle(-p, q)
    assert abs(geodesic_angle(q, p) - angle) <= 8 * EPS


@pytest.mark.parametrize("factor", [1e-100, 1e-20, 1e-10, 1e-2, 3.0, 1e20])
def test_geodesic_angle_does_not_depend_on_norms(factor: float) -> None:
    """The angle to c q equals that to q, and the angle from c p that from p, for any c."""
    for p, q in zip(unit_quaternions(100, seed=17), unit_quaternions(100, seed=18), strict=True):
        angle = geodesic_angle(p, q)
        assert abs(geodesic_angle(p, factor * q) - angle) <= 8 * EPS
        assert abs(geodesic_angle(factor * p, q) - angle) <= 8 * EPS


@pytest.mark.parametrize("size", [1e-200, 1e200])
def test_geodesic_angle_of_extreme_norms(size: float) -> None:
    """If the squares of both norms underflow or overflow, the angle is still accurate, without a warning."""
    p, q = np.array([0.8, 0.0, 0.6, 0.0]), np.array([0.6, 0.8, 0.0, 0.0])
    assert abs(geodesic_angle(size * p, size * q) - geodesic_angle(p, q)) <= 8 * EPS


@law
@given(quaternions, quaternions, quaternions)
def test_geodesic_angle_is_an_invariant_distance(p: Array, q: Array, r: Array) -> None:
    """The triangle inequality holds, and rotating both from the left or the right changes nothing."""
    angle = geodesic_angle(p, q)
    assert angle <= geodesic_angle(p, r) + geodesic_angle(r, q) + 16 * EPS
    assert abs(geodesic_angle(quaternion_product(r, p), quaternion_product(r, q)) - angle) <= 16 * EPS
    assert abs(geodesic_angle(quaternion_product(p, r), quaternion_product(q, r)) - angle) <= 16 * EPS


@law
@given(quaternions)
def test_geodesic_angle_to_itself_is_zero(q: Array) -> None:
    """The angle of q to itself is exactly 0, and to itself rotated by half a revolution it is pi."""
    assert geodesic_angle(q, q) == 0.0
    assert geodesic_angle(q, -q) == 0.0
    assert abs(geodesic_angle(q, quaternion_product(q, np.eye(4)[2])) - PI) <= 8 * EPS


# -------------------------------------------------------------------------------------- projection


def is_rotation(matrix: Array) -> bool:
    """Assert that R^T R = I and det R = +1 to round-off."""
    orthogonal = np.max(np.abs(matrix.T @ matrix - np.eye(3))) <= 16 * EPS
    return bool(orthogonal and abs(np.linalg.det(matrix) - 1.0) <= 16 * EPS)


@law
@given(quaternions, st.lists(components, min_size=9, max_size=9), st.floats(-16.0, 0.5))
def test_projection_is_a_rotation_and_a_critical_point(q: Array, noise: list[float], exponent: float) -> None:
    """The result is a rotation and R^T M is symmetric, as at every critical point of |M - R|.

    To 2 (16 + 2 * 3) eps |M|: an R that is orthogonal to 16 eps, and two products of three terms. Of 200,000
    random matrices, 6 exceed 32 eps |M| and none 36 eps |M|.
    """
    matrix = quaternion_to_matrix(q) + 10.0**exponent * np.array(noise).reshape(3, 3)
    nearest = project_to_so3(matrix)
    assert is_rotation(nearest)
    stretch = nearest.T @ matrix
    assert np.max(np.abs(stretch - stretch.T)) <= 44 * EPS * max(1.0, float(np.linalg.norm(matrix)))


@pytest.mark.parametrize("seed", range(20))
def test_projection_is_the_nearest_rotation(seed: int) -> None:
    """No rotation is closer, locally or globally, also for reflections and singular matrices."""
    rng = seeded(seed)
    matrix = rng.normal(size=(3, 3))
    if seed % 4 == 0:
        matrix[:, 2] = 1e-9 * matrix[:, 2] + matrix[:, 0]  # nearly singular
    if seed % 4 == 1:
        matrix *= -np.sign(np.linalg.det(matrix))  # changes the sign of the determinant
    nearest = project_to_so3(matrix)
    assert is_rotation(nearest)
    distance = np.linalg.norm(matrix - nearest)
    beside = nearest @ exp_matrix(10.0 ** rng.uniform(-7, 0.4, size=(2000, 1)) * rng.normal(size=(2000, 3)))
    anywhere = quaternion_to_matrix(unit_quaternions(2000, seed=100 + seed))
    for others in (beside, anywhere):
        assert np.min(np.linalg.norm(matrix - others, axis=(1, 2))) >= distance - 8 * EPS


@pytest.mark.parametrize(
    "matrix",
    [
        -np.eye(3),
        np.diag([1.0, 1.0, -1.0]),
        np.diag([1.0, 1.0, 0.0]),
        np.diag([1.0, 0.0, 0.0]),
        np.zeros((3, 3)),
        np.ones((3, 3)),
        np.diag([1e-300, 1e-300, -1e-300]),
        np.diag([1e150, 1.0, -1e-150]),
    ],
)
def test_projection_of_reflections_and_singular_matrices(matrix: Array) -> None:
    """Every finite matrix gives a proper rotation."""
    assert is_rotation(project_to_so3(matrix))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_projection_of_a_matrix_that_is_not_finite_is_nan(value: float) -> None:
    """The others of a stack are projected as if they were alone."""
    stack = np.stack([np.eye(3), 2.0 * np.eye(3), np.diag([1.0, 1.0, -1.0])])
    alone = [project_to_so3(matrix) for matrix in stack]
    stack[1, 0, 2] = value
    found = project_to_so3(stack)
    assert np.isnan(found[1]).all()
    assert np.array_equal(found[[0, 2]], [alone[0], alone[2]])
    assert np.isnan(project_to_so3(stack[1])).all()


@law
@given(quaternions)
def test_projection_keeps_rotations(q: Array) -> None:
    """A rotation is its own projection, and a second projection changes nothing."""
    rotation = quaternion_to_matrix(q)
    once = project_to_so3(rotation)
    assert np.max(np.abs(once - rotation)) <= 16 * EPS
    assert np.max(np.abs(project_to_so3(once) - once)) <= 16 * EPS


def test_projection_of_a_stretched_rotation_is_the_rotation() -> None:
    """R S with S symmetric and positive definite projects to R, as in the polar decomposition."""
    rng = seeded(10)
    for q in unit_quaternions(50, seed=11):
        a = rng.normal(size=(3, 3))
        stretch = a @ a.T + 0.5 * np.eye(3)
        rotation = quaternion_to_matrix(q)
        condition = np.linalg.cond(stretch)
        assert np.max(np.abs(project_to_so3(rotation @ stretch) - rotation)) <= 16 * EPS * condition


# ------------------------------------------------------------------- batches, comparison with SciPy


@pytest.mark.parametrize(
    ("function", "shapes"),
    [
        (hat, [(3,)]),
        (vee, [(3, 3)]),
        (exp_matrix, [(3,)]),
        (exp_quaternion, [(3,)]),
        (log_quaternion, [(4,)]),
        (log_matrix, [(3, 3)]),
        (quaternion_product, [(4,), (4,)]),
        (conjugate, [(4,)]),
        (quaternion_to_matrix, [(4,)]),
        (matrix_to_quaternion, [(3, 3)]),
        (rotate, [(4,), (3,)]),
        (quaternion_rate, [(4,), (3,)]),
        (rotation_rate, [(3, 3), (3,)]),
        (geodesic_angle, [(4,), (4,)]),
        (project_to_so3, [(3, 3)]),
        (normalised, [(4,)]),
    ],
)
def test_batches_equal_single_calls(function: Callable[..., Array], shapes: list[tuple[int, ...]]) -> None:
    """A call on (2, 5, ...) gives what ten single calls give, to an ulp; an empty batch is empty."""
    rng = seeded(12)

    def made(shape: tuple[int, ...], batch: tuple[int, ...]) -> Array:
        if shape == (3, 3):
            return quaternion_to_matrix(rng.normal(size=(*batch, 4)))
        return normalised(rng.normal(size=(*batch, *shape)))

    arguments = [made(shape, (2, 5)) for shape in shapes]
    together = np.asarray(function(*arguments))
    for i in range(2):
        for j in range(5):
            single = function(*(argument[i, j] for argument in arguments))
            assert np.allclose(together[i, j], single, rtol=0.0, atol=4 * EPS)
    assert function(*(argument[:0] for argument in arguments)).shape == (0, *together.shape[1:])


def scalar_last(q: Array) -> Array:
    """Reorder (w, x, y, z) as SciPy does."""
    return np.roll(q, -1, axis=-1)


def test_scipy_agrees() -> None:
    """Conversions, products, exponentials, logarithms and distances equal SciPy's to round-off."""
    p, q = unit_quaternions(1000, seed=13), unit_quaternions(1000, seed=14)
    v = seeded(15).normal(size=(1000, 3))
    first, second = Rotation.from_quat(scalar_last(p)), Rotation.from_quat(scalar_last(q))
    assert np.max(np.abs(quaternion_to_matrix(p) - first.as_matrix())) <= 8 * EPS
    assert np.max(np.abs(rotate(p, v) - first.apply(v))) <= 8 * EPS * np.max(np.abs(v))
    assert (
        np.max(np.abs(quaternion_to_matrix(quaternion_product(p, q)) - (first * second).as_matrix()))
        <= 16 * EPS
    )
    assert np.max(np.abs(quaternion_to_matrix(conjugate(p)) - first.inv().as_matrix())) <= 8 * EPS
    assert np.max(np.abs(log_quaternion(p) - first.as_rotvec())) <= 16 * EPS * PI
    assert np.max(np.abs(exp_matrix(v) - Rotation.from_rotvec(v).as_matrix())) <= 16 * EPS * PI
    assert (
        np.max(np.abs(exp_quaternion(v) - np.roll(Rotation.from_rotvec(v).as_quat(), 1, axis=-1))) <= 16 * EPS
    )
    assert np.max(np.abs(geodesic_angle(p, q) - (first.inv() * second).magnitude())) <= 16 * EPS * PI
    back = np.roll(Rotation.from_matrix(first.as_matrix()).as_quat(), 1, axis=-1)
    ours = matrix_to_quaternion(first.as_matrix())
    assert np.max(np.abs(ours - back * np.sign(np.sum(ours * back, axis=-1, keepdims=True)))) <= 8 * EPS
