"""The local order of an unknown one-step map, and the leading term of its modified equation, fitted.

The difference of one step from the exact flow is dt^(p+1) (a combination of elementary differentials) + ...;
p is the local order (Hairer, Lubich and Wanner 2006, Geometric numerical integration, IX.1).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.one_step_maps.first_order import gyroscopic
from bodycheck.reference_impl.one_step_maps.one_step_map import Motion, Solid, times
from bodycheck.reference_impl.rotations import conjugate, cross, log_quaternion, quaternion_product

_LARGEST_ORDER = 3  # of the orders whose terms are fitted
_NEGLIGIBLE = 0.01  # of the largest coefficient's term: a smaller one is not named

_Terms: TypeAlias = Mapping[str, Callable[[Solid, Array], Array]]


def _rate(solid: Solid, omega: Array) -> Array:
    """f = -I^-1 (omega x I omega)."""
    return -times(solid.inverse, gyroscopic(solid, omega))


def _bilinear(solid: Solid, a: Array, b: Array) -> Array:
    """f''(a, b) = -I^-1 (a x I b + b x I a); f'(omega) b = f''(omega, b), as f is quadratic."""
    turning = cross(a, times(solid.inertia, b)) + cross(b, times(solid.inertia, a))
    return -times(solid.inverse, turning)


def _second(solid: Solid, omega: Array) -> Array:
    """f' f."""
    return _bilinear(solid, omega, _rate(solid, omega))


def _dot(a: Array, b: Array) -> Array:
    return np.sum(a * b, axis=-1, keepdims=True)


_OMEGA_TERMS: Mapping[int, _Terms] = {
    0: {
        "omega": lambda _, w: w,
        "|omega| omega": lambda _, w: np.linalg.norm(w, axis=-1, keepdims=True) * w,
        "f": _rate,
    },
    1: {"f'f": _second, "|omega|^2 omega": lambda _, w: _dot(w, w) * w},
    2: {
        "f'f'f": lambda s, w: _bilinear(s, w, _second(s, w)),
        "f''(f,f)": lambda s, w: _bilinear(s, _rate(s, w), _rate(s, w)),
    },
    3: {
        "f'f'f'f": lambda s, w: _bilinear(s, w, _bilinear(s, w, _second(s, w))),
        "f'f''(f,f)": lambda s, w: _bilinear(s, w, _bilinear(s, _rate(s, w), _rate(s, w))),
        "f''(f,f'f)": lambda s, w: _bilinear(s, _rate(s, w), _second(s, w)),
    },
}
_ANGLE_TERMS: Mapping[int, _Terms] = {
    0: {"omega": lambda _, w: w},
    1: {"f": _rate},
    2: {
        "f'f": _second,
        "omega x f": lambda s, w: cross(w, _rate(s, w)),
        "|omega|^2 omega": lambda _, w: _dot(w, w) * w,
    },
    3: {
        "f'f'f": lambda s, w: _bilinear(s, w, _second(s, w)),
        "f''(f,f)": lambda s, w: _bilinear(s, _rate(s, w), _rate(s, w)),
        "omega x f'f": lambda s, w: cross(w, _second(s, w)),
        "omega x (omega x f)": lambda s, w: cross(w, cross(w, _rate(s, w))),
        "|omega|^2 f": lambda s, w: _dot(w, w) * _rate(s, w),
        "(omega . f) omega": lambda s, w: _dot(w, _rate(s, w)) * w,
    },
}


@dataclass(frozen=True)
class LeadingError:
    """order: the local order p. omega, angle: coefficients of the terms of a step's error over dt^(p+1).

    residual: the share of the error that these terms leave, 0 to 1; None where no terms are known.
    """

    order: float
    omega: Mapping[str, float]
    angle: Mapping[str, float]
    residual: float | None

    @property
    def text(self) -> str:
        """The order and the leading term, such as "order 1: omega += dt^2 (-0.5 f'f), f = omega'"."""
        if not math.isfinite(self.order):
            return "no local order"
        p = round(self.order)
        power = "dt" if p == 0 else f"dt^{p + 1}"
        parts = [
            f"{name} error {power} ({_sum_in_words(terms)})"
            for name, terms in (("omega", self.omega), ("angle", self.angle))
            if terms
        ]
        if not parts:
            return f"local order {self.order:.2f}"
        left = "" if self.residual is None else f", {100.0 * self.residual:.2g} % left"
        return f"local order {self.order:.2f}: {'; '.join(parts)}, f = omega'{left}"


def _sum_in_words(terms: Mapping[str, float]) -> str:
    return " ".join(f"{value:+.4g} {name}" for name, value in terms.items())


def leading_error(
    solid: Solid, before: Motion, after: Motion, exact: Motion, dt: Array, level: NDArray[np.intp]
) -> LeadingError:
    """Return the local order over several step sizes, and the fitted terms for torque-free steps.

    before, after, exact: states before n steps of dt (n,), after them, and those of the exact flow. level
    (n,): 0 for the coarsest steps from each start, then 1 for half of them, and so on.
    """
    turned = quaternion_product(conjugate(exact.quaternion), after.quaternion)
    errors = {"omega": after.omega - exact.omega, "angle": log_quaternion(turned)}
    orders = {name: _order(error, level) for name, error in errors.items()}
    order = min(orders.values())
    p = round(order) if np.isfinite(order) else -1
    if not 0 <= p <= _LARGEST_ORDER:
        return LeadingError(order, {}, {}, None)
    fitted: dict[str, dict[str, float]] = {"omega": {}, "angle": {}}
    left = total = 0.0
    for name, terms in (("omega", _OMEGA_TERMS[p]), ("angle", _ANGLE_TERMS[p])):
        if orders[name] > p + 0.5:
            continue
        scaled = errors[name] / dt[:, None] ** (p + 1)
        columns = np.stack([term(solid, before.omega) for term in terms.values()], axis=-1)
        finest = int(np.max(level))
        fine, coarse = (_fitted(columns[level == at], scaled[level == at]) for at in (finest, finest - 1))
        at_finest = scaled[level == finest]
        left += float(np.sum((at_finest - columns[level == finest] @ fine) ** 2))
        total += float(np.sum(at_finest**2))
        coefficients = 2.0 * fine - coarse
        parts = np.abs(coefficients) * np.sqrt(np.mean(np.sum(columns**2, axis=1), axis=0))
        fitted[name] = {
            term: float(value)
            for term, value, part in zip(terms, coefficients, parts, strict=True)
            if part > _NEGLIGIBLE * float(np.max(parts))
        }
    return LeadingError(
        order, fitted["omega"], fitted["angle"], float(np.sqrt(left / total)) if total else None
    )


def _order(error: Array, level: NDArray[np.intp]) -> float:
    """log2 of the ratio of the errors at the two finest levels, less 1; infinite without an error."""
    finest = int(np.max(level))
    fine, coarse = (float(np.sqrt(np.mean(error[level == at] ** 2))) for at in (finest, finest - 1))
    return float(np.log2(coarse / fine)) - 1.0 if fine > 0.0 else float("inf")


def _fitted(columns: Array, values: Array) -> Array:
    """Return the coefficients (k,) of columns (n, 3, k) that fit values (n, 3) in the least squares."""
    found, *_ = np.linalg.lstsq(columns.reshape(-1, columns.shape[-1]), values.ravel(), rcond=None)
    return np.asarray(found)
