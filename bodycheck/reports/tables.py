"""The tables of a run: the columns of results.csv, methods.csv and stability.csv, in their order."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bodycheck.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

WHO = ("scenario", "family", "engine", "engine_version", "method")
"""Whose a row is, in each of the three tables."""

_CASE = (
    "run_id",
    *WHO,
    "control",
    "dt_s",
    "tolerance",
    "steps",
    "duration_s",
    "outcome",
    "message",
    "reproduce",
)
_SCALES = (
    "length_scale_m",
    "speed_scale_m_s",
    "omega_scale_rad_s",
    "energy_scale_j",
    "rotational_energy_scale_j",
    "angular_momentum_scale_kg_m2_s",
    "linear_momentum_scale_kg_m_s",
)
MEASURES = {
    "energy_drift": "max |E - E*| over the largest true kinetic energy; E = K + U",
    "rotational_energy_drift": "max |Kr - Kr*| over max Kr*; Kr = omega . I omega / 2",
    "energy_balance": "max |E - E(0) - W| over the largest true kinetic energy; W = work of the loads",
    "angular_momentum_drift": "max |L - L*| over max |L*|; the vector in world axes",
    "linear_momentum_drift": "max |P - P*| over mass x speed scale",
    "invariant_drift": "max |C - C*| of the scene's worst invariant, named in `invariant`, over its size",
    "orthogonality": "max ||R^T R - I||_F of the matrix that the engine itself gives",
    "determinant_error": "max |det R - 1| of the same matrix",
    "quaternion_norm_error": "max ||q| - 1| of the quaternion that the engine itself holds",
    "orientation_error_rad": "max geodesic angle to the truth",
    "orientation_error_final_rad": "geodesic angle to the truth at the end",
    "omega_error": "max |omega - omega*| in body axes over max |omega*|",
    "position_error": "max |x - x*| over the length scale",
    "velocity_error": "max |v - v*| over the speed scale",
}
"""Measure -> formula; a star marks the truth. Those with a scale stand also as `_abs`, in SI units."""

ABSOLUTE = {
    "energy_drift": "J",
    "rotational_energy_drift": "J",
    "energy_balance": "J",
    "angular_momentum_drift": "kg m^2/s",
    "linear_momentum_drift": "kg m/s",
    "invariant_drift": "SI unit of the invariant",
    "omega_error": "rad/s",
    "position_error": "m",
    "velocity_error": "m/s",
}
_TRUTH = (
    "truth",
    "truth_bound_rad",
    "truth_bound_energy",
    "truth_bound_momentum",
    "compared_until_s",
    "horizon_s",
)
_SPEED = (
    "cpu_s",
    "cpu_s_low",
    "cpu_s_high",
    "ns_per_step",
    "relative_cpu",
    "rhs_evaluations",
    "stepping",
)

RESULT_COLUMNS = (
    *_CASE,
    *_SCALES,
    *(c for name in MEASURES for c in ((name, f"{name}_abs") if name in ABSOLUTE else (name,))),
    "invariant",
    "step_change_rad",
    *_TRUTH,
    *_SPEED,
)
METHOD_COLUMNS = (
    "run_id",
    *WHO,
    "quantity",
    "order",
    "order_low",
    "order_high",
    "points",
    "floor",
    "verdict",
    "growth",
    "growth_exponent",
    "growth_low",
    "growth_high",
)
STABILITY_COLUMNS = (
    "run_id",
    *WHO,
    "dt_stable_s",
    "dt_unstable_s",
    "reason",
    "outcome",
    "message",
)
_WHOLE_NUMBERS = ("steps", "rhs_evaluations", "points")
_TEXTS = frozenset(
    (
        *("run_id", *WHO, "control", "outcome"),
        *("message", "reproduce", "invariant", "truth", "stepping", "quantity", "verdict"),
        *("growth", "reason"),
    )
)


def as_table(rows: Iterable[Mapping[str, Any]], columns: tuple[str, ...]) -> pd.DataFrame:
    """Return the rows as a table with exactly these columns; what was not measured is missing, never 0.

    Raises ValueError where a row has a column that the table has not.
    """
    import pandas as pd  # late: a third of a second

    rows = list(rows)
    for row in rows:
        if unknown := row.keys() - set(columns):
            raise ValueError(f"no column is named {', '.join(sorted(unknown))}")
    return pd.DataFrame(
        {column: pd.Series([row.get(column) for row in rows], dtype=_dtype(column)) for column in columns}
    )


def _dtype(column: str) -> str | None:
    """Return what a column holds; None where pandas is to see for itself which kind of text."""
    if column in _WHOLE_NUMBERS:
        return "Int64"
    return None if column in _TEXTS else "float64"


def read_rows(path: Path, columns: tuple[str, ...], needed: tuple[str, ...]) -> list[dict[str, Any]]:
    """Read the rows of a table of a run, as they were before they were written; an empty cell has no entry.

    columns: those that the table may have; needed: those that it must have, and no row may lack. Raises
    InputError with one line that names the file and what is wrong with it.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            lines = list(csv.reader(file, strict=True))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (csv.Error, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is not CSV: {error}") from None
    head = lines[0] if lines else []
    if missing := [name for name in needed if name not in head]:
        raise InputError(f"{path}: is no table of a run: it has no column {', '.join(missing)}")
    if unknown := [name for name in head if name not in columns]:
        raise InputError(f"{path}: this version of bodycheck knows no column {', '.join(unknown)}")
    return [_row(path, number, head, line, needed) for number, line in enumerate(lines[1:], 1)]


def _row(
    path: Path, number: int, head: list[str], line: list[str], needed: tuple[str, ...]
) -> dict[str, Any]:
    if len(line) != len(head):
        raise InputError(f"{path}: row {number} has {len(line)} cells, not {len(head)}")
    row: dict[str, Any] = {}
    for name, cell in zip(head, line, strict=True):
        if cell:
            try:
                row[name] = (str if name in _TEXTS else int if name in _WHOLE_NUMBERS else float)(cell)
            except ValueError:
                raise InputError(f"{path}: row {number}: {name} is {cell!r}, not a number") from None
    if missing := [name for name in needed if name not in row]:
        raise InputError(f"{path}: row {number} has no {', '.join(missing)}")
    return row
