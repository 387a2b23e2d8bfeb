"""Suggest a map that fits the columns of a file, for the message that refuses them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from bodycheck._util.formatting import nearest
from bodycheck._util.untrusted import shell_quote
from bodycheck.reports.recordings.column_map import (
    EULER,
    KINDS,
    UNITS,
    ColumnMap,
    read_map,
    source_names,
)

ACCEPTED = "t_s, x_m, y_m, z_m, qw, qx, qy, qz, r00 to r22, vx_m_s ..., wx_body_rad_s ..., wx_world_rad_s ..."
"""The columns that need no map."""

_AXES = ("x", "y", "z")
_ALIASES = {
    "t_s": ("t", "time", "times", "timestamp", "simtime", "elapsedtime"),
    **{f"{axis}_m": (axis, f"p{axis}", f"pos{axis}", f"position{axis}") for axis in _AXES},
    **{f"v{axis}_m_s": (f"v{axis}", f"vel{axis}", f"velocity{axis}", f"{axis}dot") for axis in _AXES},
    **{f"v{axis}_body_m_s": (body, f"{body}body") for axis, body in zip(_AXES, "uvw", strict=True)},
    **{
        f"w{axis}_body_rad_s": (
            *(rate, f"{angle}rate", f"w{axis}", f"w{axis}body", f"omega{axis}", f"omegabody{axis}"),
            *(f"gyro{axis}", f"angularvelocity{axis}", f"angvel{axis}", f"bodyrate{axis}"),
        )
        for axis, rate, angle in zip(_AXES, "pqr", ("roll", "pitch", "yaw"), strict=True)
    },
    **{f"w{axis}_world_rad_s": (f"w{axis}world", f"omegaworld{axis}") for axis in _AXES},
    **{
        f"q{part}": (f"q{part}", f"q{index}", f"quat{part}", f"quaternion{part}", f"orientation{part}")
        for index, part in enumerate("wxyz")
    },
    "euler_1_rad": ("yaw", "psi", "heading"),
    "euler_2_rad": ("pitch", "theta"),
    "euler_3_rad": ("roll", "phi"),
}
_TARGETS = {alias: target for target, aliases in _ALIASES.items() for alias in aliases}
_SPELLINGS = {
    "sec": "s",
    "seconds": "s",
    "degrees": "deg",
    "feet": "ft",
    "dps": "deg",
    "fps": "ft",
    "mps": "m",
}
_PLAIN = re.compile(r"[^\W\d]\w*(?:\.\w+|\[[0-9]+\])*")
_MAX_IGNORED = 2


def nearest_map(columns: Sequence[str], known: ColumnMap | None = None) -> str:
    """Return "; try --map ..." or "; try --like ..." for the columns of a file.

    known: the map that was given, whose keys are not proposed again.
    """
    for name in source_names():
        products = read_map((), name).products.values()
        if {column for product in products for column in product.columns} <= set(columns):
            return f"; try --like {name}"
    pairs = ", ".join(_pairs(columns, known or ColumnMap()))
    return f"; try --map {shell_quote(pairs)}" if pairs else ""


def _pairs(columns: Sequence[str], known: ColumnMap) -> Iterator[str]:
    taken = {*known.products, *(name for name in columns if name in KINDS)}
    used = {name for product in known.products.values() for name, _ in product.names}
    used |= {name for product in known.products.values() for name in product.columns}
    left = []
    for column in columns:
        if column in used or column in KINDS or known.ignores(column):
            continue
        target, unit = _guess(column)
        if target is None or target in taken:
            left.append(column)
            continue
        taken.add(target)
        yield f"{target}={_written(column)}{unit}"
    if not known.euler and taken & set(EULER):
        yield "euler=ZYX"
    if len(left) > _MAX_IGNORED:
        yield "ignore=*"
    else:
        yield from (f"ignore={_written(column)}" for column in left)


def _guess(column: str) -> tuple[str | None, str]:
    """Return the target that a column's name resembles, and the unit in the name, as a factor."""
    words = [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+", column)]
    units: list[str] = []
    while len(words) > 1 and _SPELLINGS.get(words[-1], words[-1]) in UNITS:
        word = words.pop()
        units.insert(0, _SPELLINGS.get(word, word))
    stems = ("".join(words), "".join(reversed(words)))
    target = next((_TARGETS[stem] for stem in stems if stem in _TARGETS), None) or nearest(column, KINDS)
    if target is None and len(words) > 1 and (close := nearest(stems[0], _TARGETS)):
        target = _TARGETS[close]
    factors = [unit for unit in units if UNITS[unit][0] != 1.0]
    return target, f"*{factors[0]}" if factors else ""


def _written(column: str) -> str:
    """Return a column as a map names it: quoted unless it is a plain name that is not a unit."""
    return column if _PLAIN.fullmatch(column) and column not in UNITS else f'"{column}"'
