"""`python -m benchmarks`: measure, write the tables and the picture, print which targets were met."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from bodycheck._util.errors import InputError, StoppedError
from bodycheck.cli._app import run_app

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


@app.command()
def benchmarks(
    out: Annotated[Path, typer.Option(help="The folder for the tables and the picture.")] = Path(
        "benchmarks"
    ),
    quick: Annotated[
        bool,
        typer.Option(
            "--quick",
            help="Small sizes, to see that all works: nothing is judged. Needs an --out of its own.",
        ),
    ] = False,
) -> None:
    """Measure speed at equal error, side by side in this process; some minutes on an idle machine."""
    if quick and out.resolve() == Path(__file__).resolve().parent:
        raise InputError(f"--quick: {out} is for what was measured in full; name another folder by --out")
    try:
        from bodycheck._util.files import check_folder

        check_folder(f"--out {out}", out)  # fail before minutes of measurements
        from benchmarks.readme import terminal_table
        from benchmarks.store import NOT_LIKE_FOR_LIKE, RESULTS, read_results, write_results
        from benchmarks.suite import measure
        from benchmarks.timing import FULL, QUICK

        measured = measure(QUICK if quick else FULL, lambda what: print(f"... {what}", flush=True))
    except KeyboardInterrupt:
        raise StoppedError("stopped; nothing was written") from None
    command = " ".join(["python -m benchmarks", *sys.argv[1:]])
    write_results(measured, out, command=command, quick=quick)
    print(terminal_table(read_results(out)))
    print(NOT_LIKE_FOR_LIKE)
    if quick:
        print("small sizes: the targets are those of the full ones, and nothing is judged")
    print(out / RESULTS)


def main() -> None:
    """Run the command; exit with status 2 on invalid input, 130 on an interrupt, with a one-line message."""
    run_app(app, "python -m benchmarks")


if __name__ == "__main__":
    main()
