"""Known slips in computing a tensor from a shape, and the search for one that explains the numbers of a file.

A slip is named only if it explains so many digits that chance cannot: `Explanation.digits` counts them over
the numbers that differ from each other, and `_DIGITS` more than the slips tried could match by chance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import permutations, product
from math import inf, log10
from typing import TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import parallel_axis_tensor
from bodycheck.scenarios.mass_properties.solid import MassProperties, primitive
from bodycheck.scenarios.model_files.link_solids import Part, united

_Candidates: TypeAlias = tuple[Sequence[str], Array]
"""What went wrong, and the tensors (k, 3, 3) in the axes in which they are written."""

_ROWS, _COLUMNS = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])
_NAMES = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_DIGITS = 5.0  # beyond the logarithm of the number of slips tried
_LOOSEST = 2e-3  # a number that differs by more is not explained
_EXACT = 1e-9  # closer than the digits of a round number tell
_ROUND = 1e-4  # what a round number that is met exactly counts for
_FACTORS = {
    1e-9: "in g mm^2",
    1e-6: "with lengths in mm in place of m",
    1e-4: "with lengths in cm in place of m",
    1e-3: "with the mass in t in place of kg",
    1e3: "with the mass in g in place of kg",
    1e4: "with lengths in cm in place of m",
    1e6: "with lengths in mm in place of m",
    1e9: "in g mm^2",
    4.0: "with twice all lengths: a diameter for a radius, or a full length for a half",
    0.25: "with half of all lengths: a radius for a diameter, or a half length for a full one",
    2.4: "with 1/5 in place of 1/12",
    5.0 / 12.0: "with 1/12 in place of 1/5",
    2.0: "times 2",
    0.5: "times 1/2",
}
"""Factors of all moments that slips make. 5/3 is none: a thin spherical shell has that."""
NO_MASS = "that of 1 kg: the mass is missing"
_COEFFICIENTS = {
    2.4: "12/5",
    5.0 / 12.0: "5/12",
    4.0: "4",
    0.25: "1/4",
    2.0: "2",
    0.5: "1/2",
    3.0: "3",
    1.0 / 3.0: "1/3",
    12.0: "12",
    1.0 / 12.0: "1/12",
}
"""Factors of one or two moments."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """A slip that explains a tensor: what went wrong, the digits that agree, and the right body in link axes.

    common: whether all moments are too large or too small by one factor.
    """

    slip: str
    digits: float
    right: MassProperties
    common: bool


def explained(
    written: Array, axes: Array, centre: Array, mass: float, parts: Sequence[Part]
) -> Explanation | None:
    """Return the slip that explains a tensor, or None.

    written (3, 3): in the inertial frame, whose rotation in the link is `axes` (3, 3) and whose origin is
    `centre` (3,) in m; parts: the shapes, which are the link at uniform density.
    """
    right = united(parts, mass)
    if right is None:
        return None
    groups = list(_slips(axes, centre, mass, parts, right))
    names = [name for group, _ in groups for name in group]
    found = np.concatenate([tensors for _, tensors in groups])[:, _ROWS, _COLUMNS]
    given = written[_ROWS, _COLUMNS]
    scale = float(np.max(np.abs(given)))
    proper = (axes.T @ right.inertia @ axes)[_ROWS, _COLUMNS]
    size = np.max(np.abs(found), axis=1)
    new = np.max(np.abs(found - proper), axis=1) > _LOOSEST * np.maximum(size, np.max(np.abs(proper)))
    absent = np.abs(found) <= 1e-6 * size[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.where(absent, 0.0, np.abs(found - given) / np.abs(given))
    off = np.where(np.isnan(off), inf, off)
    fits = new & (off <= _LOOSEST).all(axis=1) & (~absent | (np.abs(given) <= 1e-4 * scale)).all(axis=1)
    quanta = np.array([half_unit(float(x)) for x in given])
    best: tuple[float, int] = (_DIGITS + log10(len(names)), -1)
    for k in np.flatnonzero(fits):
        digits = _digits(found[k], off[k], quanta, absent[k])
        if digits > best[0]:
            best = (digits, int(k))
    if best[1] < 0:
        return None
    ratio = given[0] / proper[0]
    common = bool(np.allclose(given, ratio * proper, rtol=_LOOSEST, atol=_LOOSEST * scale))
    return Explanation(names[best[1]], best[0], right, common)


def _digits(found: Array, off: Array, quanta: Array, absent: Array) -> float:
    """Return the digits that agree, over the numbers that are not 0 and differ from each other."""
    seen: list[float] = []
    total = 0.0
    for value, difference, quantum, none in zip(found, off, quanta, absent, strict=True):
        if none or any(abs(abs(value) - other) <= 1e-6 * other for other in seen):
            continue
        seen.append(abs(float(value)))
        rounded = min(quantum, _ROUND) if difference <= _EXACT else quantum
        total -= log10(2.0 * min(max(float(difference), rounded, 1e-12), 0.5))
    return total


def half_unit(value: float) -> float:
    """Return half a unit of the last digit of a number as written, relative to it."""
    if value == 0.0:
        return 1.0
    digits = Decimal(repr(value)).normalize().as_tuple()
    return 0.5 * 10.0 ** int(digits.exponent) / abs(value)


def _slips(
    axes: Array, centre: Array, mass: float, parts: Sequence[Part], right: MassProperties
) -> Iterator[_Candidates]:
    T = right.inertia
    W = axes.T @ T @ axes
    # of slips that explain the same digits the first is named
    if len(parts) > 1:
        yield _sums_of_parts(axes, mass, parts)
    yield _OTHER_AXES, W[_ORDERS[:, :, None], _ORDERS[:, None, :]]
    yield _OTHER_AXES, W + _diagonals(np.diagonal(W)[_ORDERS] - np.diagonal(W))
    yield _rotated(axes, mass, parts, T)
    yield _about_other_points(axes, centre, mass, parts, right)
    yield _scaled(W, mass, parts)
    yield _CHANGED, W + _diagonals(np.diagonal(W) * (_CHANGES - 1.0))
    yield _products(W)
    if len(parts) == 1:
        R = axes.T @ parts[0].rotation
        for names, moments in _wrong_moments(parts[0]):
            yield names, (R * (mass * moments)[:, None, :]) @ R.T


def _diagonals(values: Array) -> Array:
    """Return diagonal matrices (k, 3, 3) of rows (k, 3)."""
    return np.asarray(values[:, :, None] * np.eye(3))


_ORDERS = np.array(list(permutations(range(3)))[1:])
_OTHER_AXES = [
    "on other axes: "
    + ", ".join(f"{_NAMES[k]} has that of {_NAMES[j]}" for k, j in enumerate(order) if k != j)
    for order in _ORDERS.tolist()
]
_CHOSEN = [chosen for chosen in product((False, True), repeat=3) if 0 < sum(chosen) < 3]
_CHANGES = np.array([np.where(chosen, factor, 1.0) for factor in _COEFFICIENTS for chosen in _CHOSEN])
_CHANGED = [
    f"with {' and '.join(name for name, one in zip(_NAMES, chosen, strict=False) if one)} times {factor}"
    for factor in _COEFFICIENTS.values()
    for chosen in _CHOSEN
]


def _rotated(axes: Array, mass: float, parts: Sequence[Part], T: Array) -> _Candidates:
    found = {
        "in the axes of the link, not of the inertial frame": T,
        "rotated by the inverse of the inertial frame": axes @ T @ axes.T,
        "rotated twice by the inertial frame": axes.T @ axes.T @ T @ axes @ axes,
    }
    turns: tuple[tuple[str, Callable[[Array], Array]], ...] = (
        ("in the axes of the shape, whose rotation is left out", lambda R: R @ R.T),
        ("with the rotation of the shape inverted", lambda R: R.T),
        ("with the rotation of the shape applied twice", lambda R: R @ R),
    )
    for what, turn in turns:
        solid = united([_with_rotation(part, turn(part.rotation)) for part in parts], mass)
        if solid is not None:
            found[what] = axes.T @ solid.inertia @ axes
            found[f"{what}, and so is that of the inertial frame"] = solid.inertia
    return list(found), np.array(list(found.values()))


def _with_rotation(part: Part, R: Array) -> Part:
    """Return a part rotated about its own origin, to R in place of its own rotation."""
    if part.solid is None:
        return part
    turn = R @ part.rotation.T
    solid = part.solid.translated(-part.position).rotated(turn).translated(part.position)
    return Part(part.kind, part.sizes, R, part.position, solid)


def _about_other_points(
    axes: Array, centre: Array, mass: float, parts: Sequence[Part], right: MassProperties
) -> _Candidates:
    points = {"the origin of the link": np.zeros(3), "the origin of the inertial frame": centre}
    if len(parts) == 1:
        points["the origin of the shape"] = parts[0].position
    found = {}
    for where, point in points.items():
        moved = mass * parallel_axis_tensor(right.centre - point)
        found[f"about {where}, not the centre of mass"] = right.inertia + moved
        found[f"moved from {where} to the centre of mass twice"] = right.inertia - moved
    (part, *others) = parts
    if not others and part.kind in ("box", "cylinder", "capsule"):
        lengths = part.sizes if part.kind == "box" else (0.0, 0.0, part.sizes[1])
        for axis, length in enumerate(lengths):
            end = mass * parallel_axis_tensor(part.rotation[:, axis] * (0.5 * length))
            found[f"about the end of the shape along its {'xyz'[axis]} axis"] = right.inertia + end
    return list(found), axes.T @ np.array(list(found.values())) @ axes


def _scaled(W: Array, mass: float, parts: Sequence[Part]) -> _Candidates:
    volume = sum(part.solid.mass for part in parts if part.solid is not None)
    found = {
        NO_MASS: 1.0 / mass,
        "multiplied by the mass twice": mass,
        "that at a density of 1 kg/m^3, not of this mass": volume / mass,
        "that at a density of 1000 kg/m^3, not of this mass": 1000.0 * volume / mass,
    }
    names = [*found, *(f"that of the shape {how}" for how in _FACTORS.values())]
    return names, np.multiply.outer(np.array([*found.values(), *_FACTORS]), W)


def _products(W: Array) -> _Candidates:
    diagonal = np.diag(np.diagonal(W))
    found = {
        "with products of inertia of the wrong sign": 2.0 * diagonal - W,
        "without its products of inertia": diagonal,
    }
    for name, i, j in zip(_NAMES[3:], _ROWS[3:], _COLUMNS[3:], strict=True):
        changed = W.copy()
        changed[i, j] = changed[j, i] = -W[i, j]
        found[f"with {name} of the wrong sign"] = changed
    products = W[_ROWS[3:], _COLUMNS[3:]]
    for order in _ORDERS.tolist():
        changed = W.copy()
        changed[_ROWS[3:], _COLUMNS[3:]] = changed[_COLUMNS[3:], _ROWS[3:]] = products[order]
        names = ", ".join(_NAMES[3 + k] for k in order)
        found[f"with its products of inertia in another order: {names}"] = changed
    return list(found), np.array(list(found.values()))


def _sums_of_parts(axes: Array, mass: float, parts: Sequence[Part]) -> _Candidates:
    solids = [part.solid for part in parts if part.solid is not None]
    masses = [mass * solid.mass / sum(one.mass for one in solids) for solid in solids]
    each = [solid.inertia * (own / solid.mass) for solid, own in zip(solids, masses, strict=True)]
    moved = [own * parallel_axis_tensor(solid.centre) for solid, own in zip(solids, masses, strict=True)]
    found = {
        "the sum of its parts without the parallel axis terms": sum(each),
        "the sum of its parts, each with the mass of all": sum(
            solid.inertia * (mass / solid.mass) for solid in solids
        ),
        "the sum of its parts about the origin of the link": sum(each) + sum(moved),
    }
    for k, one in enumerate(each):
        found[f"that of part {k + 1} of {len(each)} alone"] = one
    return list(found), axes.T @ np.array(list(found.values())) @ axes


def _wrong_moments(part: Part) -> Iterator[_Candidates]:
    """Yield moments (k, 3) per mass in the axes of a primitive, made by wrong lengths or formulas."""
    match part.kind:
        case "box" | "ellipsoid":
            squares = np.square(part.sizes) / (12.0 if part.kind == "box" else 5.0)
            yield _WRONG_LENGTHS, squares[_PAIRS].sum(axis=2)
            scaled = squares * np.square(_SCALES)
            yield _OF_SCALES, scaled.sum(axis=1, keepdims=True) - scaled
        case "cylinder" | "capsule":
            sizes = [*(np.array(part.sizes) * _SCALES_OF_TWO).tolist(), part.sizes[::-1]]
            solids = [primitive(part.kind, size) for size in sizes]
            yield _OF_RADIUS, np.array([np.diagonal(one.inertia) / one.mass for one in solids])
    if part.kind == "cylinder":
        yield _wrong_formulas(*part.sizes)


_LENGTHS_OF = ((1, 2), (0, 2), (0, 1))
"""The edges of a box whose squares make each moment."""
_CHOICES = sorted(
    set(product([(j, k) for j in range(3) for k in range(j, 3)], repeat=3)) - {_LENGTHS_OF},
    key=lambda choice: sum(one != right for one, right in zip(choice, _LENGTHS_OF, strict=True)),
)
_PAIRS = np.array(_CHOICES)
_WRONG_LENGTHS = [
    "with wrong lengths: "
    + ", ".join(
        f"{_NAMES[axis]} from {'xyz'[j]} and {'xyz'[k]}"
        for axis, (j, k) in enumerate(choice)
        if (j, k) != _LENGTHS_OF[axis]
    )
    for choice in _CHOICES
]


def _scales(count: int) -> Array:
    """Return the factors 1/2, 1, 2 of lengths that are not all the same (k, count)."""
    return np.array([one for one in product((0.5, 1.0, 2.0), repeat=count) if len(set(one)) > 1])


def _named_scales(scales: Array, names: Sequence[str]) -> list[str]:
    words = {0.5: "half the", 2.0: "twice the"}
    return [
        "that of a shape with "
        + " and ".join(f"{words[x]} {name}" for x, name in zip(scale, names, strict=True) if x != 1.0)
        for scale in scales.tolist()
    ]


_SCALES, _SCALES_OF_TWO = _scales(3), _scales(2)
_OF_SCALES = _named_scales(_SCALES, ("size along x", "size along y", "size along z"))
_OF_RADIUS = [
    *_named_scales(_SCALES_OF_TWO, ("radius", "length")),
    "that of a shape with radius and length swapped",
]


def _wrong_formulas(radius: float, length: float) -> _Candidates:
    """Return the moments of a cylinder by formulas that are often confused."""
    rr, ll = radius**2, length**2
    across = {
        "": rr / 4.0 + ll / 12.0,
        "(r^2 + l^2) / 12": (rr + ll) / 12.0,
        "(3 r^2 + l^2) / 3": rr + ll / 3.0,
        "r^2 / 4 + l^2 / 3": rr / 4.0 + ll / 3.0,
        "r^2 / 2 + l^2 / 12": rr / 2.0 + ll / 12.0,
        "(3 r + l) / 12": (3.0 * radius + length) / 12.0,
        "r^2 / 4": rr / 4.0,
    }
    along = {"": rr / 2.0, "r^2": rr, "r^2 / 4": rr / 4.0, "2 r^2": 2.0 * rr, "r^2 / 12": rr / 12.0}
    wrong = [pair for pair in product(across, along) if any(pair)]
    names = ["by a wrong formula: " + " and ".join(f"m {form}" for form in pair if form) for pair in wrong]
    return names, np.array([(across[a], across[a], along[b]) for a, b in wrong])
