"""`python -m census`: reproduce findings, print reports of them, audit published models, write the pages."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bodycheck._util.errors import InputError
from bodycheck.cli._app import run_app

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
Names = Annotated[
    list[str] | None, typer.Argument(help="Findings or engines.", show_default="all", metavar="[NAME]...")
]


@app.callback()
def census() -> None:
    """Reproduce what bodycheck found in engines, published models and published numbers."""


@app.command()
def reproduce(names: Names = None) -> None:
    """Run the commands and drivers of findings and compare what they print with the stated figures.

    Each engine runs in an environment of its own, which is made if it does not exist. The exit status is 1
    if a figure differs.
    """
    from census.finding import chosen, read_findings
    from census.reproduce import reproduce

    differs = 0
    for finding in (found := chosen(read_findings(), names or [])):
        compared = reproduce(finding)
        wrong = [one for one in compared if not one.agrees]
        differs += bool(wrong)
        print(f"{'differs   ' if wrong else 'reproduced'}  {finding.name}: {finding.title}", flush=True)
        for one in wrong:
            print(f"    {one.place}: {one.stated} stated, {one.found} found", flush=True)
    print(f"{len(found) - differs} of {len(found)} findings reproduced")
    if differs:
        raise typer.Exit(1)


@app.command()
def report(names: Names = None) -> None:
    """Print findings as texts that can be reported upstream."""
    from census.finding import chosen, read_findings
    from census.page import report_of

    print("\n\n".join(report_of(one) for one in chosen(read_findings(), names or [])))


@app.command()
def models(
    packages: Annotated[
        list[str] | None,
        typer.Argument(help="Packages of census/packages.toml.", show_default="all", metavar="[PACKAGE]..."),
    ] = None,
) -> None:
    """Import and lint the model files of packages, and write census/imports.csv and census/models.csv.

    Each package is installed in a temporary folder, without what it requires. An error is kept only if exact
    arithmetic on the numbers of the file, without bodycheck's reader, confirms it.
    """
    from census.models import audit_packages

    audit_packages(packages or [])


@app.command()
def numbers() -> None:
    """Compare published reference numbers with the truth, and write census/numbers.csv."""
    from census.numbers import compare_numbers

    compare_numbers()


@app.command()
def chains() -> None:
    """Run a free chain through every engine with trees, and write census/chains.csv."""
    from census.chains import run_chains

    run_chains()


@app.command()
def releases(
    engines: Annotated[
        list[str] | None,
        typer.Argument(help="Engines.", show_default="all with rows", metavar="[ENGINE]..."),
    ] = None,
    since: Annotated[
        str | None, typer.Option(help="The first release.", show_default="the last one with rows")
    ] = None,
) -> None:
    """Measure the releases that census/releases.csv does not have, add them, and print what changed."""
    from census.releases import add_new_releases

    print("\n".join(add_new_releases(engines or [], since)) or "nothing changed")


@app.command()
def page(
    folder: Annotated[Path, typer.Argument(help="Where to write the pages.")] = Path("docs/findings"),
) -> None:
    """Write the pages of the documentation."""
    from census.page import write_pages

    if not folder.parent.is_dir():
        raise InputError(f"{folder}: there is no folder {folder.parent}")
    for path in write_pages(folder):
        print(path)


def main() -> None:
    """Run the command; exit with status 2 on invalid input, 130 on an interrupt, with a one-line message."""
    run_app(app, "python -m census")


if __name__ == "__main__":
    main()
