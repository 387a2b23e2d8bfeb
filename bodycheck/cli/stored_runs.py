"""The commands that read stored runs: compare, advise, report, table, plot."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from bodycheck._util.errors import InputError
from bodycheck.cli.options import AllowCode, Threshold, Tolerances, thresholds_of
from bodycheck.reports.gates.thresholds import THRESHOLD

if TYPE_CHECKING:
    from bodycheck.reports.comparison.change import Status

FAIL_ON: dict[str, tuple[Status, ...]] = {
    "worse": ("worse", "missing"),
    "moved": ("worse", "missing", "moved"),
    "never": (),
}
"""--fail-on -> the statuses of changes for which `compare` exits with status 1."""

_FAILED = 1

questions = typer.Typer()

_Run = Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run.")]
_AllowCode = Annotated[
    bool,
    typer.Option(
        "--allow-code", help="Allow the run's scenarios to import functions, which runs their modules' code."
    ),
]


@questions.command(short_help="Print what changed between two runs.")
def compare(
    before: Annotated[Path, typer.Argument(metavar="RUN_A", help="Folder of the run before the change.")],
    after: Annotated[Path, typer.Argument(metavar="RUN_B", help="Folder of the run after the change.")],
    fail_on: Annotated[
        Literal["worse", "moved", "never"],
        typer.Option(
            help="When to exit with status 1. worse: if anything is worse or missing; moved: also if "
            "anything moved."
        ),
    ] = "never",
    threshold: Threshold = THRESHOLD,
    tolerances: Tolerances = None,
    html: Annotated[Path | None, typer.Option(help="Also write all changes as an HTML page.")] = None,
    markdown: Annotated[Path | None, typer.Option(help="Also write the output as Markdown.")] = None,
) -> None:
    """Print what changed between two runs: outcomes, verdicts, orders, accuracy, speed.

    A change above the threshold is worse or improved, a smaller one moved; rows of one run only are new or
    missing. With --fail-on worse or moved, the exit status is also 1 if the runs have no case in common.
    """
    from bodycheck._util.files import check_file, write_whole
    from bodycheck.reports.comparison.compare import compare as compared
    from bodycheck.reports.comparison.comparison_output import (
        comparison_markdown,
        print_comparison,
        render_comparison,
    )
    from bodycheck.reports.run_files.run_reader import read_tables

    thresholds = thresholds_of(threshold, tolerances)
    check_file("--html", html)
    check_file("--markdown", markdown)
    comparison = compared(read_tables(before), read_tables(after), thresholds)
    if html is not None:
        write_whole(html, render_comparison(comparison).encode())
    if markdown is not None:
        write_whole(markdown, comparison_markdown(comparison).encode())
    print_comparison(comparison)
    nothing = fail_on != "never" and not comparison.paired
    if nothing or comparison.of_status(*FAIL_ON[fail_on]):
        raise typer.Exit(_FAILED)


@questions.command(short_help="Print the cheapest setting for an error tolerance.")
def advise(
    error: Annotated[float, typer.Option(help="The error tolerance to meet, like 1e-3.")],
    scenarios: Annotated[
        list[str] | None,
        typer.Argument(help="Built-in scenarios, suites or .toml files.", show_default="all of the run"),
    ] = None,
    quantity: Annotated[
        str,
        typer.Option(
            help="The measure that has to meet the tolerance: orientation_error_rad, position_error, "
            "energy_drift, angular_momentum_drift or omega_error."
        ),
    ] = "orientation_error_rad",
    run: Annotated[
        Path | None,
        typer.Option(
            help="Folder of a run.", show_default="the newest run of these scenarios, else a new run"
        ),
    ] = None,
    allow_code: AllowCode = False,
) -> None:
    """Print the cheapest engine, method and step size that meet an error tolerance in a run."""
    from bodycheck.reports.render.answer_text import print_advice
    from bodycheck.reports.summary.advice import advise as advised
    from bodycheck.reports.summary.advice import check_question
    from bodycheck.runs.choose import chosen_run

    check_question(error, quantity)
    folder, tables, names = chosen_run(run, scenarios or [], allow_code=allow_code)
    print_advice(advised(tables.cases, error, quantity, names), error, quantity, str(folder))


@questions.command(short_help="Render the report of a run again.")
def report(
    run: _Run,
    markdown: Annotated[
        bool, typer.Option("--markdown", help="Print a Markdown summary for a pull request instead.")
    ] = False,
    allow_code: _AllowCode = False,
) -> None:
    """Render the report.html of a stored run again, or print its summary as Markdown."""
    from bodycheck.reports.run_files.run_reader import read_run, read_tables

    if markdown:
        from bodycheck.reports.render.markdown import markdown_summary

        print(markdown_summary(read_tables(run)))
        return
    from bodycheck._util.files import write_whole
    from bodycheck.reports.cache.disk_cache import Cache
    from bodycheck.reports.render.html import render_report

    page = run / "report.html"
    write_whole(page, render_report(read_run(run, allow_code=allow_code, cache=Cache.default())).encode())
    print(page)


@questions.command(short_help="Print a table of a run in another format.")
def table(
    run: _Run,
    which: Annotated[
        Literal["results", "methods", "stability", "probes"],
        typer.Argument(metavar="TABLE", help="The table: results, methods, stability or probes."),
    ] = "results",
    as_: Annotated[
        Literal["csv", "json", "md", "parquet"],
        typer.Option("--format", help="Output format; parquet requires --out."),
    ] = "csv",
    columns: Annotated[
        str | None, typer.Option(help="Columns to print, like scenario,dt_s.", show_default="all")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Output file.", show_default="standard output")] = None,
) -> None:
    """Print a table of a run as CSV, JSON or Markdown, or write it to a file, also as Parquet."""
    from bodycheck._util.files import write_whole
    from bodycheck.reports.run_files.run_reader import read_tables
    from bodycheck.reports.run_files.table_formats import FORMATS

    if as_ == "parquet" and out is None:
        raise InputError("--format parquet: is a binary format; name a file with --out")
    tables = read_tables(run)
    found = {
        "results": tables.results,
        "methods": tables.methods,
        "stability": tables.stability,
        "probes": tables.probes,
    }[which]
    if columns is not None:
        asked = [name.strip() for name in columns.split(",")]
        if unknown := [name for name in asked if name not in found.columns]:
            known = ", ".join(found.columns)
            raise InputError(f"--columns {columns}: {which} has no {', '.join(unknown)} (available: {known})")
        found = found[asked]
    content = FORMATS[as_](found)
    if out is None:
        print(content.decode(), end="")
    else:
        write_whole(out, content)


@questions.command(short_help="Draw a figure of a run for a paper.")
def plot(
    run: _Run,
    figure: Annotated[
        Literal["work-precision", "order", "drift", "stability"],
        typer.Option(help="The figure: work-precision, order, drift or stability."),
    ],
    out: Annotated[Path, typer.Option(help="Output file: .svg or .png.")],
    scenario: Annotated[
        str | None, typer.Option(help="A scenario of the run.", show_default="the only one")
    ] = None,
    quantity: Annotated[
        str | None,
        typer.Option(
            help="The measure to plot: energy_drift, omega_error, ...", show_default="orientation_error_rad"
        ),
    ] = None,
    allow_code: _AllowCode = False,
) -> None:
    """Draw a figure of one scenario for a paper: error against CPU time, against step size, or over time."""
    from bodycheck._util.files import check_file, write_whole
    from bodycheck.reports.cache.disk_cache import Cache
    from bodycheck.reports.measurement.measure_bounds import TRUTH_BOUNDS
    from bodycheck.reports.render.figures import STABILITY, check_picture, picture
    from bodycheck.reports.run_files.run_reader import read_run, read_tables

    check_picture(out)
    check_file("--out", out)
    if quantity is not None and (figure == STABILITY or quantity not in TRUTH_BOUNDS):
        what = (
            f"not used by --figure {figure}"
            if figure == STABILITY
            else f"unknown measure (available: {', '.join(TRUTH_BOUNDS)})"
        )
        raise InputError(f"--quantity {quantity}: {what}")
    tables = read_tables(run)
    there = list(tables.manifest["scenarios"])
    if scenario is None and len(there) == 1:
        scenario = there[0]
    if scenario is None or scenario not in there:
        asked = "is required" if scenario is None else f"{scenario}: not in this run"
        raise InputError(f"--scenario {asked} (available: {', '.join(there)})")
    found = read_run(run, allow_code=allow_code, cache=Cache.default()) if figure == "drift" else tables
    write_whole(out, picture(found, figure, scenario, quantity or "orientation_error_rad", out.suffix))
    print(out)
