"""The command `gate`: check a new or a stored run against the bounds of a file."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bodycheck._util.errors import InputError, StoppedError
from bodycheck._util.formatting import suggestion
from bodycheck._util.untrusted import read_text
from bodycheck.cli.options import (
    WATCH,
    WHAT,
    AllowCode,
    BadgeFile,
    EnginesFile,
    Fresh,
    Github,
    Jobs,
    Json,
    JunitFile,
    Quiet,
    SarifFile,
    Scenarios,
    TimeoutS,
    admit_engines,
    check_files,
    described,
    engine_option,
    folder_option,
    progress_of,
    refuse_others,
    tell_github,
    write_files,
)
from bodycheck.runs.request import TIMEOUT_S

if TYPE_CHECKING:
    from bodycheck.reports.document import Document
    from bodycheck.reports.gates.gate import Gate
    from bodycheck.reports.gates.verdict import GateResult
    from bodycheck.reports.run_files.run_tables import Run, Tables
    from bodycheck.runs.request import Request
    from bodycheck.runs.run_progress import ProgressFactory

gate_commands = typer.Typer()

_FAILED = 1
_OF_A_STORED_RUN = (
    *("gates", "run", "engine", "update", "margin", "loosen"),
    *("github", "junit", "sarif", "badge", "json", "quiet"),
)
_MAX_MARGIN = 300.0  # decades; a larger margin would overflow the bound


@gate_commands.command(
    short_help="Check engines against the bounds of a file.",
    **described(
        WATCH,
        "bodycheck gate standard --gates tolerances.toml --junit gates.xml",
        "bodycheck gate --gates tolerances.toml --run first --json",
        "bodycheck gate smoke --gates gates.toml --engine cmd:build/my-engine --github --sarif gates.sarif",
    ),
)
def gate(
    context: typer.Context,
    gates: Annotated[
        Path,
        typer.Option(
            metavar="FILE", help="TOML file with the gates, see docs/gates.md.", rich_help_panel=WHAT
        ),
    ],
    scenarios: Scenarios = None,
    engine: Annotated[
        str | None,
        engine_option("Check only the gates of these engines", "the engines that the gates name"),
    ] = None,
    run: Annotated[
        Path | None,
        typer.Option(
            help="Check the stored run of this folder.", show_default="a new run", rich_help_panel=WHAT
        ),
    ] = None,
    out: Annotated[Path | None, folder_option("to keep the new run in, with its report", "not kept")] = None,
    github: Github = False,
    junit: JunitFile = None,
    sarif: SarifFile = None,
    badge: BadgeFile = None,
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
    engines: EnginesFile = None,
    allow_code: AllowCode = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Check engines against the bounds of a file.

    The exit status is 1 if a gate fails or nothing was measured for it.
    """
    _check(update=update, margin=margin, loosen=loosen)
    if run is not None:
        refuse_others(context, f"--run {run}: checks a stored run", _OF_A_STORED_RUN)
    from bodycheck.adapters.engine_names import admit
    from bodycheck.reports import alerts
    from bodycheck.reports.document import answer, print_document
    from bodycheck.reports.gates import gate_output
    from bodycheck.reports.gates.gate import gate_lines, parse_gates, read_gates
    from bodycheck.reports.gates.verdict import check_gates
    from bodycheck.reports.run_files.run_reader import read_tables
    from bodycheck.reports.run_files.writer import check_output
    from bodycheck.runs.request import Request

    text = read_text(gates)
    bounds = parse_gates(text, str(gates))
    requested = [] if engine is None else engine.split(",")
    if not any(gate.concerns(requested) for gate in bounds):
        known = suggestion(engine or "", dict.fromkeys(gate.engine for gate in bounds))
        raise InputError(f"--engine {engine}: no gate in {gates} concerns it{known}")
    files = {"junit": junit, "sarif": sarif, "badge": badge}
    check_files({**files, "update": gates if update else None})
    if out is not None:
        check_output(out)
    measured: Run | Tables
    if run is None:
        options = Request(jobs=jobs, timeout_s=timeout_s, fresh=fresh, reuse_by_default="truths")
        make_progress = progress_of(quiet=quiet)
        admit_engines(engines, allow_code=allow_code)
        if engine is None:
            admit((gate.engine for gate in bounds), allow_code=allow_code, file=gates)
        measured = _new_run(
            bounds, scenarios or ["standard"], requested, options, make_progress, out, allow_code=allow_code
        )
    else:
        measured = read_tables(run)
    results = check_gates(bounds, measured, requested)
    document = gate_output.results_document(results)
    answer(document, gate_output.results_data(results, str(gates), measured.run_id), as_json=json)
    found = gate_output.alerts_of(results, measured, gates, gate_lines(text, len(bounds)))
    if github:
        tell_github(found, "bodycheck gate", document, as_json=json)
    write_files(
        files,
        {
            "junit": lambda: gate_output.as_junit(results, str(gates)),
            "sarif": lambda: alerts.sarif(found),
            "badge": lambda: gate_output.badge_of(results),
        },
        as_json=json,
    )
    if update:
        changes = _update(gates, results, margin, loosen)
        if not json:
            print_document(changes)
        results = check_gates(read_gates(gates), measured, requested)
    if any(result.is_bad for result in results):
        raise typer.Exit(_FAILED)


def _check(*, update: bool, margin: float | None, loosen: str | None) -> None:
    """Raise InputError if the options of --update are wrong or given without it."""
    if not update and (margin is not None or loosen is not None):
        raise InputError("--margin and --loosen require --update")
    if margin is not None and not 0.0 <= margin <= _MAX_MARGIN:
        raise InputError(f"--margin {margin}: must be between 0 and {_MAX_MARGIN:g} decades")
    if loosen is not None and not loosen.strip():
        raise InputError("--loosen: must state the reason for loosening the bounds")


def _new_run(
    gates: Sequence[Gate],
    scenarios: Sequence[str],
    engines: Sequence[str],
    options: Request,
    make_progress: ProgressFactory,
    out: Path | None,
    *,
    allow_code: bool,
) -> Run:
    """Run what the gates check, and write it to `out`, if given."""
    from bodycheck.runs.directory import write_run
    from bodycheck.runs.gate_run import run_for_gates

    try:
        run = run_for_gates(gates, scenarios, options, make_progress, engines=engines, allow_code=allow_code)
    except KeyboardInterrupt:
        raise StoppedError("stopped before any gate was checked") from None
    if out is not None:
        print(write_run(run, out), file=sys.stderr)
    return run


def _update(file: Path, results: Sequence[GateResult], margin: float | None, loosen: str | None) -> Document:
    """Replace bounds in a file by what a run meets, and return which; loosen: the reason to loosen some."""
    from bodycheck._util.files import write_file
    from bodycheck.reports.gates.gate_output import changes_document
    from bodycheck.reports.gates.proposal import MARGIN_DECADES, edited, proposals

    margin = MARGIN_DECADES if margin is None else margin
    changes = proposals(results, margin, loosen=loosen is not None)
    write_file(file, edited(read_text(file), str(file), changes, loosen).encode())
    return changes_document(changes, results, margin)
