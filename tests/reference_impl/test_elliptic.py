"""Elliptic integrals and functions compared with mpmath, at log-uniform parameters."""

from __future__ import annotations

import math
from typing import Any

import mpmath
import numpy as np
import pytest

from bodycheck.reference_impl import elliptic
from bodycheck.reference_impl.kernels import double_double as dd

EPS = float(np.finfo(np.float64).eps)
MP = mpmath.MPContext()
MP.dps = 60
RNG = np.random.default_rng(20240612)

SMALL = [float(10.0**-e) for e in (0.31, 1.0, 1.7, 3.0, 6.0, 9.0, 12.0, 15.0, 16.2, 19.0)]
PARAMETERS = [0.0, *SMALL, *(1.0 - m for m in SMALL[:8]), 1.0]
"""m1, from the separatrix to the circular functions."""
# the series change at K = 2 K', k' = (sqrt 2 - 1)^2
SWITCH = float((MP.sqrt(2) - 1) ** 4)
MODULI = [1.0, 1.0 - 1e-16, 1.0 - 1e-9, 0.7, 0.1, 1e-3, 1e-9, 1e-16, 1e-80, 1e-160, 1e-250]


def exact(x: tuple[float, float]) -> Any:
    """Return the exact sum of a double-double as a 60-digit number."""
    return MP.mpf(x[0]) + MP.mpf(x[1])


def true_functions(u: float, m1: float) -> tuple[Any, Any, Any]:
    """(sn, cn, dn) at 60 digits."""
    if m1 == 0.0:
        return MP.tanh(u), MP.sech(u), MP.sech(u)
    m = 1 - MP.mpf(m1)
    quarter = MP.pi / (2 * MP.agm(1, MP.sqrt(m1)))
    n = MP.nint(u / (2 * quarter))
    v = u - 2 * n * quarter
    sign = -1 if int(n) % 2 else 1
    sn, cn, dn = (MP.ellipfun(kind, v, m=m) for kind in ("sn", "cn", "dn"))
    return sign * sn, sign * cn, dn


@pytest.mark.parametrize("m1", [*PARAMETERS, SWITCH, 0.99 * SWITCH, 1.01 * SWITCH])
def test_jacobi(m1: float) -> None:
    """sn, cn and dn are accurate to 2e-15, and to 4e-15 relative, at their zeros and many periods away."""
    quarter = float(MP.ellipk(1 - MP.mpf(m1))) if m1 else 20.0
    arguments = [0.0, 1e-30, 1e-9, -0.3, 0.5 * quarter, quarter, 0.999 * quarter, *RNG.normal(size=8)]
    if m1:
        arguments += [quarter * (1.0 + 1e-9), 2.0 * quarter, -7.3 * quarter, 1e3, -1e9, 1e12]
    for u in arguments:
        for found, true in zip(elliptic.jacobi(float(u), m1), true_functions(float(u), m1), strict=True):
            assert abs(found - true) <= 2e-15
            assert abs(found - true) <= 4e-15 * abs(true) + 1e-55  # mpmath's own zeros are off by 1e-60


@pytest.mark.parametrize("u", [2.0, -40.0, 1e12])
def test_jacobi_test_detects_a_wrong_parameter(u: float) -> None:
    """A parameter that is off by 1e-13 exceeds the bound of the test above."""
    found = elliptic.jacobi(u, 0.3 * (1.0 + 1e-13))
    true = true_functions(u, 0.3)
    assert max(abs(a / b - 1) for a, b in zip(found, true, strict=True)) > 4e-15


@pytest.mark.parametrize("m1", PARAMETERS)
def test_jacobi_identities(m1: float) -> None:
    """sn^2 + cn^2 = 1, dn^2 = cn^2 + m1 sn^2; sn and its ratios are odd, cn and dn even."""
    for u in RNG.normal(size=20) * 5.0:
        sn, cn, dn = elliptic.jacobi(float(u), m1)
        assert abs(sn * sn + cn * cn - 1.0) < 8.0 * EPS
        assert abs(dn * dn - cn * cn - m1 * sn * sn) < 8.0 * EPS
        assert elliptic.jacobi(-float(u), m1) == (-sn, cn, dn)


@pytest.mark.parametrize("m1", [-1e-9, 1.0 + 1e-9, math.nan])
def test_parameter_outside_its_range_is_refused(m1: float) -> None:
    """A parameter outside [0, 1] is refused."""
    with pytest.raises(ValueError, match="m1"):
        elliptic.jacobi(0.5, m1)


