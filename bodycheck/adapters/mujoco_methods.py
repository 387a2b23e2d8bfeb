"""MuJoCo's integrators on one body, by its version: what a name stands for changed several times in 2026.

Each change was found by `bodycheck versions mujoco --since 3.6`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace

from bodycheck.adapters.contract import DEFAULTS, VARIANT, Method

_MANUAL = "MuJoCo documentation, Computation, Numerical integration"
_KEEPS = "|q| = 1; linear momentum"
_OFF = ("autoreset off", "constraints, contacts, springs, dampers and sensors off")
_CHANGED = (*_OFF, "the free joint of a body with a link frame aligned")
_BY_THE_ORIGIN = (
    "; v and x of the link's origin are stepped, v += h (F / m - d(omega x c)/dt), c the centre of mass"
)
_EXPLICIT = "omega += h I^-1 (tau - omega x I omega); q = q exp(h omega)"
_IMPLICIT = (
    "omega += h (I + h D)^-1 (tau - omega x I omega), D = d(omega x I omega)/domega; q = q exp(h omega)"
)
_MIDPOINT = "omega += h I^-1 (tau - m x I m), m the mean of omega before and after; q = q exp(h m)"


def methods_of(version: str) -> dict[str, Method]:
    """Return what is known of each integrator, by its name, in a version like "3.8.1"."""
    numbers = tuple(int(number) for number in re.findall(r"\d+", version)[:3])
    midpoint = numbers >= (3, 7)
    implicit = _MIDPOINT if midpoint and numbers < (3, 8, 1) else _IMPLICIT
    fast = _IMPLICIT if numbers >= (3, 11) else _MIDPOINT if midpoint else _EXPLICIT
    return {
        "euler": _one_evaluation("euler", _EXPLICIT),
        "rk4": Method(
            name="rk4",
            formula="classical Runge-Kutta 4 on the rotation group: q = q exp(h sum b_i k_i)",
            # before, its digits are those of rotation vectors that are summed as if rotations commuted
            order=4 if numbers >= (4,) else 2,
            evaluations=4,
            torque="every stage",
            lasting="every stage",
            keeps=_KEEPS,
            source=_MANUAL,
            changed_defaults=_CHANGED,
        ),
        "implicit": _one_evaluation("implicit", implicit),
        "implicitfast": _one_evaluation("implicitfast", fast),
        "discrete": _one_evaluation("discrete", _IMPLICIT),
    }


def variants_of(methods: Iterable[Method]) -> dict[str, Method]:
    """Return the methods as users have them: with all defaults, unaligned, and with a welded child."""
    found: dict[str, Method] = {}
    for method in methods:
        if method.name == "euler":
            found[f"euler{DEFAULTS}"] = _variant(method, DEFAULTS, ())
        for variant in (f"{VARIANT}unaligned", f"{VARIANT}welded"):
            found[f"{method.name}{variant}"] = _variant(method, variant, _OFF)
    return found


def _variant(method: Method, variant: str, changed: tuple[str, ...]) -> Method:
    return replace(
        method,
        name=f"{method.name}{variant}",
        formula=method.formula + _BY_THE_ORIGIN,
        keeps="|q| = 1; linear momentum where the link is at the centre of mass",
        changed_defaults=changed,
    )


def _one_evaluation(name: str, formula: str) -> Method:
    order = 2 if formula == _MIDPOINT else 1
    return Method(name, formula, order, 1, "held over the step", _KEEPS, _MANUAL, changed_defaults=_CHANGED)
