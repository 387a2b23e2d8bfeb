"""The arguments and options that several commands share: what is run, and how, whatever it is for."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

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
