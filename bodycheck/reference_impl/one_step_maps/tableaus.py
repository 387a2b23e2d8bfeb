"""Runge-Kutta tableaus that engines and textbooks use, explicit and implicit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np

from bodycheck.reference_impl.arrays import Array


@dataclass(frozen=True, eq=False)
class NamedTableau:
    """A Runge-Kutta method by its coefficients; c are the sums of the rows of a."""

    name: str
    order: int
    a: Array
    b: Array
    source: str
    symmetric: bool = False

    @cached_property
    def c(self) -> Array:
        """The times of the stages, in steps (stages,)."""
        return np.asarray(np.sum(self.a, axis=1))


def explicit(name: str, order: int, rows: Sequence[str], weights: str, source: str) -> NamedTableau:
    """Return an explicit method from the rows of a below its diagonal and from b, as fractions in words."""
    n = len(rows) + 1
    a = np.zeros((n, n))
    for i, row in enumerate(rows, 1):
        a[i, :i] = [float(Fraction(word)) for word in row.split()]
    return NamedTableau(name, order, a, np.array([float(Fraction(word)) for word in weights.split()]), source)


_I_1, _II_1 = (
    "Hairer, Norsett and Wanner (1993), Solving ODEs I, II.1",
    "Butcher (2016), Numerical methods for ODEs",
)
EXPLICIT = (
    explicit("Heun 2", 2, ["1"], "1/2 1/2", "Heun (1900)"),
    explicit("midpoint", 2, ["1/2"], "0 1", "Runge (1895)"),
    explicit("Ralston 2", 2, ["2/3"], "1/4 3/4", "Ralston (1962)"),
    explicit("RK3 (Kutta)", 3, ["1/2", "-1 2"], "1/6 2/3 1/6", "Kutta (1901); Drake runge_kutta3"),
    explicit("RK3 (Heun)", 3, ["1/3", "0 2/3"], "1/4 0 3/4", "Heun (1900)"),
    explicit("RK3 (Ralston)", 3, ["1/2", "0 3/4"], "2/9 1/3 4/9", "Ralston (1962)"),
    explicit("RK3 (SSP)", 3, ["1", "1/4 1/4"], "1/6 1/6 2/3", "Shu and Osher (1988)"),
    explicit("RK4", 4, ["1/2", "0 1/2", "0 0 1"], "1/6 1/3 1/3 1/6", f"Kutta (1901); {_I_1}"),
    explicit("RK4 (3/8 rule)", 4, ["1/3", "-1/3 1", "1 -1 1"], "1/8 3/8 3/8 1/8", f"Kutta (1901); {_I_1}"),
    explicit(
        "RK4 (Fehlberg)", 4,
        ["1/4", "3/32 9/32", "1932/2197 -7200/2197 7296/2197", "439/216 -8 3680/513 -845/4104"],
        "25/216 0 1408/2565 2197/4104 -1/5", "Fehlberg (1969)",
    ),
    explicit(
        "RK5 (Fehlberg)", 5,
        ["1/4", "3/32 9/32", "1932/2197 -7200/2197 7296/2197", "439/216 -8 3680/513 -845/4104",
         "-8/27 2 -3544/2565 1859/4104 -11/40"],
        "16/135 0 6656/12825 28561/56430 -9/50 2/55", "Fehlberg (1969)",
    ),
    explicit(
        "RK5 (Cash-Karp)", 5,
        ["1/5", "3/40 9/40", "3/10 -9/10 6/5", "-11/54 5/2 -70/27 35/27",
         "1631/55296 175/512 575/13824 44275/110592 253/4096"],
        "37/378 0 250/621 125/594 0 512/1771", "Cash and Karp (1990)",
    ),
    explicit(
        "RK5 (Dormand-Prince)", 5,
        ["1/5", "3/40 9/40", "44/45 -56/15 32/9", "19372/6561 -25360/2187 64448/6561 -212/729",
         "9017/3168 -355/33 46732/5247 49/176 -5103/18656"],
        "35/384 0 500/1113 125/192 -2187/6784 11/84", "Dormand and Prince (1980); Drake runge_kutta5",
    ),
    explicit(
        "RK5 (Butcher)", 5,
        ["1/4", "1/8 1/8", "0 -1/2 1", "3/16 0 0 9/16", "-3/7 2/7 12/7 -12/7 8/7"],
        "7/90 0 32/90 12/90 32/90 7/90", _II_1,
    ),
    explicit(
        "RK5 (Nystrom)", 5,
        ["1/3", "4/25 6/25", "1/4 -3 15/4", "2/27 10/9 -50/81 8/81", "2/25 12/25 2/15 8/75 0"],
        "23/192 0 125/192 0 -27/64 125/192", f"Nystrom (1925); {_I_1}",
    ),
)  # fmt: skip

CROUCH_GROSSMAN_3 = explicit(
    "CG3",
    3,
    ["3/4", "119/216 17/108"],
    "13/51 -2/3 24/17",
    "Crouch and Grossman (1993), J. Nonlinear Sci. 3, 1",
)

_ROOT_3, _ROOT_6 = float(np.sqrt(3.0)), float(np.sqrt(6.0))
IMPLICIT = (
    NamedTableau("backward Euler", 1, np.array([[1.0]]), np.array([1.0]), "Drake implicit_euler, radau1"),
    NamedTableau("Gauss 2", 2, np.array([[0.5]]), np.array([1.0]), "implicit midpoint rule", symmetric=True),
    NamedTableau(
        "Lobatto IIIA 2", 2, np.array([[0.0, 0.0], [0.5, 0.5]]), np.array([0.5, 0.5]),
        "the trapezoidal rule", symmetric=True,
    ),
    NamedTableau(
        "Radau IIA 3", 3, np.array([[5.0, -1.0], [9.0, 3.0]]) / 12.0, np.array([0.75, 0.25]), "Drake radau3"
    ),
    NamedTableau(
        "Gauss 4", 4,
        np.array([[0.25, 0.25 - _ROOT_3 / 6.0], [0.25 + _ROOT_3 / 6.0, 0.25]]), np.array([0.5, 0.5]),
        "Kuntzmann (1961); Butcher (1964)", symmetric=True,
    ),
    NamedTableau(
        "Lobatto IIIA 4", 4,
        np.array([[0.0, 0.0, 0.0], [5.0, 8.0, -1.0], [4.0, 16.0, 4.0]]) / 24.0,
        np.array([1.0, 4.0, 1.0]) / 6.0, "Ehle (1969)", symmetric=True,
    ),
    NamedTableau(
        "Radau IIA 5", 5,
        np.array([
            [(88 - 7 * _ROOT_6) / 360, (296 - 169 * _ROOT_6) / 1800, (-2 + 3 * _ROOT_6) / 225],
            [(296 + 169 * _ROOT_6) / 1800, (88 + 7 * _ROOT_6) / 360, (-2 - 3 * _ROOT_6) / 225],
            [(16 - _ROOT_6) / 36, (16 + _ROOT_6) / 36, 1 / 9],
        ]),
        np.array([(16 - _ROOT_6) / 36, (16 + _ROOT_6) / 36, 1 / 9]), "Hairer and Wanner (1996), IV.5",
    ),
)  # fmt: skip
