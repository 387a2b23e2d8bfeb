"""The commands `nightly` and `history`: store nightly runs and compare each with the earlier ones."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import typer

from bodycheck._util.errors import InputError, StoppedError
from bodycheck.cli.options import (
    AllowCode,
    Jobs,
    NoSpeed,
    Scenarios,
    Threshold,
    TimeoutS,
    Tolerances,
    thresholds_of,
)
from bodycheck.reports.gates.thresholds import THRESHOLD
from bodycheck.runs.run_options import TIMEOUT_S

nightly = typer.Typer()
history = typer.Typer(help="List, query and prune a history of nightly runs.", no_args_is_help=True)
nightly.add_typer(history, name="history")

_EXITS = {"no regression": 0, "regression": 1, "nothing measured": 1, "insufficient history": 3}

_LEFT_OUT = 1

_Folder = Annotated[Path, typer.Argument(metavar="HISTORY", help="Folder of a history.")]


@nightly.command(name="nightly", short_help="Run, store, and compare with earlier runs.")
def nightly_(
    history: Annotated[Path, typer.Option(help="Folder of the history; created if it does not exist.")],
    scenarios: Scenarios = None,
    engine: Annotated[
        str | None,
        typer.Option(help="Engines to run, as NAME[:METHOD],...", show_default="every installed engine"),
    ] = None,
    markdown: Annotated[Path | None, typer.Option(help="Also write the comparison as Markdown.")] = None,
    threshold: Threshold = THRESHOLD,
    tolerances: Tolerances = None,
    jobs: Jobs = None,
    timeout_s: TimeoutS = TIMEOUT_S,
    no_speed: NoSpeed = False,
    allow_code: AllowCode = False,
) -> None:
    """Run scenarios, append the run to a history, and compare it with the earlier nightly runs.

    The exit status is 1 on a regression or if nothing was measured, and 3 if the history is insufficient to
    compare with.
    """
    from bodycheck._util.files import check_file, write_whole
    from bodycheck.reports.history.history_output import print_night
    from bodycheck.reports.render.progress import LiveProgress
    from bodycheck.runs.directory import RunRequest
    from bodycheck.runs.nightly_run import run_night

    thresholds = thresholds_of(threshold, tolerances)
    check_file("--markdown", markdown)
    asked = RunRequest(
        scenarios=scenarios or ["standard"],
        engines=None if engine is None else engine.split(","),
        speed=not no_speed,
        jobs=jobs,
        timeout_s=timeout_s,
        fresh=True,  # a stored result would hide a change of the engine
        allow_code=allow_code,
    )
    try:
        judged, night = run_night(asked, history, LiveProgress, thresholds)
    except KeyboardInterrupt:
        raise StoppedError("stopped; nothing was stored") from None
    print_night(judged)
    print(night / "night.html")
    if markdown is not None:
        write_whole(markdown, (night / "night.md").read_bytes())
    raise typer.Exit(_EXITS[judged.status])


@history.command(name="list", short_help="Print one line per nightly run.")
def list_(folder: _Folder) -> None:
    """Print one line per nightly run, oldest first: status, number of changes, cases and engines.

    Damaged runs are reported on standard error and left out; then the exit status is 1.
    """
    from bodycheck.reports.history.archive import History
    from bodycheck.reports.history.baseline import readable_nights
    from bodycheck.reports.history.history_output import print_nights
    from bodycheck.reports.history.queries import nights_table

    nights, left_out = readable_nights(History.existing(folder).nights())
    print_nights(nights_table(nights))
    _tell(left_out)


@history.command(short_help="Query nightly runs in SQL.")
def query(
    folder: _Folder,
    sql: Annotated[
        str,
        typer.Argument(help="A SELECT from the tables nights, results, methods, stability and changes."),
    ],
    as_: Annotated[Literal["csv", "json", "md"], typer.Option("--format", help="Output format.")] = "csv",
) -> None:
    """Print the result of a SELECT on the tables of all nightly runs; nights has one row per nightly run.

    Damaged runs are reported on standard error and left out; then the exit status is 1.
    """
    from bodycheck.reports.history.archive import History
    from bodycheck.reports.history.baseline import readable_nights
    from bodycheck.reports.history.queries import TABLES
    from bodycheck.reports.history.queries import query as asked
    from bodycheck.reports.run_files.table_formats import FORMATS

    nights, left_out = readable_nights(History.existing(folder).nights(), TABLES)
    sys.stdout.write(FORMATS[as_](asked(nights, sql)).decode())
    _tell(left_out)


@history.command(short_help="Remove old nightly runs.")
def prune(
    folder: _Folder, keep: Annotated[int, typer.Option(help="Number of newest nightly runs to keep.")]
) -> None:
    """Remove all but the newest nightly runs, and print the names of the removed ones."""
    from bodycheck.reports.history.archive import History

    if keep < 1:
        raise InputError(f"--keep {keep}: must be 1 or more")
    history = History.existing(folder)
    for night in history.dated_in_future():
        print(f"{night}: is dated in the future; neither counted nor removed", file=sys.stderr)
    for name in history.prune(keep):
        print(name)


def _tell(left_out: Sequence[str]) -> None:
    """Report nightly runs that were left out on standard error, and exit with status 1 if there are any."""
    for why in left_out:
        print(f"{why}; this nightly run is left out", file=sys.stderr)
    if left_out:
        raise typer.Exit(_LEFT_OUT)
