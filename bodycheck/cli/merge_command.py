"""The command `merge`: combine shards."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bodycheck._util.errors import InputError
from bodycheck.cli.nightly import print_judgement
from bodycheck.cli.options import (
    MEASURE,
    OUTPUT,
    AllowCode,
    Json,
    Threshold,
    ThresholdsFile,
    described,
    folder_option,
    refuse_others,
    thresholds_of,
)
from bodycheck.reports.gates.thresholds import THRESHOLD

merging = typer.Typer()

_OF_A_WHOLE = ("parts", "out", "json")


@merging.command(
    short_help="Combine the shards of a run, an ensemble or an audit.",
    **described(
        MEASURE,
        "bodycheck merge part-* --out whole",
        "bodycheck merge part-* --history nights",
    ),
)
def merge(
    context: typer.Context,
    parts: Annotated[
        list[Path],
        typer.Argument(metavar="PART...", help="Folders of all shards of one run, ensemble or audit."),
    ],
    out: Annotated[Path | None, folder_option("for the whole run, without --history", False)] = None,
    history: Annotated[
        Path | None,
        typer.Option(
            help="Store the whole as a nightly run in this history and compare it, as `nightly` does.",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    threshold: Threshold = THRESHOLD,
    thresholds: ThresholdsFile = None,
    allow_code: AllowCode = False,
    json: Json = False,
) -> None:
    """Combine the shards of a run, an ensemble or an audit, and write the files of an undivided run.

    Except for speeds, the tables are those of an undivided run. Differences between the machines are
    reported: versions, and different results of the sentinel cases, which every shard runs.
    """
    from bodycheck.audit.audit_document import audit_data, audit_document
    from bodycheck.audit.audit_merge import is_audit, merge_audits
    from bodycheck.ensembles.ensemble_answer import ensemble_data, ensemble_document, write_ensemble_page
    from bodycheck.ensembles.ensemble_merge import is_ensemble, merge_ensembles
    from bodycheck.reports.document import answer
    from bodycheck.reports.history.archive import History
    from bodycheck.reports.run_files.writer import check_output
    from bodycheck.reports.summary.sentences import run_data, run_document
    from bodycheck.runs.directory import write_run
    from bodycheck.runs.merge import merge as merged
    from bodycheck.runs.nightly_run import store_nightly

    if (out is None) == (history is None):
        raise InputError("--out or --history: give one of them")
    levels = thresholds_of(threshold, thresholds)
    if out is not None:
        refuse_others(
            context, f"--out {out}: compares the whole with no other run", (*_OF_A_WHOLE, "allow_code")
        )
        check_output(out)
    if out is None and (any(map(is_ensemble, parts)) or any(map(is_audit, parts))):
        raise InputError("--history: stores runs, not ensembles or audits; give --out")
    if out is not None and any(map(is_ensemble, parts)):
        result = merge_ensembles(parts, out, allow_code=allow_code)
        write_ensemble_page(result, out)
        answer(ensemble_document(result, out), ensemble_data(result, out), as_json=json)
        return
    if out is not None and any(map(is_audit, parts)):
        refuse_others(context, "an audit runs no scenario", _OF_A_WHOLE)
        audit, findings = merge_audits(parts, out)
        answer(audit_document(audit, findings), {**audit_data(audit), "machines": findings}, as_json=json)
        return
    run = merged(parts, allow_code=allow_code)
    if history is not None:
        judged, run_folder = store_nightly(run, History.at(history), levels)
        print_judgement(judged, run_folder, {}, json=json)
        return
    assert out is not None
    report = write_run(run, out)
    answer(run_document(run), {**run_data(run), **run.manifest["merged"], "report": report}, as_json=json)
    if not json:
        print(report)
