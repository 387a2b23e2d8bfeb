"""Arguments and options that several commands share, and how their values are parsed."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from bodycheck._util.errors import InputError
from bodycheck.reports.gates.thresholds import Thresholds

Scenarios: TypeAlias = Annotated[
    list[str] | None,
    typer.Argument(help="Built-in names, suites or .toml files.", show_default="standard"),
]
Jobs: TypeAlias = Annotated[
    int | None, typer.Option(help="How many cases run side by side.", show_default="one a core")
]
TimeoutS: TypeAlias = Annotated[float, typer.Option(help="Seconds that one case may take.")]
Fresh: TypeAlias = Annotated[
    bool | None,
    typer.Option(
        "--fresh/--reuse",
        help="Run every case again, or use answers of earlier runs by the same build of an engine.",
        show_default=False,
    ),
]
NoSpeed: TypeAlias = Annotated[bool, typer.Option("--no-speed", help="Do not measure processor time.")]
Threshold: TypeAlias = Annotated[
    float,
    typer.Option(help="The relative change of a measure from which on it is worse or improved, not moved."),
]
Tolerances: TypeAlias = Annotated[
    Path | None, typer.Option(help="A file with [[change]] tables: thresholds of single measures.")
]
AllowCode: TypeAlias = Annotated[
    bool, typer.Option("--allow-code", help="Let functions that a file names be imported.")
]


def numbers(text: str | None, option: str) -> list[float] | None:
    """Return the numbers of a comma-separated list; None where there is no list.

    Raises InputError, which names the option, for a word that is no number.
    """
    if text is None:
        return None
    found = []
    for word in text.split(","):
        try:
            found.append(float(word))
        except ValueError:
            raise InputError(
                f"{option} {text}: {word.strip()!r} is not a number; give numbers like 1e-2,1e-3"
            ) from None
    return found


def thresholds_of(threshold: float, tolerances: Path | None) -> Thresholds:
    """Return the thresholds of all measures; InputError where the option or the file is wrong."""
    if not 0.0 <= threshold < math.inf:
        raise InputError(f"--threshold {threshold}: must be 0 or more, like 0.02 for 2 %")
    if tolerances is None:
        return Thresholds(threshold)
    from bodycheck.reports.gates.gate import read_thresholds  # late: pydantic

    return read_thresholds(tolerances, threshold)
