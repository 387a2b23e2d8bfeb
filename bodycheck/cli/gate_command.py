"""The command `gate`: check a new or a stored run against the bounds of a file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bodycheck._util.errors import InputError, StoppedError
from bodycheck.cli.options import AllowCode, Fresh, Jobs, Scenarios, TimeoutS
from bodycheck.runs.run_options import TIMEOUT_S

if TYPE_CHECKING:
    from bodycheck.reports.gates.gate import Gate
    from bodycheck.reports.gates.verdict import GateResult
    from bodycheck.reports.run_files.run_reader import Tables
    from bodycheck.reports.run_files.run_tables import Run
    from bodycheck.runs.run_options import RunOptions

gating = typer.Typer()

_FAILED = 1
_MOST_MARGIN = 300.0  # decades; a larger margin would overflow the bound


@gating.command(short_help="Check engines against the bounds of a file.")
def gate(
    tolerances: Annotated[Path, typer.Option(help="TOML file with the gates, see docs/gates.md.")],
    scenarios: Scenarios = None,
    run: Annotated[
        Path | None, typer.Option(help="Check the stored run of this folder.", show_default="a new run")
    ] = None,
    junit: Annotated[Path | None, typer.Option(help="Also write the results as JUnit XML.")] = None,
    json: Annotated[Path | None, typer.Option(help="Also write the results as JSON.")] = None,
    update: Annotated[
        bool, typer.Option("--update", help="Tighten the bounds in the file to what the run meets.")
    ] = False,
    margin: Annotated[
        float | None,
        typer.Option(
            help="Margin of the bounds that --update writes, in decades.", show_default="0.3, a factor of 2"
        ),
    ] = None,
    loosen: Annotated[
        str | None,
        typer.Option(metavar="REASON", help="With --update: also loosen failing bounds, for this reason."),
    ] = None,
    jobs: Jobs = None,
    timeout_s: TimeoutS = TIMEOUT_S,
    fresh: Fresh = None,
    allow_code: AllowCode = False,
) -> None:
    """Check engines against the bounds of a file.

    The exit status is 1 if a gate fails or measured nothing.
    """
    _check(update=update, margin=margin, loosen=loosen)
    if run is not None and scenarios:
        raise InputError(
            f"--run {run}: a stored run has its own scenarios; give --run or scenarios, not both"
        )
    from bodycheck._util.files import check_file, write_whole
    from bodycheck.reports.cache.reuse import reuse_of
    from bodycheck.reports.gates.gate import read_gates
    from bodycheck.reports.gates.gate_output import as_json, as_junit, print_results
    from bodycheck.reports.gates.verdict import held
    from bodycheck.reports.run_files.run_reader import read_tables
    from bodycheck.runs.run_options import RunOptions

    gates = read_gates(tolerances)
    outputs = {"--junit": junit, "--json": json, "--update": tolerances if update else None}
    for option, path in outputs.items():
        check_file(option, path)
    measured: Run | Tables
    if run is None:
        options = RunOptions(jobs=jobs, timeout_s=timeout_s, reuse=reuse_of(fresh, "truths"))
        measured = _new_run(gates, scenarios or ["standard"], options, allow_code=allow_code)
    else:
        measured = read_tables(run)
    results = held(gates, measured)
    print_results(results)
    if junit is not None:
        write_whole(junit, as_junit(results, str(tolerances)))
    if json is not None:
        write_whole(json, as_json(results, str(tolerances), measured.run_id))
    if update:
        _update(tolerances, results, margin, loosen)
        results = held(read_gates(tolerances), measured)
    if any(result.status != "passed" for result in results):
        raise typer.Exit(_FAILED)


def _check(*, update: bool, margin: float | None, loosen: str | None) -> None:
    """Raise InputError if the options of --update are wrong or given without it."""
    if not update and (margin is not None or loosen is not None):
        raise InputError("--margin and --loosen require --update")
    if margin is not None and not 0.0 <= margin <= _MOST_MARGIN:
        raise InputError(f"--margin {margin}: must be between 0 and {_MOST_MARGIN:g} decades")
    if loosen is not None and not loosen.strip():
        raise InputError("--loosen: must state the reason for loosening the bounds")


def _new_run(
    gates: Sequence[Gate], scenarios: Sequence[str], options: RunOptions, *, allow_code: bool
) -> Run:
    from bodycheck.reports.render.progress import LiveProgress
    from bodycheck.runs.gate_run import run_for_gates

    try:
        return run_for_gates(gates, scenarios, options, LiveProgress, allow_code=allow_code)
    except KeyboardInterrupt:
        raise StoppedError("stopped before any gate was checked") from None


def _update(file: Path, results: Sequence[GateResult], margin: float | None, loosen: str | None) -> None:
    """Replace bounds in a file by what a run meets, and print which; loosen: the reason to loosen some."""
    from bodycheck._util.files import write_whole
    from bodycheck.reports.gates.gate_output import print_changes
    from bodycheck.reports.gates.proposal import MARGIN_DECADES, edited, proposals

    margin = MARGIN_DECADES if margin is None else margin
    changes = proposals(results, margin, loosen=loosen is not None)
    before = file.read_bytes().decode("utf-8-sig")
    write_whole(file, edited(before, str(file), changes, loosen).encode())
    print_changes(changes, results, margin)