def test_jacobi_limits() -> None:
    """m1 = 1 gives the circular functions, m1 = 0 the hyperbolic ones, at any argument."""
    for u in RNG.normal(size=20) * 3.0:
        assert elliptic.jacobi(float(u), 1.0) == pytest.approx((math.sin(u), math.cos(u), 1.0), abs=4.0 * EPS)
        hyperbolic = (math.tanh(u), 1.0 / math.cosh(u), 1.0 / math.cosh(u))
        assert elliptic.jacobi(float(u), 0.0) == pytest.approx(hyperbolic, abs=4.0 * EPS)
    assert elliptic.jacobi(1e9, 0.0) == (1.0, 0.0, 0.0)


def arguments_of_integrals(count: int) -> list[list[float]]:
    """Return x, y, z, log-uniform over 24 decades and uniform, some of them zero, some equal."""
    rows = [*10.0 ** RNG.uniform(-12.0, 12.0, size=(count, 3)), *RNG.uniform(0.01, 1.0, size=(count, 3))]
    for i, row in enumerate(rows):
        row[i % 3] *= i % 4 != 0
        row[1] = row[2] if i % 7 == 0 and row[0] > 0.0 else row[1]
    return [[float(x) for x in row] for row in rows if np.count_nonzero(row == 0.0) < 2]


def test_carlson_rf() -> None:
    """R_F is accurate to 1e-15 in any order of its arguments."""
    for x, y, z in arguments_of_integrals(150):
        true = MP.elliprf(x, y, z)
        assert abs(elliptic.carlson_rf(x, y, z) / true - 1) < 1e-15
        assert abs(elliptic.carlson_rf(z, x, y) / true - 1) < 1e-15


def test_carlson_limits() -> None:
    """Equal arguments give x^-1/2, and two zeros give infinity."""
    for x in (1e-9, 0.3, 7.0):
        assert elliptic.carlson_rf(x, x, x) == pytest.approx(x**-0.5, rel=4.0 * EPS, abs=0.0)
    assert elliptic.carlson_rf(0.0, 2.0, 0.0) == math.inf


@pytest.mark.parametrize("kc", MODULI)
def test_complete_k(kc: float) -> None:
    """K is accurate to 1e-30 however close to the separatrix."""
    true = MP.pi / (2 * MP.agm(1, MP.mpf(kc)))
    assert abs(exact(elliptic.complete_k((kc, 0.0))) / true - 1) < 1e-30


def test_complete_k_on_the_separatrix() -> None:
    """K is infinite at k' = 0."""
    assert elliptic.complete_k(dd.ZERO)[0] == math.inf


@pytest.mark.parametrize("p", [1e-15, 1e-3, 0.5, 1.0, 3.0, 1e6, 1e15])
@pytest.mark.parametrize("kc", MODULI[:8])
def test_complete_integral_matches_carlsons(kc: float, p: float) -> None:
    """Bulirsch's cel is accurate to 1e-29 for both of its terms, compared with Carlson's R_F and R_J."""
    sine = MP.elliprj(0, MP.mpf(kc) ** 2, 1, p) / 3
    cosine = MP.elliprf(0, MP.mpf(kc) ** 2, 1) - p * sine
    pair = (kc, 0.0), (p, 0.0)
    assert abs(exact(elliptic.complete_integral(*pair, dd.ZERO, dd.ONE)) / sine - 1) < 1e-29
    assert abs(exact(elliptic.complete_integral(*pair, dd.ONE, dd.ZERO)) / cosine - 1) < 1e-29


@pytest.mark.parametrize("y", [1.0, 0.999, 0.3, 1e-5, 1e-16, 1e-160])
@pytest.mark.parametrize("x", [1.0, 0.5, 1e-3, 1e-9, 1e-160, 0.0])
def test_carlson_rf_of_squares(x: float, y: float) -> None:
    """R_F(x^2, y^2, 1) is accurate to 1e-30 if x^2 and y^2 are no longer doubles."""
    true = MP.elliprf(MP.mpf(x) ** 2, MP.mpf(y) ** 2, 1)
    assert abs(exact(elliptic.carlson_rf_of_squares((x, 0.0), (y, 0.0), dd.ONE)) / true - 1) < 1e-30


def test_carlson_rf_of_squares_of_zeros() -> None:
    """Two zeros give infinity."""
    assert elliptic.carlson_rf_of_squares(dd.ZERO, dd.ZERO, dd.ONE)[0] == math.inf
