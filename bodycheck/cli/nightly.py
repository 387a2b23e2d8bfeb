"""The commands `nightly` and `history`: what is measured every night, kept, and compared with its past."""

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
history = typer.Typer(help="Ask and prune a history of nights.", no_args_is_help=True)
nightly.add_typer(history, name="history")

_EXITS = {"no regression": 0, "regression": 1, "nothing measured": 1, "insufficient history": 3}

_LEFT_OUT = 1

_Folder = Annotated[Path, typer.Argument(metavar="HISTORY", help="The folder of a history.")]


@nightly.command(name="nightly", short_help="Run, keep, and compare with the past.")
def nightly_(
    history: Annotated[Path, typer.Option(help="The folder of all nights; made if it is not there.")],
    scenarios: Scenarios = None,
    engine: Annotated[
        str | None, typer.Option(help="NAME[:METHOD],...; every engine that is installed, unless told.")
    ] = None,
    markdown: Annotated[Path | None, typer.Option(help="Write what is told to this file too.")] = None,
    threshold: Threshold = THRESHOLD,
    tolerances: Tolerances = None,
    jobs: Jobs = None,
    timeout_s: TimeoutS = TIMEOUT_S,
    no_speed: NoSpeed = False,
    allow_code: AllowCode = False,
) -> None:
    """Run, append the night to a history, and compare it with its past.

    The status is 1 on a regression, or where nothing was measured; 3 where there is no past to compare with.
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
        fresh=True,  # what an engine answers tonight, not what it answered before
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


@history.command(name="list", short_help="Print one line a night.")
def list_(folder: _Folder) -> None:
    """Print one line a night, the oldest first: its status, how much changed, its cases and engines.

    The status is 1 where a night is damaged: it is named on standard error, and the others are listed.
    """
    from bodycheck.reports.history.archive import History
    from bodycheck.reports.history.baseline import readable_nights
    from bodycheck.reports.history.history_output import print_nights
    from bodycheck.reports.history.queries import nights_table

    nights, left_out = readable_nights(History.existing(folder).nights())
    print_nights(nights_table(nights))
    _tell(left_out)


@history.command(short_help="Ask in SQL.")
def query(
    folder: _Folder,
    sql: Annotated[str, typer.Argument(help="A SELECT from nights, results, methods, stability, changes.")],
    as_: Annotated[Literal["csv", "json", "md"], typer.Option("--format", help="Of the answer.")] = "csv",
) -> None:
    """Print what a SELECT finds in the tables of all nights together; nights has one row a night.

    The status is 1 where a night is damaged: it is named on standard error, and the others are asked.
    """
    from bodycheck.reports.history.archive import History
    from bodycheck.reports.history.baseline import readable_nights
    from bodycheck.reports.history.queries import TABLES
    from bodycheck.reports.history.queries import query as asked
    from bodycheck.reports.run_files.table_formats import FORMATS

    nights, left_out = readable_nights(History.existing(folder).nights(), TABLES)
    sys.stdout.write(FORMATS[as_](asked(nights, sql)).decode())
    _tell(left_out)


@history.command(short_help="Remove old nights.")
def prune(
    folder: _Folder, keep: Annotated[int, typer.Option(help="How many nights to keep, the newest.")]
) -> None:
    """Remove all nights but the newest, and print the names of those that are gone."""
    from bodycheck.reports.history.archive import History

    if keep < 1:
        raise InputError(f"--keep {keep}: must be 1 or more nights")
    history = History.existing(folder)
    for night in history.dated_in_future():
        print(f"{night}: is dated in the future: not counted, and not removed", file=sys.stderr)
    for name in history.prune(keep):
        print(name)


def _tell(left_out: Sequence[str]) -> None:
    """Name the nights that an answer is without, and end with the status that says so."""
    for why in left_out:
        print(f"{why}; this night is left out", file=sys.stderr)
    if left_out:
        raise typer.Exit(_LEFT_OUT)
