"""Arguments and options shared by several commands, and the parsing of their values."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from bodycheck._util.errors import InputError
from bodycheck.reports.gates.thresholds import Thresholds

Scenarios: TypeAlias = Annotated[
    list[str] | None,
    typer.Argument(help="Built-in scenarios, suites or .toml files.", show_default="standard"),
]
Jobs: TypeAlias = Annotated[
    int | None, typer.Option(help="Number of cases to run in parallel.", show_default="one per core")
]
TimeoutS: TypeAlias = Annotated[float, typer.Option(help="Time limit of one case in s.")]
Fresh: TypeAlias = Annotated[
    bool | None,
    typer.Option(
        "--fresh/--reuse",
        help="Run every case again, or reuse results of earlier runs by the same build of an engine.  "
        "[default: gate runs again; run and versions reuse for installed engines and run plug-ins and "
        "editable installs again]",
        show_default=False,
    ),
]
NoSpeed: TypeAlias = Annotated[bool, typer.Option("--no-speed", help="Do not measure CPU time.")]
Threshold: TypeAlias = Annotated[
    float,
    typer.Option(
        help="Relative change above which a measure is worse or improved; a smaller change is moved."
    ),
]
Tolerances: TypeAlias = Annotated[
    Path | None, typer.Option(help="TOML file with [[change]] tables: thresholds of individual measures.")
]
AllowCode: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--allow-code",
        help="Allow scenario files to import functions f(t, position, R, velocity, omega) -> force, torque, "
        "which runs their modules' code; R is (3, 3), t a number, the others (3,).",
    ),
]


def numbers(text: str | None, option: str) -> list[float] | None:
    """Parse a comma-separated list of numbers; None if there is no list.

    Raises InputError, which names the option, for a word that is not a number.
    """
    if text is None:
        return None
    found = []
    for word in text.split(","):
        try:
            found.append(float(word))
        except ValueError:
            raise InputError(
                f"{option} {text}: {word.strip()!r} is not a number (expected numbers like 1e-2,1e-3)"
            ) from None
    return found


def thresholds_of(threshold: float, tolerances: Path | None) -> Thresholds:
    """Return the thresholds of all measures; raises InputError if the option or the file is wrong."""
    if not 0.0 <= threshold < math.inf:
        raise InputError(f"--threshold {threshold}: must be 0 or more, like 0.02 for 2 %")
    if tolerances is None:
        return Thresholds(threshold)
    from bodycheck.reports.gates.gate import read_thresholds  # imports pydantic

    return read_thresholds(tolerances, threshold)
