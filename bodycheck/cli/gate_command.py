"""The command `gate`: bounds from a file, held by a new run or by a stored one."""

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
_MOST_MARGIN = 300.0  # decades: a bound beyond it would be no number


@gating.command(short_help="Hold engines to the bounds of a file.")
def gate(
    tolerances: Annotated[Path, typer.Option(help="A file of gates, see docs/gates.md.")],
    scenarios: Scenarios = None,
    run: Annotated[
        Path | None, typer.Option(help="The folder of a run to hold to the gates, in place of a new one.")
    ] = None,
    junit: Annotated[Path | None, typer.Option(help="Write JUnit XML to this file too.")] = None,
    json: Annotated[Path | None, typer.Option(help="Write JSON to this file too.")] = None,
    update: Annotated[
        bool, typer.Option("--update", help="Replace bounds in the file by tighter ones that the run keeps.")
    ] = False,
    margin: Annotated[
        float | None, typer.Option(help="Of --update, in decades.", show_default="0.3, a factor of 2")
    ] = None,
    loosen: Annotated[
        str | None, typer.Option(metavar="REASON", help="With --update: loosen what fails too, and say why.")
    ] = None,
    jobs: Jobs = None,
    timeout_s: TimeoutS = TIMEOUT_S,
    fresh: Fresh = None,
    allow_code: AllowCode = False,
) -> None:
    """Hold engines to the bounds of a file; the status is 1 where one fails or measured nothing."""
    _check(update=update, margin=margin, loosen=loosen)
    if run is not None and scenarios:
        raise InputError(f"--run {run}: has its own scenarios; name none beside it")
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
    """Raise InputError where the options of --update are wrong, or stand without it."""
    if not update and (margin is not None or loosen is not None):
        raise InputError("--margin and --loosen belong to --update")
    if margin is not None and not 0.0 <= margin <= _MOST_MARGIN:
        raise InputError(f"--margin {margin}: must be 0 or more decades, and {_MOST_MARGIN:g} at most")
    if loosen is not None and not loosen.strip():
        raise InputError("--loosen: must say why the bounds are loosened")


def _new_run(
    gates: Sequence[Gate], scenarios: Sequence[str], options: RunOptions, *, allow_code: bool
) -> Run:
    from bodycheck.reports.render.progress import LiveProgress
    from bodycheck.runs.gate_run import run_for_gates

    try:
        return run_for_gates(gates, scenarios, options, LiveProgress, allow_code=allow_code)
    except KeyboardInterrupt:
        raise StoppedError("stopped, before any gate was held") from None


def _update(file: Path, results: Sequence[GateResult], margin: float | None, loosen: str | None) -> None:
    """Replace bounds in a file by what a run keeps, and print which; loosen: the reason to loosen some."""
    from bodycheck._util.files import write_whole
    from bodycheck.reports.gates.gate_output import print_changes
    from bodycheck.reports.gates.proposal import MARGIN_DECADES, edited, proposals

    margin = MARGIN_DECADES if margin is None else margin
    changes = proposals(results, margin, loosen=loosen is not None)
    before = file.read_bytes().decode("utf-8-sig")
    write_whole(file, edited(before, str(file), changes, loosen).encode())
    print_changes(changes, results, margin)
