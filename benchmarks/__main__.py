"""`python -m benchmarks`: measure, write the tables and the picture, print what passed and what missed."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.effort import FULL, QUICK
from benchmarks.picture import PICTURE, work_precision_picture
from benchmarks.store import NOT_LIKE_FOR_LIKE, read_points, read_results, write_results
from benchmarks.suite import measure
from benchmarks.table import terminal_table

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def main(
    out: Annotated[Path, typer.Option(help="The folder for the tables and the picture.")] = Path(
        "benchmarks"
    ),
    quick: Annotated[bool, typer.Option("--quick", help="Sizes cut to seconds: nothing is judged.")] = False,
) -> None:
    """Measure speed at equal error, side by side in this process; some minutes on an idle machine."""
    command = " ".join(["python -m benchmarks", *sys.argv[1:]])
    measured = measure(QUICK if quick else FULL, lambda what: print(f"... {what}", flush=True))
    write_results(measured, out, command=command, quick=quick)
    # from the files, not from memory: whoever has them gets the same page
    (out / PICTURE).write_text(work_precision_picture(read_points(out)), encoding="utf-8")
    print(terminal_table(read_results(out)))
    print(NOT_LIKE_FOR_LIKE)


if __name__ == "__main__":
    app()
