"""Name why two files state different bodies: units, axes, or a fault that importers make, too."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import permutations, product
from typing import TypeAlias

import numpy as np

from bodycheck._util.formatting import number
from bodycheck.audit.audit import SINGLE, Body, Difference
from bodycheck.reference_impl.arrays import Array

_LENGTHS = {"mm": 1e-3, "cm": 1e-2, "in": 0.0254}
_MASSES = {"g": 1e-3, "lb": 0.45359237}

Others: TypeAlias = Callable[[Body, Difference], tuple[str, ...]]


def file_causes(expected: Body, held: Body, others: Others) -> tuple[str, ...]:
    """Return the causes of a difference between the body of one file and that of another.

    Wrong units are divided out first, so that they hide no other fault; `others` names the causes of what
    remains.
    """
    found = []
    mass = _ratio(held.mass_kg, expected.mass_kg)
    centre = _parallel(held.centre_m, expected.centre_m)
    tensor = _ratio(float(np.trace(held.inertia_kg_m2)), float(np.trace(expected.inertia_kg_m2)))
    factors = []
    for what, ratio, powers in (
        ("mass", mass, (1, 0)),
        ("centre of mass", centre, (0, 1)),
        ("tensor", tensor, (1, 2)),
    ):
        factor, unit = next(
            ((value, text) for value, text in _units(*powers) if abs(ratio - value) <= 2.0 * SINGLE * value),
            (1.0, ""),
        )
        factors.append(factor)
        if unit:
            found.append(f"{what} times {number(factor, 6)}: {unit}")
    rest = Body(held.mass_kg / factors[0], held.centre_m / factors[1], held.inertia_kg_m2 / factors[2])
    difference = Difference.between(expected, rest)
    if found and difference.largest <= SINGLE:
        return tuple(found)
    if turn := _turn(expected, rest):
        return (*found, turn)
    return (*found, *others(rest, difference))


def _ratio(held: float, expected: float) -> float:
    return held / expected if expected else 1.0


def _parallel(held: Array, expected: Array) -> float:
    """Return |held| / |expected| of parallel vectors, else 1."""
    norms = float(np.linalg.norm(held)), float(np.linalg.norm(expected))
    if not norms[0] > 0.0 < norms[1] or float(held @ expected) < norms[0] * norms[1] * (1.0 - SINGLE**2):
        return 1.0
    return norms[0] / norms[1]


def _units(mass_power: int, length_power: int) -> Iterator[tuple[float, str]]:
    """Yield each factor that a wrong unit makes of a quantity kg^a m^b, and what it means."""
    lengths = {"m": 1.0} | (_LENGTHS if length_power else {})
    masses = {"kg": 1.0} | (_MASSES if mass_power else {})
    for (mass, kilogram), (length, metre) in product(masses.items(), lengths.items()):
        for power in range(1, length_power + 1) if metre != 1.0 else (length_power,):
            factor = kilogram * metre**power
            if factor == 1.0:
                continue
            unit = " ".join(filter(None, (mass if mass_power else "", _raised(length, power))))
            si = " ".join(filter(None, ("kg" if mass_power else "", _raised("m", power))))
            yield 1.0 / factor, f"{unit} taken as {si}"
            yield factor, f"{si} taken as {unit}"


def _raised(unit: str, power: int) -> str:
    return "" if power == 0 else unit if power == 1 else f"{unit}^{power}"


def _turn(expected: Body, held: Body) -> str:
    """Return the exchange of axes that turns a body, or its tensor alone, into another; "" if none does."""
    for whole, R in product((True, False), sorted(_exchanges(), key=_order)):
        centre = R @ expected.centre_m if whole else expected.centre_m
        turned = Body(expected.mass_kg, centre, R @ expected.inertia_kg_m2 @ R.T)
        if Difference.between(turned, held).largest <= SINGLE < Difference.between(expected, turned).largest:
            what = "the body" if whole else "the tensor"
            names = [("-" if row.sum() < 0 else "") + "xyz"[int(np.abs(row).argmax())] for row in R]
            up = " (one is up in place of the other)" if _about_x(R) else ""
            return f"axes of {what} exchanged: ({', '.join(names)}) in place of (x, y, z){up}"
    return ""


def _exchanges() -> Iterator[Array]:
    """Yield the 24 rotations that map axes onto axes."""
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        R = np.zeros((3, 3))
        R[range(3), order] = signs
        if np.linalg.det(R) > 0.0:
            yield R


def _about_x(R: Array) -> bool:
    return bool(R[0, 0] == 1.0 and R[1, 1] == 0.0)


def _order(R: Array) -> tuple[bool, float]:
    """Return the rank of an exchange: the one between y up and z up first, then the smallest angles."""
    return not _about_x(R), math.acos(max(-1.0, min(1.0, (float(np.trace(R)) - 1.0) / 2.0)))
